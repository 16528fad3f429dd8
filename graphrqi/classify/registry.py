"""The classifiers there are; each is loaded when first asked for."""

from __future__ import annotations

import importlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import lookup
from graphrqi.classify.contract import Classifier

CLASSIFIERS: Final[dict[str, str]] = {
    "boosted": "graphrqi.classify.boosted:Boosted",
    "forest": "graphrqi.classify.forest:Forest",
    "lasso": "graphrqi.classify.lasso:IndicatorLasso",
    "logistic": "graphrqi.classify.logistic:Logistic",
    "lstm": "graphrqi.classify.lstm:Lstm",
    "majority": "graphrqi.classify.majority:Majority",
    "mlp": "graphrqi.classify.mlp:Mlp",
    "svm": "graphrqi.classify.svm:SupportVectors",
}
"""Where each classifier lives, as "module:class"."""


def make_classifier(name: str, num_classes: int, **options: Any) -> Classifier:
    """An unlearned classifier.

    Args:
        name: a key of ``CLASSIFIERS``.
        num_classes: C.
        options: of that classifier's constructor.

    Returns:
        The classifier.

    Raises:
        InputError: if there is no such classifier.
    """
    module, attribute = lookup(CLASSIFIERS, name, "classifier").split(":")
    made: Classifier = getattr(importlib.import_module(module), attribute)(num_classes, **options)
    return made


def restore_classifier(
    name: str, num_classes: int, options: dict[str, Any], arrays: dict[str, NDArray[np.float32]]
) -> Classifier:
    """A classifier as it was saved."""
    classifier = make_classifier(name, num_classes, **options)
    classifier.restore(arrays)
    return classifier
