"""Standardisation of features by mean and deviation of the training data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import FloatArray
from graphrqi.classify.contract import saved

CLIP: Final = 8.0
"""Standardised features are clipped here, so that a single wrong position does not decide the
class."""

AT_ONCE: Final = 16
"""Features whose deviation is found at once: the squares of all would take gigabytes."""


@dataclass(frozen=True, slots=True)
class Standardisation:
    """Mean and deviation of each feature.

    Attributes:
        mean: (F,) of the training data.
        scale: (F,) standard deviation; 1 where a feature does not vary.

    Examples:
        >>> s = Standardisation.of(np.array([[0.0, 5.0], [2.0, 5.0]]))
        >>> s.apply(np.array([[3.0, 5.0]]))
        array([[2., 0.]])
    """

    mean: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, features: NDArray[np.floating]) -> Standardisation:
        """The standardisation of training vectors (n, F), of single or double precision."""
        mean, spread = np.empty((2, features.shape[1]))
        for first in range(0, mean.size, AT_ONCE):
            columns = slice(first, first + AT_ONCE)
            mean[columns] = features[:, columns].mean(axis=0, dtype=np.float64)
            spread[columns] = features[:, columns].std(axis=0, dtype=np.float64)
        return cls(mean, np.where(spread > 1e-6, spread, 1.0))

    def apply(self, features: FloatArray) -> FloatArray:
        """(n, F) standardised and clipped vectors."""
        values = np.asarray(features - self.mean)
        values /= self.scale  # in place: crowds have arrays of 100 MB
        return np.clip(values, -CLIP, CLIP, out=values)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays to save."""
        return {"mean": self.mean, "scale": self.scale}

    @classmethod
    def restored(cls, arrays: dict[str, NDArray[Any]], num_features: int) -> Standardisation:
        """From what `arrays` gave; InputError if a feature has no mean or positive deviation."""
        mean, scale = (saved(arrays, name, (num_features,)) for name in ("mean", "scale"))
        if not (scale > 0.0).all():
            raise InputError(f"scale: found {scale.min():g}, expected positive numbers")
        return cls(mean, scale)
