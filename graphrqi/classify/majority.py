"""The majority class: the baseline of every accuracy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.checks import saved
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut


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
