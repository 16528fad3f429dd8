"""Multinomial logistic regression on standardised features (scikit-learn fits it)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.softmax import SoftmaxRegression
from graphrqi.classify.standardisation import Standardisation


class Logistic:
    """A linear classifier whose outputs are probabilities.

    Args:
        num_classes: C.
        inverse_penalty: one over the penalty of the squared weights; larger fits closer.
    """

    def __init__(self, num_classes: int, inverse_penalty: float = 1.0) -> None:
        self._num_classes = num_classes
        self._inverse_penalty = inverse_penalty
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._regression = SoftmaxRegression(np.zeros((0, num_classes)), np.zeros(num_classes))

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; the problem is convex, so validation data and seed have no effect."""
        self._inputs = Standardisation.of(features)
        self._regression = SoftmaxRegression.fitted(
            self._inputs.apply(features), codes, self._num_classes, self._inverse_penalty
        )

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return self._regression.posterior(self._inputs.apply(features))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Standardisation, weights and bias."""
        return {**self._inputs.arrays(), **self._regression.arrays()}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._inputs = Standardisation.restored(arrays, num_features)
        self._regression = SoftmaxRegression.restored(arrays, num_features, self._num_classes)
