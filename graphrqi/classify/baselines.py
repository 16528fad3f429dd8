"""The baselines: majority, logistic regression, lasso and support vectors, fitted by scikit-learn.

All but the majority standardise the features and compute linear scores of these, or of their
Gaussian kernel with the support vectors; the scores' softmax are the probabilities.

References:
    Tibshirani (1996), J. R. Statist. Soc. B 58, 267: the lasso. Cheung, Bera, Kubin, Gray, Manocha
    (2018), Identifying Driver Behaviors Using Trajectory Features for Vehicle Navigation, IROS.
    Platt (1999), Probabilistic outputs for support vector machines.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.checks import of_trained_classes, saved
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.softmax import multinomial, softmax
from graphrqi.classify.standardisation import Standardisation

CHUNK: Final = 4096
"""Rows whose kernel matrix is in memory at once, about 100 MB."""


class Majority:
    """Answers with the shares of the training classes, whatever the features.

    Args:
        num_classes: C.
    """

    def __init__(self, num_classes: int) -> None:
        self._share = np.full(num_classes, 1.0 / num_classes)

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Count the classes."""
        self._share = np.bincount(codes, minlength=self._share.size) / codes.size

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) the same row for every sample."""
        return np.tile(self._share, (len(features), 1))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The shares."""
        return {"share": self._share}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._share = saved(arrays, "share", self._share.shape)


class Logistic:
    """Multinomial logistic regression.

    Args:
        num_classes: C.
        inverse_penalty: one over the penalty of the squared weights; larger fits closer.
    """

    def __init__(self, num_classes: int, inverse_penalty: float = 1.0) -> None:
        self._num_classes = num_classes
        self._inverse_penalty = inverse_penalty
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._weights, self._bias = np.zeros((0, num_classes)), np.zeros(num_classes)

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        self._inputs = Standardisation.of(features)
        held = of_trained_classes(validation, codes)
        x = self._inputs.apply(features)
        self._learn(
            x, codes, None if held is None else (self._inputs.apply(held[0]), held[1]), seed
        )

    def _learn(self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        """Learn weights and biases from standardised features."""
        self._weights, self._bias = multinomial(x, codes, self._num_classes, self._inverse_penalty)

    def _link(self, held: HeldOut, x: FloatArray, codes: CodeArray) -> None:
        """Turn scores into those of probabilities, by held-out rows if these show every class."""
        if held is not None and np.isin(codes, held[1]).all():
            x, codes = held
        weights, bias = multinomial(self._scores(x), codes, self._num_classes)
        self._weights, self._bias = self._weights @ weights, self._bias @ weights + bias

    def _scores(self, x: FloatArray) -> FloatArray:
        """(n, C) scores of standardised features."""
        return x @ self._weights + self._bias

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return softmax(self._scores(self._inputs.apply(features)))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Standardisation, weights and biases."""
        return {**self._inputs.arrays(), "weights": self._weights, "bias": self._bias}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._inputs = Standardisation.restored(arrays, num_features)
        self._weights = saved(arrays, "weights", (num_features, self._num_classes))
        self._bias = saved(arrays, "bias", (self._num_classes,))


class Lasso(Logistic):
    """Linear scores with an L1 penalty that keeps few features, one regression per class.

    Args:
        num_classes: C.
        penalties: candidate penalties of the absolute weights; the one with the least squared error
            on validation data is chosen, or the middle one without such data.
    """

    def __init__(
        self, num_classes: int, penalties: tuple[float, ...] = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
    ) -> None:
        super().__init__(num_classes)
        self._penalties = penalties

    def _learn(self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        from sklearn.linear_model import Lasso as Regression

        onto = np.eye(self._num_classes)
        mean = onto[codes].mean(axis=0)
        tried = self._penalties
        if held is None:
            tried = (tried[len(tried) // 2],)
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

    Args:
        num_classes: C.
        penalty: of margin violations (libsvm's C).
        max_rows: largest number of training rows, drawn at random; the cost is quadratic in it.
    """

    def __init__(self, num_classes: int, penalty: float = 1.0, max_rows: int = 4000) -> None:
        super().__init__(num_classes)
        self._penalty = penalty
        self._max_rows = max_rows
        self._vectors = np.zeros((0, 0))

    def _learn(self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        from sklearn.svm import SVC

        rows = np.sort(np.random.default_rng(seed).permutation(codes.size)[: self._max_rows])
        x, codes = x[rows], codes[rows]
        duals = np.zeros((rows.size, self._num_classes))
        self._bias = np.full(self._num_classes, -1.0)  # a class without rows is never answered
        for code in range(self._num_classes):
            if 0 < np.count_nonzero(codes == code) < codes.size:
                machine = SVC(C=self._penalty, gamma=1.0 / x.shape[1]).fit(x, codes == code)
                duals[machine.support_, code] = machine.dual_coef_[0]
                self._bias[code] = machine.intercept_[0]
        used = duals.any(axis=1)
        self._vectors, self._weights = x[used], duals[used]
        self._link(of_trained_classes(held, codes), x, codes)

    def _scores(self, x: FloatArray) -> FloatArray:
        out = np.empty((len(x), self._num_classes))
        own = (self._vectors**2).sum(axis=1)
        for first in range(0, len(x), CHUNK):
            part = x[first : first + CHUNK]
            square = (part**2).sum(axis=1)[:, None] + own - 2.0 * part @ self._vectors.T
            kernel = np.exp(np.minimum(-square, 0.0) / max(x.shape[1], 1))
            out[first : first + CHUNK] = kernel @ self._weights + self._bias
        return out

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Support vectors beside the others'."""
        return {**super().arrays(), "vectors": self._vectors}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._vectors = saved(arrays, "vectors", (None, num_features))
        self._inputs = Standardisation.restored(arrays, num_features)
        self._weights = saved(arrays, "weights", (len(self._vectors), self._num_classes))
        self._bias = saved(arrays, "bias", (self._num_classes,))
