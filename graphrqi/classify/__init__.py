"""Classifiers: feature vectors in, a probability for each class out; plain arrays throughout."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from behaviors.registry import Registry
from graphrqi.classify.contract import Classifier

CLASSIFIERS: Final[Registry[Callable[..., Classifier]]] = Registry(
    "classifier",
    "graphrqi.classifiers",
    {
        "boosted": "graphrqi.classify.trees:Boosted",
        "forest": "graphrqi.classify.trees:Forest",
        "lasso": "graphrqi.classify.baselines:Lasso",
        "logistic": "graphrqi.classify.baselines:Logistic",
        "lstm": "graphrqi.classify.networks:LstmClassifier",
        "majority": "graphrqi.classify.baselines:Majority",
        "mlp": "graphrqi.classify.networks:Mlp",
        "svm": "graphrqi.classify.baselines:SupportVectors",
    },
)
"""Every classifier's class by name; it is made of the number of classes and keyword options."""

__all__ = ["CLASSIFIERS", "Classifier"]
