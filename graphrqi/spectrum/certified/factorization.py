"""Kernel: L D L^T of a sparse symmetric matrix at eight shifts at once.

Every number is a tuple of eight, one per shift, which the compiler keeps in vector registers; it
fuses products with sums. An (n, 8) array holds eight systems, or eight vectors, side by side. The
signs of the pivots count the eigenvalues below each shift (Sylvester's law of inertia).

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar, cast

import numpy as np
from numba import njit

from graphrqi.spectrum.certified.prepared import Floats, Prepared
from sim.compiled import vectorised

Eight: TypeAlias = tuple[float, float, float, float, float, float, float, float]

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


class Counts(NamedTuple):
    """Eight shifts, and what their factorisations say.

    Attributes:
        shift: (1, 8).
        above: (1, 8) number of eigenvalues above each.
        growth: (1, 8) largest pivot: times 2.2e-16, the size of the shift's rounding error.
    """

    shift: Floats
    above: Floats
    growth: Floats


class Factor(NamedTuple):
    """Memory that a factorisation writes on.

    Attributes:
        lower: (f, 8) the factor times its pivots.
        pivots: (d, 8) the inverse pivots.
        column: (d, 8) a dense column.
    """

    lower: Floats
    pivots: Floats
    column: Floats


def new_counts() -> Counts:
    """Memory for eight shifts."""
    return Counts(np.empty((1, 8)), np.empty((1, 8)), np.empty((1, 8)))


@vectorised
def factor_and_solve(
    matrix: Prepared,
    counts: Counts,
    tiny: float,
    solves: int,
    factor: Factor,
    x: Floats,
) -> None:
    """Factorise M - s I for eight shifts s and solve one system with each.

    Column by column: what the earlier columns subtract from one is gathered in a dense column.

    Args:
        matrix: M.
        counts: its shifts are read, the rest is overwritten.
        tiny: size of the smallest pivot allowed.
        solves: how often each inverse is applied; 0 only counts.
        factor: overwritten.
        x: (d, 8) right-hand sides in elimination order; the solutions afterwards.
    """
    starts, rows, entries = matrix.starts, matrix.rows, matrix.entries
    row_starts, columns, positions = matrix.row_starts, matrix.columns, matrix.positions
    lower, pivots, column = factor.lower, factor.pivots, factor.column
    d = matrix.diagonal.size
    shift = load(counts.shift, 0)
    number, size = spread(0.0), spread(0.0)
    for i in range(d):
        for m in range(starts[i], starts[i + 1]):
            store(column, rows[m], spread(entries[m]))
        b = plus(spread(matrix.diagonal[i]), -1.0, shift)
        xi = load(x, i)
        for p in range(row_starts[i], row_starts[i + 1]):
            j, m = columns[p], positions[p]
            w = load(lower, m)
            ratio = times(w, load(pivots, j))
            b = less(b, w, ratio)
            if solves > 0:
                xi = less(xi, w, load(x, j))
            for q in range(m + 1, starts[j + 1]):
                store(column, rows[q], less(load(column, rows[q]), load(lower, q), ratio))
        if any_below(b, tiny):
            store(pivots, i, b)
            for q in range(8):
                if abs(pivots[i, q]) < tiny:
                    pivots[i, q] = -tiny if pivots[i, q] < 0.0 else tiny
            b = load(pivots, i)
        number = plus(number, 1.0, positive(b))
        size = larger(size, b)
        r = inverse(b)
        store(pivots, i, r)
        for m in range(starts[i], starts[i + 1]):
            store(lower, m, load(column, rows[m]))
        store(x, i, times(xi, r))
    store(counts.above, 0, number)
    store(counts.growth, 0, size)
    # Two sums side by side: each addition waits for the one before it.
    for again in range(solves):
        if again:
            for i in range(d):
                xi, half = load(x, i), spread(0.0)
                p, end = row_starts[i], row_starts[i + 1]
                while p + 1 < end:
                    xi = less(xi, load(lower, positions[p]), load(x, columns[p]))
                    half = less(half, load(lower, positions[p + 1]), load(x, columns[p + 1]))
                    p += 2
                if p < end:
                    xi = less(xi, load(lower, positions[p]), load(x, columns[p]))
                store(x, i, times(plus(xi, 1.0, half), load(pivots, i)))
        for j in range(d - 1, -1, -1):
            total = half = spread(0.0)
            p, end = starts[j], starts[j + 1]
            while p + 1 < end:
                total = more(total, load(lower, p), load(x, rows[p]))
                half = more(half, load(lower, p + 1), load(x, rows[p + 1]))
                p += 2
            if p < end:
                total = more(total, load(lower, p), load(x, rows[p]))
            store(x, j, less(load(x, j), plus(total, 1.0, half), load(pivots, j)))
