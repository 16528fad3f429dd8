"""The learned predictors, each with the network that ships in the package.

`graphrqi_predict` is the default: a perceptron corrects rollouts with the parameters of the
behaviours that drivers are believed to have. It was trained on the classifier's own posteriors,
including wrong ones, with a share of uniform and of shuffled ones. A network trained on true labels
would rely too much on the classifier.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray
from graphrqi.posterior import Posterior
from graphrqi.predict.learned.inputs import predictor_inputs, unlabelled_inputs
from graphrqi.predict.networks import (
    WEIGHTS,
    FuturesNetwork,
    Perceptron,
    load_futures_network,
    spread_out,
)
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.recorded.network import RecordedNetwork, trained_network
from graphrqi.predict.recorded.predictor import predict_recorded
from graphrqi.predict.rollout.driver_table import load_table
from graphrqi.predict.scene.paths import limits_known
from graphrqi.predict.scene.scene import Scene, Unmapped

Predictor = Callable[[Scene, Posterior], Prediction]

TRAINED_LIMITS_MPS: Final = (11.0, 17.0)
"""Speed limits at which the networks predict drivers without a light, crossing or junction ahead,
m/s. They were trained at 50 km/h. Beyond this range the predictor for recordings has smaller
errors."""

STOP_S, STOP_M = 5.0, 20.0
"""A stop constraint counts if it is nearer than the driver comes within this time at its present
speed, plus this distance."""


def _where_trained(
    predictor: Predictor,
    scene: Scene | Unmapped,
    posterior: Posterior,
    network: RecordedNetwork | None = None,
) -> Prediction:
    """A predictor's futures of the agents it was trained for, for the rest those for recordings.

    Where limits, lights and priority are unknown, the networks would predict that a vehicle waiting
    at a light, or parked, drives off.
    """
    if isinstance(scene, Unmapped):
        return predict_recorded(scene.history, scene.steps, network)
    away = ~trained_for(scene)
    if not away.any():
        return predictor(scene, posterior)
    recorded = predict_recorded(scene.history, scene.steps, network, scene.road)
    if away.all():
        return recorded
    told = predictor(scene, posterior)
    assert told.spread is not None
    assert recorded.spread is not None
    return Prediction(
        told.ids,
        told.time_s,
        np.where(away[:, None, None, None], recorded.xy, told.xy),
        np.where(away[:, None], recorded.probability, told.probability),
        np.where(away[:, None, None], recorded.spread, told.spread),
    )


def trained_for(scene: Scene) -> BoolArray:
    """(n,) agents that the networks were trained for.

    These are on roads with known limits, lights and priority. The limit is in the trained range, or
    a stop constraint is near.
    """
    knows = scene.road.knows
    if knows.unknown or not knows.limits_rule or not limits_known(scene.graph):
        return np.zeros(scene.ids.size, bool)
    low, high = TRAINED_LIMITS_MPS
    lane = np.maximum(scene.lane, 0)
    limit = scene.graph.limit[lane]
    stops = scene.paths.stop_x[scene.path] - scene.s[:, None]
    reach = STOP_S * np.maximum(scene.speed, 0.0) + STOP_M
    stopped = ((stops > -STOP_M) & (stops < reach[:, None])).any(axis=1)
    usual = (limit >= low) & (limit <= high)
    return np.asarray(~scene.on_path | usual | stopped | scene.graph.internal[lane])


@functools.cache
def _shipped(name: str) -> FuturesNetwork:
    """A network that ships in the package."""
    path = WEIGHTS / f"{name}.safetensors"
    if name == "lstm":
        from graphrqi.predict.learned.lstm import TrajectoryLstm

        return load_futures_network(path, TrajectoryLstm.read)
    return load_futures_network(path, Perceptron.read)


def _corrected(scene: Scene, posterior: Posterior) -> Prediction:
    """Rollouts of the believed behaviours, corrected by a network on every road."""
    inputs = predictor_inputs(scene, posterior.of(scene.ids), load_table())
    return spread_out(scene.history, _shipped("graphrqi-predict")(inputs), scene.steps)


def graphrqi_predict(scene: Scene | Unmapped, posterior: Posterior) -> Prediction:
    """Rollouts of the believed behaviours, corrected by a network: the best predictor here."""
    return _where_trained(_corrected, scene, posterior)


def with_weights(folder: Path) -> Callable[[Scene | Unmapped, Posterior], Prediction]:
    """`graphrqi_predict` with weights for recordings that ``graphrqi train --predictor`` wrote."""
    network = trained_network(folder)
    return lambda scene, posterior: _where_trained(_corrected, scene, posterior, network)


def _unlabelled(scene: Scene, posterior: Posterior) -> Prediction:
    """A recurrent network that is given neither beliefs nor a driver model, on every road."""
    return spread_out(scene.history, _shipped("lstm")(unlabelled_inputs(scene)), scene.steps)


def lstm(scene: Scene, posterior: Posterior) -> Prediction:
    """A recurrent network that is given neither beliefs nor a driver model."""
    return _where_trained(_unlabelled, scene, posterior)
