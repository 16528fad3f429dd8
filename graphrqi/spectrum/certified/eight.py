"""Eight numbers at a time: the arithmetic that all kernels of the tracker are written in.

An (n, 8) array holds eight systems, or eight vectors, side by side. A row of it is a tuple of eight
floats, which the compiler keeps in vector registers; it fuses products with sums.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Eight: TypeAlias = tuple[float, float, float, float, float, float, float, float]
Floats: TypeAlias = NDArray[np.float64]

F = TypeVar("F", bound=Callable[..., object])


def _inlined(function: F) -> F:
    """Compile for the calls of kernels; products and sums may be fused."""
    options: Any = {"fastmath": {"contract"}, "no_cpython_wrapper": True}
    return cast(F, njit(error_model="numpy", **options)(function))


@_inlined
def load(a: Floats, p: int) -> Eight:
    """Row p >= 0 of an (n, 8) array."""
    r = np.uint64(p)  # unsigned indices are not checked for negative ones
    return a[r, 0], a[r, 1], a[r, 2], a[r, 3], a[r, 4], a[r, 5], a[r, 6], a[r, 7]


@_inlined
def store(a: Floats, p: int, x: Eight) -> None:
    """Write x to row p >= 0 of an (n, 8) array."""
    r = np.uint64(p)
    a[r, 0], a[r, 1], a[r, 2], a[r, 3] = x[0], x[1], x[2], x[3]
    a[r, 4], a[r, 5], a[r, 6], a[r, 7] = x[4], x[5], x[6], x[7]


@_inlined
def spread(v: float) -> Eight:
    """Repeat one number eight times."""
    return v, v, v, v, v, v, v, v


@_inlined
def plus(x: Eight, v: float, y: Eight) -> Eight:
    """X + v y for one number v."""
    return (
        x[0] + v * y[0], x[1] + v * y[1], x[2] + v * y[2], x[3] + v * y[3],
        x[4] + v * y[4], x[5] + v * y[5], x[6] + v * y[6], x[7] + v * y[7],
    )  # fmt: skip


@_inlined
def more(x: Eight, y: Eight, z: Eight) -> Eight:
    """X + y z."""
    return (
        x[0] + y[0] * z[0], x[1] + y[1] * z[1], x[2] + y[2] * z[2], x[3] + y[3] * z[3],
        x[4] + y[4] * z[4], x[5] + y[5] * z[5], x[6] + y[6] * z[6], x[7] + y[7] * z[7],
    )  # fmt: skip


@_inlined
def less(x: Eight, y: Eight, z: Eight) -> Eight:
    """X - y z."""
    return (
        x[0] - y[0] * z[0], x[1] - y[1] * z[1], x[2] - y[2] * z[2], x[3] - y[3] * z[3],
        x[4] - y[4] * z[4], x[5] - y[5] * z[5], x[6] - y[6] * z[6], x[7] - y[7] * z[7],
    )  # fmt: skip


@_inlined
def times(x: Eight, y: Eight) -> Eight:
    """X y."""
    return (
        x[0] * y[0], x[1] * y[1], x[2] * y[2], x[3] * y[3],
        x[4] * y[4], x[5] * y[5], x[6] * y[6], x[7] * y[7],
    )  # fmt: skip


@_inlined
def inverse(x: Eight) -> Eight:
    """1 / x."""
    return (
        1.0 / x[0], 1.0 / x[1], 1.0 / x[2], 1.0 / x[3],
        1.0 / x[4], 1.0 / x[5], 1.0 / x[6], 1.0 / x[7],
    )  # fmt: skip


@_inlined
def larger(x: Eight, y: Eight) -> Eight:
    """max(x, |y|)."""
    return (
        max(x[0], abs(y[0])), max(x[1], abs(y[1])), max(x[2], abs(y[2])), max(x[3], abs(y[3])),
        max(x[4], abs(y[4])), max(x[5], abs(y[5])), max(x[6], abs(y[6])), max(x[7], abs(y[7])),
    )  # fmt: skip


@_inlined
def positive(x: Eight) -> Eight:
    """1 where x > 0, else 0."""
    return (
        1.0 if x[0] > 0.0 else 0.0, 1.0 if x[1] > 0.0 else 0.0,
        1.0 if x[2] > 0.0 else 0.0, 1.0 if x[3] > 0.0 else 0.0,
        1.0 if x[4] > 0.0 else 0.0, 1.0 if x[5] > 0.0 else 0.0,
        1.0 if x[6] > 0.0 else 0.0, 1.0 if x[7] > 0.0 else 0.0,
    )  # fmt: skip


@_inlined
def any_below(x: Eight, v: float) -> bool:
    """Whether one of the eight numbers is below v in size."""
    least = min(min(abs(x[0]), abs(x[1])), min(abs(x[2]), abs(x[3])))
    rest = min(min(abs(x[4]), abs(x[5])), min(abs(x[6]), abs(x[7])))
    return min(least, rest) < v
