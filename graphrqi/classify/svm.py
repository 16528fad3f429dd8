"""Support vector machine with a Gaussian kernel, one class against the rest.

scikit-learn fits the machines; the decision function of each class is kept: the sum over support
vectors of a_i exp(-gamma |x - x_i|^2), plus b. A multinomial regression maps the margins to
probabilities (the multi-class form of Platt 1999); it is fitted on validation data if they show
every trained class.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.checks import of_trained_classes, saved, showing_every_class
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.softmax import SoftmaxRegression
from graphrqi.classify.standardisation import Standardisation

_CHUNK: Final = 4096
"""Rows whose kernel matrix is in memory at once, about 100 MB."""


class SupportVectors:
    """Gaussian-kernel machines trained on a bounded sample of the training data.

    Args:
        num_classes: C.
        penalty: of margin violations (libsvm's C).
        max_rows: largest number of training rows, drawn at random; the cost is quadratic in it.
    """

    def __init__(self, num_classes: int, penalty: float = 1.0, max_rows: int = 4000) -> None:
        self._num_classes = num_classes
        self._penalty = penalty
        self._max_rows = max_rows
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._vectors: FloatArray = np.zeros((0, 0))
        self._duals: FloatArray = np.zeros((0, num_classes))
        self._offset: FloatArray = np.zeros(num_classes)
        self._link = SoftmaxRegression(np.eye(num_classes), np.zeros(num_classes))

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        from sklearn.svm import SVC

        rng = np.random.default_rng(seed)
        rows = np.sort(rng.permutation(codes.size)[: self._max_rows])
        self._inputs = Standardisation.of(features)
        x, y = self._inputs.apply(features[rows]), codes[rows]
        duals = np.zeros((rows.size, self._num_classes))
        self._offset = np.full(self._num_classes, -1.0)  # a class without rows is never answered
        for code in range(self._num_classes):
            if 0 < np.count_nonzero(y == code) < y.size:
                machine = SVC(C=self._penalty, gamma=self._gamma(x.shape[1]))
                machine.fit(x, y == code)
                duals[machine.support_, code] = machine.dual_coef_[0]
                self._offset[code] = machine.intercept_[0]
        used = duals.any(axis=1)
        self._vectors, self._duals = x[used], duals[used]
        held = of_trained_classes(validation, y)
        shown, truth = showing_every_class(held, (features[rows], y))
        self._link = SoftmaxRegression.fitted(self._margins(shown), truth, self._num_classes)

    @staticmethod
    def _gamma(width: int) -> float:
        """Kernel width: standardised vectors lie about sqrt(2 F) apart."""
        return 1.0 / max(width, 1)

    def _margins(self, features: FloatArray) -> FloatArray:
        x = self._inputs.apply(features)
        out = np.empty((len(x), self._num_classes))
        own = (self._vectors**2).sum(axis=1)
        for first in range(0, len(x), _CHUNK):
            part = x[first : first + _CHUNK]
            distance = (part**2).sum(axis=1)[:, None] + own - 2.0 * part @ self._vectors.T
            kernel = np.exp(-self._gamma(x.shape[1]) * np.maximum(distance, 0.0))
            out[first : first + _CHUNK] = kernel @ self._duals + self._offset
        return out

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return self._link.posterior(self._margins(features))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Support vectors, their coefficients, and the regression to probabilities."""
        return {
            **self._inputs.arrays(),
            "vectors": self._vectors,
            "duals": self._duals,
            "offset": self._offset,
            **self._link.arrays(),
        }

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._inputs = Standardisation.restored(arrays, num_features)
        self._vectors = saved(arrays, "vectors", (None, num_features))
        self._duals = saved(arrays, "duals", (len(self._vectors), self._num_classes))
        self._offset = saved(arrays, "offset", (self._num_classes,))
        self._link = SoftmaxRegression.restored(arrays, self._num_classes, self._num_classes)
