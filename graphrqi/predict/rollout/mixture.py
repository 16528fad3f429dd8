"""One rollout per behaviour, weighed by belief and by how well each explains the driver's past."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.rollout.driver_parameters import expected_parameters
from graphrqi.predict.rollout.driver_table import DriverTable, default_table
from graphrqi.predict.rollout.rollout import positions, roll
from graphrqi.predict.rollout.route import ACCELERATION_SD, on_likely_paths
from graphrqi.predict.scene.scene import Scene

FloatArray = NDArray[np.float64]

LARGEST_EVIDENCE: Final = 4.0
"""Largest log-likelihood that the present acceleration can cost a behaviour."""


def behavior_mixture(scene: Scene, posterior: Posterior) -> Prediction:
    """Six futures, one per behaviour, each driven among the others as they are expected to drive.

    The probability of a future is the belief in its behaviour times the likelihood of the present
    acceleration if the driver were of that behaviour.
    """
    return mixture_with(scene, posterior.worth(scene.ids), default_table())


def mixture_with(scene: Scene, probability: FloatArray, table: DriverTable) -> Prediction:
    """`behavior_mixture` with (n, 6) beliefs and driver numbers."""
    expected = expected_parameters(scene, probability, table)
    routed = on_likely_paths(scene, expected)
    others = roll(routed, expected, table.decay_s)
    n = scene.ids.size
    futures = np.empty((n, len(BEHAVIORS), scene.steps, 2))
    weight = np.log(np.maximum(probability, 1e-6))
    for behavior in BEHAVIORS:
        sure = np.zeros((n, len(BEHAVIORS)))
        sure[:, behavior.code] = 1.0
        drivers = expected_parameters(scene, sure, table)
        rollout = roll(routed, drivers, table.decay_s, others)
        futures[:, behavior.code] = positions(routed, rollout)
        miss = (scene.accel - rollout.asked) / ACCELERATION_SD
        told = np.minimum(0.5 * miss**2, LARGEST_EVIDENCE)
        weight[:, behavior.code] -= np.where(scene.on_path, told, 0.0)
    likely = np.exp(weight - weight.max(axis=1, keepdims=True, initial=-np.inf))
    return scene.predicted(futures, likely / likely.sum(axis=1, keepdims=True))
