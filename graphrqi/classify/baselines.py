"""The baselines: majority, logistic regression, lasso and support vectors, fitted by scikit-learn.

All compute linear scores of the standardised features, or of their Gaussian kernel with the support
vectors; the scores' softmax are the probabilities.

References:
    Tibshirani (1996), J. R. Statist. Soc. B 58, 267: the lasso. Cheung, Bera, Kubin, Gray, Manocha
    (2018), Identifying Driver Behaviors Using Trajectory Features for Vehicle Navigation, IROS.
    Platt (1999), Probabilistic outputs for support vector machines.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import CodeArray, FloatArray, softmax
from graphrqi.classify.contract import NEVER, Classifier, HeldOut, Standardisation, saved

CHUNK: Final = 4096
"""Rows whose kernel matrix is in memory at once, about 100 MB."""

MOST_ROWS: Final = 4000
"""Most training rows of support vectors, drawn at random; the cost is quadratic in them."""

PENALTIES: Final = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
"""Candidate penalties of the lasso's absolute weights. The one with the least squared error on
held-out data is chosen, or the middle one without such data."""


class Logistic(Classifier):
    """Multinomial logistic regression."""

    tempers = False

    def __init__(self, num_classes: int) -> None:
        super().__init__(num_classes)
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._vectors = np.zeros((0, 0))
        self._weights, self._bias = np.zeros((0, num_classes)), np.zeros(num_classes)

    def _learn(self, features: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        self._inputs = Standardisation.of(features)
        if held is not None:
            held = self._inputs.apply(held[0]), held[1]
        self._regress(self._inputs.apply(features), codes, held, seed)

    def _regress(self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        """Learn weights and biases from standardised features."""
        self._weights, self._bias = _multinomial(x, codes, self._num_classes)

    def _link(self, held: HeldOut, x: FloatArray, codes: CodeArray) -> None:
        """Turn scores into those of probabilities, by held-out rows if these show every class."""
        if held is not None and np.isin(codes, held[1]).all():
            x, codes = held
        weights, bias = _multinomial(self._scores(x), codes, self._num_classes)
        self._weights, self._bias = self._weights @ weights, self._bias @ weights + bias

    def _scores(self, x: FloatArray) -> FloatArray:
        """(n, C) scores of standardised features."""
        if not len(self._vectors):
            return x @ self._weights + self._bias
        from sklearn.metrics.pairwise import rbf_kernel

        out = np.empty((len(x), self._num_classes))
        for first in range(0, len(x), CHUNK):
            rows = slice(first, first + CHUNK)
            out[rows] = rbf_kernel(x[rows], self._vectors) @ self._weights + self._bias
        return out

    @property
    def _trained(self) -> NDArray[np.bool_]:
        return self._bias > 0.5 * NEVER

    def _untempered(self, features: FloatArray) -> FloatArray:
        return softmax(self._scores(self._inputs.apply(features)))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Standardisation, support vectors if any, weights, biases and temperature."""
        learned = {"vectors": self._vectors, "weights": self._weights, "bias": self._bias}
        return {**self._inputs.arrays(), **learned, **super().arrays()}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `Classifier.restore`."""
        super().restore(arrays, num_features)
        self._inputs = Standardisation.restored(arrays, num_features)
        self._vectors = saved(arrays, "vectors", (None, None))
        rows = len(self._vectors) or num_features
        self._weights = saved(arrays, "weights", (rows, self._num_classes))
        self._bias = saved(arrays, "bias", (self._num_classes,))


class Majority(Logistic):
    """Answers with the shares of the training classes, whatever the features."""

    def _regress(self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        count = np.bincount(codes, minlength=self._num_classes)
        self._weights = np.zeros((x.shape[1], self._num_classes))
        self._bias = np.where(count > 0, np.log(np.maximum(count, 1)), NEVER)


class Lasso(Logistic):
    """Linear scores with an L1 penalty that keeps few features, one regression per class."""

    def _regress(self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        from sklearn.linear_model import Lasso as Regression

        onto = np.eye(self._num_classes)
        mean = onto[codes].mean(axis=0)
        tried = PENALTIES if held is not None else PENALTIES[len(PENALTIES) // 2 :][:1]
        judged, true = (x, codes) if held is None else held
        least = np.inf
        for penalty in tried:
            fitted = Regression(alpha=penalty, max_iter=5000).fit(x, onto[codes] - mean)
            weights = np.asarray(fitted.coef_, dtype=np.float64).T
            error = float(((onto[true] - mean - judged @ weights) ** 2).mean())
            if error < least:
                least, self._weights = error, weights
        self._bias = np.zeros(self._num_classes)
        self._link(held, x, codes)


class SupportVectors(Logistic):
    """Support vector machines with a Gaussian kernel, one class against the rest.

    The kernel is exp(-|x - x_i|^2 / F): standardised vectors of F features lie about sqrt(2 F)
    apart.
    """

    def _regress(self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        from sklearn.svm import SVC

        rows = np.sort(np.random.default_rng(seed).permutation(codes.size)[:MOST_ROWS])
        x, codes = x[rows], codes[rows]
        duals = np.zeros((rows.size, self._num_classes))
        self._bias = np.full(self._num_classes, -1.0)  # a class without rows is never answered
        for code in np.unique(codes) if (codes != codes[0]).any() else ():
            machine = SVC(gamma=1.0 / x.shape[1]).fit(x, codes == code)
            duals[machine.support_, code] = machine.dual_coef_[0]
            self._bias[code] = machine.intercept_[0]
        used = duals.any(axis=1)
        self._vectors, self._weights = x[used], duals[used]
        self._link(held, x, codes)


def _multinomial(
    inputs: FloatArray, codes: CodeArray, num_classes: int
) -> tuple[FloatArray, FloatArray]:
    """(F, C) weights and (C,) biases of a regression whose scores' softmax are probabilities."""
    from sklearn.linear_model import LogisticRegression

    present = np.unique(codes)
    if present.size < 2:
        raise InputError(f"codes: found class {present.tolist()} only, expected at least two")
    learned = LogisticRegression(max_iter=500).fit(inputs, codes)
    weights, bias = np.zeros((inputs.shape[1], num_classes)), np.full(num_classes, NEVER)
    bias[present] = 0.0
    shown = present[1:] if present.size == 2 else present  # two classes share one column
    weights[:, shown], bias[shown] = learned.coef_.T, learned.intercept_
    return weights, bias
