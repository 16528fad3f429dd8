"""Classifiers: feature vectors in, calibrated probabilities out; standardisation; saved arrays.

References:
    Guo, Pleiss, Sun, Weinberger (2017), On Calibration of Modern Neural Networks, ICML.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import BoolArray, CodeArray, FloatArray, softmax

HeldOut = tuple[FloatArray, CodeArray] | None
"""Feature vectors and classes of episodes that are not trained on, if there are any."""

NEVER: Final = -1e3
"""Score of a class without training rows; its probability is exactly zero."""

FLOOR: Final = 1e-4
"""Probabilities below this count as this when a temperature is fitted: the average of a hundred
trees can be exactly zero for a class that is only rare."""

LEAST_TEMPERATURE, LARGEST_TEMPERATURE = 1e-3, 1e3
"""Temperatures that a model may have; training tries 0.25 to 4."""


class Classifier:
    """Learns from feature vectors and gives the probability of each class.

    Logits are divided by the temperature that fits held-out data best. Derived classes define
    ``_learn`` and ``_untempered``; a plugin may as well define `fit`, `posterior`, `arrays` and
    `restore` on its own.

    Args:
        num_classes: C.
    """

    tempers = True
    """Whether a temperature is fitted at all."""

    _temperature = 1.0

    def __init__(self, num_classes: int) -> None:
        self._num_classes = num_classes

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn from labelled feature vectors; validation rows of other classes are ignored.

        Args:
            features: (n, F) training vectors.
            codes: (n,) classes, 0 to C - 1.
            validation: for early stopping and calibration.
            seed: of the randomness.
        """
        held = None
        if validation is not None and (known := np.isin(validation[1], codes)).any():
            held = validation if known.all() else (validation[0][known], validation[1][known])
        self._learn(features, codes, held, seed)
        self._temperature = 1.0
        if held is not None and self.tempers:
            log_p, rows = self._logits(held[0]), np.arange(held[1].size)
            grid = np.geomspace(0.25, 4.0, 81)
            losses = [-np.log(softmax(log_p / t)[rows, held[1]]).mean() for t in grid]
            self._temperature = float(grid[int(np.argmin(losses))])

    def _learn(self, features: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        """Learn from rows; those held out are of trained classes."""
        raise NotImplementedError

    def _untempered(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities without temperature."""
        raise NotImplementedError

    @property
    def _trained(self) -> BoolArray:
        """(C,) whether each class may have occurred in training."""
        return np.ones(self._num_classes, dtype=bool)

    def _logits(self, features: FloatArray) -> FloatArray:
        """(n, C) logarithms of the probabilities; -inf for classes that were not trained."""
        log_p = np.log(np.maximum(self._untempered(features), FLOOR))
        return np.where(self._trained, log_p, -np.inf)

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities; rows sum to 1 and do not depend on one another."""
        if self._temperature == 1.0:
            return self._untempered(features)
        return softmax(self._logits(features) / self._temperature)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The learned arrays, to be saved."""
        return {"temperature": np.array([self._temperature])}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """Restore what was saved; `posterior` then answers as before saving.

        Args:
            arrays: as from `arrays`.
            num_features: F, against which the arrays are checked.

        Raises:
            InputError: if the arrays are not those of such a classifier.
        """
        found = float(saved(arrays, "temperature", (1,))[0])
        if not LEAST_TEMPERATURE <= found <= LARGEST_TEMPERATURE:
            raise InputError(
                f"temperature: found {found:g}, expected a number from {LEAST_TEMPERATURE:g} to "
                f"{LARGEST_TEMPERATURE:g}"
            )
        self._temperature = found


def saved(
    arrays: Mapping[str, NDArray[Any]], name: str, shape: tuple[int | None, ...] | None = None
) -> NDArray[Any]:
    """A saved array of finite numbers.

    Args:
        arrays: all saved arrays by name.
        name: of the array.
        shape: the expected shape; a length of None, or no shape at all, accepts any.

    Raises:
        InputError: if it is missing, has another shape or holds numbers that are not finite.
    """
    if name not in arrays:
        raise InputError(f"{name}: found no such array, expected one")
    found = np.asarray(arrays[name])
    if found.dtype.kind != "f" or not np.isfinite(found).all():
        raise InputError(f"{name}: found {found.dtype} or gaps, expected finite numbers")
    if shape is not None and (
        found.ndim != len(shape)
        or any(want not in (None, is_) for want, is_ in zip(shape, found.shape, strict=True))
    ):
        raise InputError(f"{name}: found shape {found.shape}, expected {shape}")
    return found


def part_of(arrays: Mapping[str, NDArray[Any]], name: str) -> dict[str, NDArray[Any]]:
    """The arrays of one part, whose names begin with the part's name and a point, without these."""
    return {k.removeprefix(f"{name}."): v for k, v in arrays.items() if k.startswith(f"{name}.")}


CLIP: Final = 8.0
"""Standardised features are clipped here, so that a single wrong position does not decide the
class."""

AT_ONCE: Final = 16
"""Features whose deviation is found at once: the squares of all would take gigabytes."""


@dataclass(frozen=True, slots=True)
class Standardisation:
    """Mean (F,) and deviation (F,), 1 where a feature does not vary, of the training data.

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
