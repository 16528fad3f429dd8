"""The baselines: majority, logistic regression, lasso and support vectors, fitted by scikit-learn.

What is learned is kept as arrays, so that a saved model needs no scikit-learn. All but the majority
standardise the features, compute scores from them, and turn these into probabilities by a
multinomial logistic regression, which is fitted on validation data if they show every class.

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
from graphrqi.classify.softmax import SoftmaxRegression
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
        count = np.bincount(codes, minlength=self._share.size).astype(np.float64)
        self._share = count / count.sum()

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) the same row for every sample."""
        return np.tile(self._share, (len(features), 1))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The shares."""
        return {"share": self._share}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._share = np.asarray(saved(arrays, "share", self._share.shape), dtype=np.float64)


class Logistic:
    """Multinomial logistic regression; its scores are the standardised features themselves.

    Args:
        num_classes: C.
        inverse_penalty: one over the penalty of the squared weights; larger fits closer.
    """

    def __init__(self, num_classes: int, inverse_penalty: float = 1.0) -> None:
        self._num_classes = num_classes
        self._inverse_penalty = inverse_penalty
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._learned: dict[str, FloatArray] = {}
        self._link = SoftmaxRegression(np.zeros((0, num_classes)), np.zeros(num_classes))

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        self._inputs = Standardisation.of(features)
        held = of_trained_classes(validation, codes)
        x = self._inputs.apply(features)
        x_held = None if held is None else (self._inputs.apply(held[0]), held[1])
        shown, truth = self._learn(x, codes, x_held, seed)
        self._link = SoftmaxRegression.fitted(
            self._scores(shown), truth, self._num_classes, self._inverse_penalty
        )

    def _learn(
        self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int
    ) -> tuple[FloatArray, CodeArray]:
        """Learn the scores; return the rows and classes that probabilities are fitted on."""
        return x, codes

    def _scores(self, x: FloatArray) -> FloatArray:
        """(n, S) scores of standardised features."""
        return x

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return self._link.posterior(self._scores(self._inputs.apply(features)))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Standardisation, what the scores need, and the regression to probabilities."""
        return {**self._inputs.arrays(), **self._learned, **self._link.arrays()}

    def _shapes(self, num_features: int) -> dict[str, tuple[int | None, ...]]:
        """The arrays that the scores need, and their shapes."""
        return {}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._inputs = Standardisation.restored(arrays, num_features)
        shapes = self._shapes(num_features)
        self._learned = {name: saved(arrays, name, shape) for name, shape in shapes.items()}
        inputs = self._num_classes if shapes else num_features
        self._link = SoftmaxRegression.restored(arrays, inputs, self._num_classes)


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

    def _learn(
        self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int
    ) -> tuple[FloatArray, CodeArray]:
        from sklearn.linear_model import Lasso as Regression

        onto = np.eye(self._num_classes)
        mean = onto[codes].mean(axis=0)
        wanted = self._penalties
        if held is None:
            held, wanted = (x, codes), (wanted[len(wanted) // 2],)
        least = np.inf
        for penalty in wanted:
            fitted = Regression(alpha=penalty, max_iter=5000).fit(x, onto[codes] - mean)
            weights = np.asarray(fitted.coef_, dtype=np.float64).T
            error = float(((onto[held[1]] - mean - held[0] @ weights) ** 2).mean())
            if error < least:
                least, self._learned = error, {"coefficients": weights}
        return _showing_every_class(held, (x, codes))

    def _scores(self, x: FloatArray) -> FloatArray:
        return x @ self._learned["coefficients"]

    def _shapes(self, num_features: int) -> dict[str, tuple[int | None, ...]]:
        return {"coefficients": (num_features, self._num_classes)}


class SupportVectors(Logistic):
    """Support vector machines with a Gaussian kernel, one class against the rest.

    The score of a class is the sum over support vectors of a_i exp(-|x - x_i|^2 / F), plus b:
    standardised vectors of F features lie about sqrt(2 F) apart.

    Args:
        num_classes: C.
        penalty: of margin violations (libsvm's C).
        max_rows: largest number of training rows, drawn at random; the cost is quadratic in it.
    """

    def __init__(self, num_classes: int, penalty: float = 1.0, max_rows: int = 4000) -> None:
        super().__init__(num_classes)
        self._penalty = penalty
        self._max_rows = max_rows

    def _learn(
        self, x: FloatArray, codes: CodeArray, held: HeldOut, seed: int
    ) -> tuple[FloatArray, CodeArray]:
        from sklearn.svm import SVC

        rows = np.sort(np.random.default_rng(seed).permutation(codes.size)[: self._max_rows])
        x, codes = x[rows], codes[rows]
        duals = np.zeros((rows.size, self._num_classes))
        offset = np.full(self._num_classes, -1.0)  # a class without rows is never answered
        for code in range(self._num_classes):
            if 0 < np.count_nonzero(codes == code) < codes.size:
                machine = SVC(C=self._penalty, gamma=1.0 / x.shape[1]).fit(x, codes == code)
                duals[machine.support_, code] = machine.dual_coef_[0]
                offset[code] = machine.intercept_[0]
        used = duals.any(axis=1)
        self._learned = {"vectors": x[used], "duals": duals[used], "offset": offset}
        return _showing_every_class(of_trained_classes(held, codes), (x, codes))

    def _scores(self, x: FloatArray) -> FloatArray:
        vectors, duals = self._learned["vectors"], self._learned["duals"]
        out = np.empty((len(x), self._num_classes))
        own = (vectors**2).sum(axis=1)
        for first in range(0, len(x), CHUNK):
            part = x[first : first + CHUNK]
            square = (part**2).sum(axis=1)[:, None] + own - 2.0 * part @ vectors.T
            kernel = np.exp(np.minimum(-square, 0.0) / max(x.shape[1], 1))
            out[first : first + CHUNK] = kernel @ duals + self._learned["offset"]
        return out

    def _shapes(self, num_features: int) -> dict[str, tuple[int | None, ...]]:
        classes = self._num_classes
        return {
            "vectors": (None, num_features), "duals": (None, classes), "offset": (classes,),
        }  # fmt: skip


def _showing_every_class(
    held: HeldOut, training: tuple[FloatArray, CodeArray]
) -> tuple[FloatArray, CodeArray]:
    """The held-out rows if they show every trained class, else those of the training."""
    return held if held is not None and np.isin(training[1], held[1]).all() else training
