"""Lasso: linear scores with an L1 penalty that keeps few features (scikit-learn fits them).

Each class has a regression onto its indicator, with a penalty chosen on validation data. A
multinomial regression maps the scores to probabilities; it is fitted on validation data if they
show every trained class.

References:
    Tibshirani (1996), J. R. Statist. Soc. B 58, 267; used on trajectory features by Cheung, Bera,
    Kubin, Gray, Manocha (2018), Identifying Driver Behaviors Using Trajectory Features for Vehicle
    Navigation, IROS.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.checks import of_trained_classes, saved, showing_every_class
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.softmax import SoftmaxRegression
from graphrqi.classify.standardisation import Standardisation


class IndicatorLasso:
    """Sparse linear scores of standardised features.

    Args:
        num_classes: C.
        penalties: candidate penalties of the absolute weights; the one with the least squared error
            on validation data is chosen, or the middle one without such data.
    """

    def __init__(
        self, num_classes: int, penalties: tuple[float, ...] = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
    ) -> None:
        self._num_classes = num_classes
        self._penalties = penalties
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._coefficients: FloatArray = np.zeros((0, num_classes))
        self._link = SoftmaxRegression(np.eye(num_classes), np.zeros(num_classes))

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn by coordinate descent; its order is fixed, so the seed has no effect."""
        from sklearn.linear_model import Lasso

        validation = of_trained_classes(validation, codes)
        self._inputs = Standardisation.of(features)
        x = self._inputs.apply(features)
        onto = np.eye(self._num_classes)
        target = onto[codes] - onto[codes].mean(axis=0)
        held, truth = (features, codes) if validation is None else validation
        held = self._inputs.apply(held)
        wanted = self._penalties
        if validation is None:
            wanted = (self._penalties[len(self._penalties) // 2],)
        best = np.inf
        for penalty in wanted:
            learned = Lasso(alpha=penalty, max_iter=5000).fit(x, target)
            coefficients = np.asarray(learned.coef_, dtype=np.float64).T
            missed = onto[truth] - onto[codes].mean(axis=0) - held @ coefficients
            error = float((missed**2).mean())
            if error < best:
                best, self._coefficients = error, coefficients
        held, truth = showing_every_class((held, truth), (x, codes))
        self._link = SoftmaxRegression.fitted(held @ self._coefficients, truth, self._num_classes)

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        return self._link.posterior(self._inputs.apply(features) @ self._coefficients)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Standardisation, coefficients and the regression to probabilities."""
        return {
            **self._inputs.arrays(),
            "coefficients": self._coefficients,
            **self._link.arrays(),
        }

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._inputs = Standardisation.restored(arrays, num_features)
        self._coefficients = saved(arrays, "coefficients", (num_features, self._num_classes))
        self._link = SoftmaxRegression.restored(arrays, self._num_classes, self._num_classes)
