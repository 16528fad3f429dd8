"""Kernel: L D L^T of a sparse symmetric matrix at eight shifts at once.

Every number is eight numbers, one per shift, so that it runs in vector registers. The signs of the
pivots count the eigenvalues below each shift (Sylvester's law of inertia).

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphrqi.spectrum.certified.eight import (
    any_below,
    inverse,
    larger,
    less,
    load,
    more,
    plus,
    positive,
    spread,
    store,
    times,
)
from graphrqi.spectrum.certified.prepared import Floats, Prepared
from sim.compiled import vectorised


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
