"""What classifiers check alike: rows they are given and arrays they are restored from."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify.contract import CodeArray, FloatArray


def of_trained_classes(
    validation: tuple[FloatArray, CodeArray] | None, codes: CodeArray
) -> tuple[FloatArray, CodeArray] | None:
    """Validation data without rows of classes that are not learned; None if nothing is left.

    Args:
        validation: vectors and classes.
        codes: (n,) classes of the training rows.
    """
    if validation is None:
        return None
    known = np.isin(validation[1], codes)
    if known.all() and known.size:
        return validation
    return (validation[0][known], validation[1][known]) if known.any() else None


def showing_every_class(
    held: tuple[FloatArray, CodeArray] | None, training: tuple[FloatArray, CodeArray]
) -> tuple[FloatArray, CodeArray]:
    """Rows to fit a link to probabilities on: a class that it is not shown it never answers.

    Args:
        held: vectors and classes of other episodes.
        training: of those learned from, taken where the others lack a class of these.
    """
    return held if held is not None and np.isin(training[1], held[1]).all() else training


def saved(
    arrays: dict[str, NDArray[Any]], name: str, shape: tuple[int | None, ...] | None = None
) -> NDArray[Any]:
    """An array of numbers that was saved.

    Args:
        arrays: what was saved.
        name: of the array.
        shape: it must have; None stands for any, as a length too.

    Raises:
        InputError: if there is none, it is of another shape or holds what is not finite.
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


def saved_temperature(arrays: dict[str, NDArray[Any]]) -> float:
    """The temperature that was saved.

    Args:
        arrays: what was saved.

    Raises:
        InputError: if there is none or it is not positive.
    """
    found = float(saved(arrays, "temperature", (1,))[0])
    if found <= 0.0:
        raise InputError(f"temperature: found {found:g}, expected a positive number")
    return found
