"""Predictors that simulate all drivers by a car-following law, with and without beliefs."""

from __future__ import annotations

import numpy as np

from behaviors.labels import BEHAVIORS
from graphrqi.arrays import FloatArray, IntArray
from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.rollout.driver_table import (
    DriverParameters,
    DriverTable,
    average_parameters,
    expected_parameters,
    load_table,
)
from graphrqi.predict.rollout.rollout import positions, roll
from graphrqi.predict.rollout.route import on_likely_paths
from graphrqi.predict.scene.scene import Scene
from sim.frames import PEDESTRIAN, Tracks


def blind(scene: Scene, posterior: Posterior) -> Prediction:
    """Every driver has the average driver's parameters."""
    return blind_with(scene, load_table())


def aware(scene: Scene, posterior: Posterior) -> Prediction:
    """Every driver has the parameters expected under the beliefs about its behaviour.

    The parameters are the posterior's expectation over the behaviours' calibrated ones. Drivers
    without beliefs get the mean of all behaviours.
    """
    return aware_with(scene, posterior.discounted(scene.ids), load_table())


def blind_with(scene: Scene, table: DriverTable) -> Prediction:
    """`blind` with the given numbers."""
    return _driven(scene, average_parameters(scene, table), table.average_decay_s)


def aware_with(scene: Scene, probability: FloatArray, table: DriverTable) -> Prediction:
    """`aware` with the given numbers and (n, 6) beliefs."""
    return _driven(scene, expected_parameters(scene, probability, table), table.decay_s)


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
