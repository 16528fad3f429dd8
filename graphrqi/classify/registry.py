"""The registry of classifiers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from numpy.typing import NDArray

from behaviors.registry import Registry
from graphrqi.classify.contract import Classifier

CLASSIFIERS: Final[Registry[Callable[..., Classifier]]] = Registry(
    "classifier",
    "graphrqi.classifiers",
    {
        "boosted": "graphrqi.classify.boosted:Boosted",
        "forest": "graphrqi.classify.forest:Forest",
        "lasso": "graphrqi.classify.baselines:Lasso",
        "logistic": "graphrqi.classify.baselines:Logistic",
        "lstm": "graphrqi.classify.networks:LstmClassifier",
        "majority": "graphrqi.classify.baselines:Majority",
        "mlp": "graphrqi.classify.networks:Mlp",
        "svm": "graphrqi.classify.baselines:SupportVectors",
    },
)
"""Every classifier's class by name."""


def make_classifier(name: str, num_classes: int, **options: Any) -> Classifier:
    """A classifier that has not been trained.

    Args:
        name: a key of ``CLASSIFIERS``.
        num_classes: C.
        options: of that classifier's constructor.

    Returns:
        The classifier. Raises: InputError: if no classifier has this name.
    """
    return CLASSIFIERS[name](num_classes, **options)


def restore_classifier(
    name: str,
    num_classes: int,
    num_features: int,
    options: dict[str, Any],
    arrays: dict[str, NDArray[Any]],
) -> Classifier:
    """A classifier as it was saved.

    Args:
        name: a key of ``CLASSIFIERS``.
        num_classes: C.
        num_features: F.
        options: of that classifier's constructor.
        arrays: as from `Classifier.arrays`.

    Returns:
        The classifier.

    Raises:
        InputError: if no classifier has this name, or the arrays do not fit it.
    """
    classifier = make_classifier(name, num_classes, **options)
    classifier.restore(arrays, num_features)
    return classifier
