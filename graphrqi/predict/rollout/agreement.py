"""Agreement of the beliefs about drivers with the drivers' observed motion.

A classifier may be wrong about one driver or, far from its training data, about all. Each behaviour
predicts a desired speed and, by the car-following law, a present acceleration. The likelihood ratio
of beliefs against no beliefs shows how reliable the beliefs about one driver are. The ratios of all
other drivers show how reliable the classifier is.
"""

from __future__ import annotations

import numpy as np

from graphrqi.arrays import FloatArray
from graphrqi.predict.rollout.driver_table import DriverTable
from graphrqi.predict.rollout.route import ACCELERATION_SD
from graphrqi.predict.scene.scene import Scene

WISH_SD = 0.18
"""Standard deviation of the logarithm of desired speeds within a behaviour, including the
estimate's error."""

OVER = 0.03
"""Logarithm of the excess over the desired speed that is tolerated."""

MOST_ACCELERATION, MOST_WISH = 4.0, 8.0
"""Largest log-likelihoods that one acceleration and a desired speed can cost."""

LEAST_BELIEF = 1e-4
"""Least probability given to a behaviour, so that one error does not exclude it."""

SUM_SCALE = 5.0
"""Divisor and bound of the sum over the other drivers."""


def agreement(
    scene: Scene, probability: FloatArray, asked: FloatArray, table: DriverTable
) -> FloatArray:
    """Log-likelihood ratio of the observations under the beliefs and under no beliefs.

    Args:
        scene: the present.
        probability: (n, 6) beliefs; uniform for unknown drivers.
        asked: (6, n) acceleration of each behaviour now, m/s2.
        table: calibrated driver parameters.

    Returns:
        (n, 3) log-ratio of the driver, its mean over all other drivers with beliefs, and its scaled
        sum over them.
    """
    states, count = scene.states, probability.shape[1]
    known = (probability > 1.0 / count + 1e-6).any(axis=1)
    wish = np.log(table.behavior[:, 0])
    miss = (scene.accel[:, None] - asked.T) / ACCELERATION_SD
    lost = np.where(scene.on_path[:, None], np.minimum(0.5 * miss**2, MOST_ACCELERATION), 0.0)
    free = np.log(np.maximum(states.free_factor, 0.1))[:, None]
    apart = np.minimum(0.5 * ((free - wish) / WISH_SD) ** 2, MOST_WISH)
    lost = lost + np.where(np.isnan(free), 0.0, apart)
    fastest = np.log(np.maximum(states.least_factor, 0.1))[:, None]
    excess = np.maximum(fastest - wish - OVER, 0.0) / WISH_SD
    lost += np.minimum(0.5 * excess**2, MOST_WISH)
    likelihood = np.exp(lost.min(axis=1, keepdims=True) - lost)
    believed = (np.maximum(probability, LEAST_BELIEF) * likelihood).sum(axis=1)
    own = np.where(known, np.log(believed / likelihood.mean(axis=1)), 0.0)
    rest = own.sum() - own
    mean = rest / np.maximum(known.sum() - known, 1)
    return np.stack([own, mean, np.clip(rest / SUM_SCALE, -SUM_SCALE, SUM_SCALE)], axis=1)
