"""How well the beliefs about drivers agree with what those drivers are seen doing.

A classifier may be wrong about one driver or, far from its training data, about all. Each behaviour
predicts a wished speed and, by the car-following law, a present acceleration. The likelihood ratio
of the observations under the beliefs against no beliefs tells how far the beliefs about one driver
can be trusted; the ratios of all other drivers tell how far the classifier can be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.rollout.driver_table import DriverTable
from graphrqi.predict.rollout.route import ACCELERATION_SD
from graphrqi.predict.scene.scene import Scene

FloatArray = NDArray[np.float64]

WISH_SD = 0.18
"""Standard deviation of the logarithm of wished speeds within a behaviour (the scenarios' spread of
15 %, and the error of the estimate)."""

OVER = 0.03
"""Excess over the wished speed, as its logarithm, that counts as none."""

MOST_ACCELERATION, MOST_WISH = 4.0, 8.0
"""Largest log-likelihoods that one acceleration and a wished speed can cost."""

LEAST_BELIEF = 1e-4
"""Least probability given to a behaviour, so that one error does not exclude it."""

SUM_SCALE = 5.0
"""Divisor and bound of the sum over the other drivers."""


def agreement(
    scene: Scene, probability: FloatArray, asked: FloatArray, table: DriverTable
) -> FloatArray:
    """How much more likely the beliefs make the observations than no beliefs would.

    Args:
        scene: the present.
        probability: (n, 6) beliefs; uniform rows for drivers of whom nothing is known.
        asked: (6, n) acceleration that each behaviour would have now, m/s2.
        table: calibrated driver parameters.

    Returns:
        (n, 3) logarithm of the ratio for the driver itself, its mean over all other drivers about
        whom there are beliefs, and its scaled sum over them.
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
