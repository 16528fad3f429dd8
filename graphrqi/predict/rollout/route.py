"""Route choice: paths weighed by the car-following law's acceleration on each at present.

A driver brakes for a turn, and a driver that is too fast will not take it. The probability of a
path is its prior times the likelihood of the observed acceleration under the car-following law.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.predict.rollout.driver_table import DriverParameters
from graphrqi.predict.rollout.rollout import asked_on
from graphrqi.predict.scene.scene import Scene

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
    """Probability of each path of each driver.

    Args:
        scene: the present.
        drivers: how each driver drives.

    Returns:
        (n, C) paths and (n, C) their probabilities; rows sum to 1.
    """
    paths = scene.paths
    choice, real = candidates(scene)
    weight = np.where(real, np.log(paths.probability[choice]), -np.inf)
    if choice.shape[1] > 1:
        ways = np.ascontiguousarray(np.where(real, choice, -1 - choice).T)
        miss = 0.5 * ((scene.accel - asked_on(scene, ways, drivers)) / ACCELERATION_SD) ** 2
        weight -= np.minimum(miss, LARGEST_EVIDENCE).T
    weight -= weight.max(axis=1, keepdims=True)
    likely = np.exp(weight)
    return choice, np.asarray(likely / likely.sum(axis=1, keepdims=True))


def on_likely_paths(scene: Scene, drivers: DriverParameters) -> Scene:
    """The scene with every driver on its most likely path."""
    choice, probability = path_probability(scene, drivers)
    return scene.with_path(choice[np.arange(len(choice)), probability.argmax(axis=1)])
