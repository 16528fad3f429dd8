"""Predictors that simulate all drivers by a car-following law, and what its errors say.

A driver brakes for a turn, and a driver that is too fast will not take it. The probability of a
path is its prior times the likelihood of the observed acceleration under the car-following law.

A classifier may be wrong about one driver or, far from its training data, about all. Each behaviour
predicts a desired speed and, by the car-following law, a present acceleration. The likelihood ratio
of beliefs against no beliefs shows how reliable the beliefs about one driver are. The ratios of all
other drivers show how reliable the classifier is.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from graphrqi.arrays import BoolArray, FloatArray, IntArray, softmax
from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.rollout.driver_table import (
    DriverParameters,
    DriverTable,
    average_parameters,
    expected_parameters,
    load_table,
)
from graphrqi.predict.rollout.rollout import asked_on, positions, roll
from graphrqi.predict.scene.scene import Scene
from sim.frames import PEDESTRIAN, Tracks

ACCELERATION_SD: Final = 0.8
"""Standard deviation of drivers' accelerations around the law's, m/s2 (chosen on training
episodes)."""

LARGEST_EVIDENCE: Final = 6.0
"""Largest log-likelihood ratio, so that one odd moment does not decide alone."""


def candidates(scene: Scene) -> tuple[IntArray, BoolArray]:
    """(n, C) paths that each driver may take, and (n, C) which of those entries are real."""
    paths = scene.paths
    lane = np.maximum(scene.lane, 0)
    count = np.where(scene.on_path, paths.options[lane], 1)
    most = int(count.max(initial=1))
    step = np.arange(most)
    real = step[None] < count[:, None]
    first = np.where(scene.on_path, paths.first[lane], 0)
    return first[:, None] + np.where(real, step[None], 0), real


def path_probability(scene: Scene, drivers: DriverParameters) -> tuple[IntArray, FloatArray]:
    """(n, C) paths that each driver may take, and (n, C) their probabilities."""
    paths = scene.paths
    choice, real = candidates(scene)
    weight = np.where(real, np.log(paths.probability[choice]), -np.inf)
    if choice.shape[1] > 1:
        ways = np.ascontiguousarray(np.where(real, choice, -1 - choice).T)
        miss = 0.5 * ((scene.accel - asked_on(scene, ways, drivers)) / ACCELERATION_SD) ** 2
        weight -= np.minimum(miss, LARGEST_EVIDENCE).T
    return choice, softmax(weight)


def on_likely_paths(scene: Scene, drivers: DriverParameters) -> Scene:
    """The scene with every driver on its most likely path."""
    choice, probability = path_probability(scene, drivers)
    return scene.with_path(choice[np.arange(len(choice)), probability.argmax(axis=1)])


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

    Beliefs are (n, 6), uniform for unknown drivers; ``asked`` is the (6, n) acceleration of each
    behaviour now, m/s2.

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


def blind(
    scene: Scene, posterior: Posterior | None = None, table: DriverTable | None = None
) -> Prediction:
    """Every driver has the average driver's parameters."""
    table = table or load_table()
    return _driven(scene, average_parameters(scene, table), table.average_decay_s)


def aware(scene: Scene, posterior: Posterior, table: DriverTable | None = None) -> Prediction:
    """Every driver has the parameters expected under the beliefs about its behaviour.

    The parameters are the posterior's expectation over the behaviours' calibrated ones. Drivers
    without beliefs get the mean of all behaviours.
    """
    table = table or load_table()
    believed = expected_parameters(scene, posterior.discounted(scene.ids), table)
    return _driven(scene, believed, table.decay_s)


def _driven(scene: Scene, drivers: DriverParameters, decay_s: float) -> Prediction:
    """All drivers simulated along their most likely paths."""
    routed = on_likely_paths(scene, drivers)
    return scene.predicted(positions(routed, roll(routed, drivers, decay_s)))


def certain(code: IntArray) -> FloatArray:
    """(n, 6) certain beliefs in behaviours (n,); uniform where the code is -1, unknown."""
    sure = np.full((code.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
    sure[code >= 0] = np.eye(len(BEHAVIORS))[code[code >= 0]]
    return sure


def shuffled_posterior(history: Tracks, posterior: Posterior) -> Posterior:
    """The beliefs about the drivers of a history, exchanged between drivers.

    The exchange is the same whenever the same agents are present.
    """
    drives = np.flatnonzero(history.kind != PEDESTRIAN)
    probability = posterior.discounted(history.ids)
    rng = np.random.default_rng([int(i) & 0xFFFFFFFF for i in history.ids[drives]])
    probability[drives] = probability[drives][rng.permutation(drives.size)]
    return Posterior(history.ids, probability)
