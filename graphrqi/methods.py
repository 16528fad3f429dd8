"""Methods that classify drivers, and the models that training makes of them.

A method names an observer, which turns positions into features, and a classifier. A model is a
trained method; `graphrqi.model_files` writes and reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from behaviors.registry import Registry
from graphrqi.classify import CLASSIFIERS, Classifier
from graphrqi.features.drivers import DriverObserver
from graphrqi.features.embedding import EmbeddingObserver
from graphrqi.features.observer import Observer
from graphrqi.features.spectral import EigenvectorObserver, SpectrumObserver
from graphrqi.features.trajectory import TrajectoryObserver
from graphrqi.places.adaptation import Adaptation
from graphrqi.places.other_traffic import OtherTraffic
from graphrqi.samples import Samples
from graphrqi.spectrum import SOLVERS

MOST_SEED: Final = 2**32 - 1
"""Largest seed that the generators of NumPy and scikit-learn accept."""


@dataclass(frozen=True, slots=True)
class Method:
    """A way to classify drivers.

    Attributes:
        name: its key in ``METHODS``.
        summary: one line on it.
        observer: makes an observer of a solver.
        classifier: a key of ``CLASSIFIERS``.
        options: the classifier's.
    """

    name: str
    summary: str
    observer: Callable[[str], Observer]
    classifier: str
    options: Mapping[str, Any] = field(default_factory=dict)


_PLAIN_TREES: Final = partial(DriverObserver, "plain")
_LAYERS: Final = {"hidden": (64, 32), "dropout": 0.0}

# fmt: off
_METHODS: Final = (
    Method("majority", "the most frequent class of the training data, without features",
           Observer, "majority"),
    Method("graphrqi", "the paper: rows of the largest-end eigenvectors, perceptron, squared error",
           EigenvectorObserver, "mlp", {"loss": "squared-error", **_LAYERS}),
    Method("logistic", "the paper's ablation: logistic regression on the rows that graphrqi sees",
           EigenvectorObserver, "logistic"),
    Method("svm", "the paper's ablation: support vector machine on the rows that graphrqi sees",
           EigenvectorObserver, "svm"),
    Method("lstm", "the paper's ablation: long short-term memory along the rows that graphrqi sees",
           EigenvectorObserver, "lstm"),
    Method("dane", "dynamic attributed network embedding (Li et al. 2017), perceptron",
           EmbeddingObserver, "mlp", _LAYERS),
    Method("cheung", "lasso on trajectory features (Cheung et al. 2018)",
           TrajectoryObserver, "lasso"),
    Method("forest", "random forest on motion and interaction, without graph or inference",
           _PLAIN_TREES, "forest"),
    Method("boosted", "gradient-boosted trees on the same, without graph or inference",
           _PLAIN_TREES, "boosted"),
    Method("graphrqi-invariant",
           "the spectrum alone, independent of sign, rotation, order and size",
           SpectrumObserver, "mlp", _LAYERS),
    Method("graphrqi-plus",
           "boosted trees on spectrum, graph signals, motion, interaction and inferred drivers",
           partial(DriverObserver, "raw"), "boosted",
           {"rounds": 320, "max_leaves": 31, "max_depth": 7, "feature_share": 0.15}),
)
# fmt: on

METHODS: Final[Registry[Method]] = Registry(
    "method",
    "graphrqi.methods",
    {
        **{method.name: method for method in _METHODS},
    },
)
"""The methods by name."""


@dataclass(frozen=True, slots=True)
class Model:
    """A trained method.

    Attributes:
        method: the method that was trained.
        solver: its observer's eigenvalue solver.
        classifier: the trained classifier.
        shares: share of each behaviour in training; they sum to 1.
        card: training data and scores, as JSON values.
        other: networks for other traffic; None if the classifier answers everywhere.
        adaptation: correction of the answers for a recording site, if any.
        classes: the behaviours that it knows: the six, then those of one's own.
    """

    method: Method
    solver: str
    classifier: Classifier
    shares: tuple[float, ...]
    card: Mapping[str, Any]
    other: OtherTraffic | None = None
    adaptation: Adaptation | None = None
    classes: tuple[Behavior, ...] = BEHAVIORS


def make_observer(method: str, solver: str = "graphrqi") -> Observer:
    """A fresh observer.

    Args:
        method: a key of ``METHODS``.
        solver: a key of ``SOLVERS``.
    """
    return METHODS[method].observer(solver)


def train(
    method: str,
    training: Samples,
    validation: Samples | None = None,
    solver: str = "graphrqi",
    seed: int = 0,
    card: Mapping[str, Any] | None = None,
    classes: tuple[Behavior, ...] = BEHAVIORS,
) -> Model:
    """Train a method.

    Args:
        method: a key of ``METHODS``.
        training: the training samples.
        validation: samples of other episodes.
        solver: a key of ``graphrqi.spectrum.SOLVERS``.
        seed: of the randomness.
        card: the model's card.
        classes: what the samples' codes stand for.

    Returns:
        The trained model.

    Raises:
        InputError: for an unknown method or solver, no sample, or a seed out of range.
    """
    chosen = METHODS[method]
    _ = SOLVERS[solver]  # refuses an unknown name before anything is trained
    if not 0 <= seed <= MOST_SEED:
        raise InputError(f"seed: found {seed}, expected 0 to {MOST_SEED}")
    if not len(training):
        raise InputError("training: found no sample, expected at least one")
    classifier = CLASSIFIERS[chosen.classifier](len(classes), **chosen.options)
    held = None
    if validation is not None and len(validation):
        held = (validation.features.astype(np.float64), validation.codes)
    classifier.fit(training.features.astype(np.float64), training.codes, held, seed)
    count = np.bincount(training.codes, minlength=len(classes))
    shares = tuple((count / count.sum()).tolist())
    return Model(chosen, solver, classifier, shares, dict(card or {}), classes=classes)
