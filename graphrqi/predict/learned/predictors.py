"""The learned predictors, each with the network that ships in the package.

`graphrqi_predict` is the default: a perceptron corrects rollouts of what each driver is believed to
be. It was trained on the classifier's own posteriors, wrong ones included, with a share of uniform
and of shuffled ones: trained on true labels it would trust labels that are often wrong.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict.learned.inputs import predictor_inputs, unlabelled_inputs
from graphrqi.predict.learned.lstm import shipped_lstm
from graphrqi.predict.networks.futures import spread_out
from graphrqi.predict.networks.perceptron import shipped_perceptron
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.recorded.network import trained_network
from graphrqi.predict.recorded.predictor import predict_recorded
from graphrqi.predict.rollout.driver_table import default_table
from graphrqi.predict.rollout.following import shuffled_posterior, true_behavior
from graphrqi.predict.scene.paths import limits_known
from graphrqi.predict.scene.scene import Scene

Predictor = Callable[[Scene, Posterior], Prediction]


def at_home(predictor: Predictor) -> Predictor:
    """A learned predictor that leaves recordings to the predictor for these.

    The networks were trained where limits, lights and priority are known and traffic drives as
    the limits say. A recording's map rarely knows all of these; there they would predict that a
    vehicle waiting at a light, or parked, is about to drive off.
    """

    @functools.wraps(predictor)
    def predict(scene: Scene, posterior: Posterior) -> Prediction:
        if not knows_everything(scene):
            return predict_recorded(scene.history, scene.steps, road=scene.road)
        return predictor(scene, posterior)

    return predict


def knows_everything(scene: Scene) -> bool:
    """Whether the road tells limits that rule, lights and priority."""
    knows = scene.road.knows
    return not knows.unknown and knows.limits_rule and limits_known(scene.graph)


@at_home
def graphrqi_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """Rollouts of the believed behaviours, corrected by a network: the best predictor here."""
    inputs = predictor_inputs(scene, posterior.of(scene.ids), default_table())
    network = shipped_perceptron("graphrqi-predict.safetensors")
    return spread_out(scene.history, network(inputs), scene.steps)


def with_weights(folder: Path) -> Predictor:
    """`graphrqi_predict` with weights for recordings that ``graphrqi train-predictor`` wrote.

    Args:
        folder: as given to the command as ``--out``.

    Raises:
        InputError: if there are no such weights.
    """
    network = trained_network(folder)

    def predict(scene: Scene, posterior: Posterior) -> Prediction:
        if knows_everything(scene):
            return graphrqi_predict(scene, posterior)
        return predict_recorded(scene.history, scene.steps, network, scene.road)

    return predict


@at_home
def mlp(scene: Scene, posterior: Posterior) -> Prediction:
    """A perceptron with the inputs, data and budget of the label-free ``lstm``, for comparison."""
    network = shipped_perceptron("mlp.safetensors")
    return spread_out(scene.history, network(unlabelled_inputs(scene)), scene.steps)


@at_home
def lstm(scene: Scene, posterior: Posterior) -> Prediction:
    """A recurrent network that is given neither beliefs nor a driver model."""
    return spread_out(scene.history, shipped_lstm()(unlabelled_inputs(scene)), scene.steps)


def unlabelled_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """As `graphrqi-predict`, without beliefs about anybody: the baseline for the labels' worth."""
    nothing = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
    return graphrqi_predict(scene, nothing)


def oracle_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """As `graphrqi-predict`, given every driver's true behaviour.

    Raises:
        InputError: if the history carries no labels.
    """
    return graphrqi_predict(scene, Posterior(scene.ids, true_behavior(scene)))


def shuffled_predict(scene: Scene, posterior: Posterior) -> Prediction:
    """As `graphrqi-predict`, given other drivers' behaviours: how far wrong labels mislead it."""
    return graphrqi_predict(scene, shuffled_posterior(scene, posterior))
