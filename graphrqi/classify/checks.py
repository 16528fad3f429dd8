"""Checks that classifiers share: of validation rows and of the arrays they are restored from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.contract import CodeArray, HeldOut

LEAST_TEMPERATURE, LARGEST_TEMPERATURE = 1e-3, 1e3
"""Temperatures that a model may have (0.25 to 4 are tried in training; far smaller ones make
probabilities that are not numbers)."""


def of_trained_classes(validation: HeldOut, codes: CodeArray) -> HeldOut:
    """Validation data without rows of classes that are not in the training's ``codes``, or None."""
    if validation is None:
        return None
    known = np.isin(validation[1], codes)
    if known.all() and known.size:
        return validation
    return (validation[0][known], validation[1][known]) if known.any() else None


def saved(
    arrays: dict[str, NDArray[Any]], name: str, shape: tuple[int | None, ...] | None = None
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


def saved_temperature(arrays: dict[str, NDArray[Any]]) -> float:
    """The saved temperature; InputError if it is missing or no divisor of logits."""
    found = float(saved(arrays, "temperature", (1,))[0])
    if not LEAST_TEMPERATURE <= found <= LARGEST_TEMPERATURE:
        raise InputError(
            f"temperature: found {found:g}, expected a number from {LEAST_TEMPERATURE:g} to "
            f"{LARGEST_TEMPERATURE:g}"
        )
    return found
