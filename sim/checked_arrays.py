"""Arrays that a frozen dataclass takes: cast, their shapes checked, read-only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view


def check_and_freeze(owner: object, dtypes: dict[str, tuple[Any, tuple[int | None, ...]]]) -> None:
    """Cast, check shapes of, and make read-only the array fields of a frozen dataclass.

    A length of None in a shape stands for any.
    """
    for name, (dtype, shape) in dtypes.items():
        array = np.asarray(getattr(owner, name), dtype=dtype)
        if array.ndim != len(shape) or any(
            want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
        ):
            expected = tuple("any" if s is None else s for s in shape)
            raise InputError(
                f"{type(owner).__name__}.{name}: found shape {array.shape}, expected {expected}"
            )
        object.__setattr__(owner, name, frozen(array))


def cast(name: str, values: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array, or what numpy makes one of, as another type, if no number changes by that."""
    try:
        found = np.asarray(values)
    except ValueError as error:  # lists of different lengths
        raise InputError(f"{name}: found {values!r:.60}, expected an array ({error})") from error
    if found.size == 0:
        return np.empty(found.shape, dtype)
    if found.dtype.kind in "biuf":
        with np.errstate(invalid="ignore"):  # infinity as a whole number
            made = found.astype(dtype, copy=False)
        if dtype.kind == "f" or np.array_equal(made, found):
            return made
    raise InputError(f"{name}: found {found.dtype} values, expected {dtype}")
