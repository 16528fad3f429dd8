"""The contract of all classifiers, and the check of saved arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import CodeArray, FloatArray

HeldOut = tuple[FloatArray, CodeArray] | None
"""Feature vectors and classes of episodes that are not trained on, if there are any."""


class Classifier(Protocol):
    """Learns from feature vectors and gives the probability of each class.

    It is made from the number of classes C and keyword options.
    """

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn from labelled feature vectors; validation rows of other classes are ignored.

        Args:
            features: (n, F) training vectors.
            codes: (n,) classes, 0 to C - 1.
            validation: for early stopping and calibration.
            seed: of the randomness.
        """
        ...

    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities; rows sum to 1 and do not depend on one another."""
        ...

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The learned arrays, to be saved."""
        ...

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """Restore what was saved; `posterior` then answers as before saving.

        Args:
            arrays: as from `arrays`.
            num_features: F, against which the arrays are checked.

        Raises:
            InputError: if the arrays are not those of such a classifier.
        """
        ...


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
    """The arrays of one part, whose names begin with the part's name and a point, without these.

    Examples:
        >>> part_of({"gate.bias": np.zeros(2), "low": np.ones(1)}, "gate")
        {'bias': array([0., 0.])}
    """
    return {k.removeprefix(f"{name}."): v for k, v in arrays.items() if k.startswith(f"{name}.")}
