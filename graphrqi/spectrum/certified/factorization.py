"""Kernels: a Laplacian's elimination order and factor pattern, and L D L^T at eight shifts at once.

Every number of a factorisation is a tuple of eight, one per shift, which the compiler keeps in
vector registers; it fuses products with sums. An (n, 8) array holds eight systems, or eight
vectors, side by side. The signs of the pivots count the eigenvalues below each shift.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (Sylvester's law of inertia).
    Liu (1990), The role of elimination trees in sparse factorization, SIMAX 11, 134. Cuthill, McKee
    (1969), Reducing the bandwidth of sparse symmetric matrices, Proc. 24th ACM Conf., 157-172.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from sim.compiled import compiled, vectorised

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]
Bools: TypeAlias = NDArray[np.bool_]
Eight: TypeAlias = tuple[float, float, float, float, float, float, float, float]

F = TypeVar("F", bound=Callable[..., object])


class Prepared(NamedTuple):
    """M = L or -L in the pattern of its factor; rows and columns are in elimination order.

    Attributes:
        order: (d,) row of the Laplacian at each place of the elimination order.
        starts: (d + 1,) column starts of the factor.
        rows: (f,) its rows, ascending in each column.
        row_starts: (d + 1,) its row starts.
        columns: (f,) its columns, by row.
        positions: (f,) where those entries are in the columns.
        entries: (f,) the matrix's entries, 0 where the factor fills in.
        diagonal: (d,) its diagonal.
        label: (d,) connected component of each place.
        components: how many there are.
        work: multiplications a factorisation takes.
        scale: largest entry of the Laplacian's diagonal, at least 1.
    """

    order: Ints
    starts: Ints
    rows: Ints
    row_starts: Ints
    columns: Ints
    positions: Ints
    entries: Floats
    diagonal: Floats
    label: Ints
    components: int
    work: float
    scale: float


def prepare(graph: TrafficGraph, sign: float = 1.0) -> Prepared:
    """The Laplacian of a graph times 1 or -1, in reverse Cuthill-McKee order."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    order = reverse_cuthill_mckee(graph.laplacian, symmetric_mode=True).astype(np.int32)
    return _prepare(graph.indptr, graph.indices, graph.values, sign, order)


@compiled
def _prepare(indptr: Ints, indices: Ints, values: Floats, sign: float, order: Ints) -> Prepared:
    """Symbolic factorisation along the elimination tree; arguments as of `prepare`."""
    d = order.size
    place = np.empty(d, np.int32)
    low_starts, low_ends = np.empty(d + 1, np.int32), np.empty(d + 1, np.int32)
    low_starts[0] = low_ends[0] = 0
    for k in range(d):
        r = order[k]
        place[r] = k
        low_starts[k + 1] = low_ends[k + 1] = low_starts[k] + indptr[r + 1] - indptr[r]
    # The lower triangle by rows, columns ascending. The loop does not branch: an entry that is not
    # below the diagonal is overwritten by the next one.
    low, low_values = np.empty(indices.size + 1, np.int32), np.empty(indices.size + 1, np.float64)
    diagonal = np.empty(d, np.float64)
    largest = 1.0
    for k in range(d):
        r = order[k]
        for p in range(indptr[r], indptr[r + 1]):
            i = place[indices[p]]
            t = low_ends[i]
            low[t], low_values[t] = k, sign * values[p]
            low_ends[i] = t + (i > k)
            if i == k:
                diagonal[k] = sign * values[p]
                largest = max(largest, values[p])
    # The columns of every row of the factor, along the elimination tree.
    parent, mark = np.empty(d, np.int32), np.empty(d, np.int32)
    starts, row_starts = np.zeros(d + 1, np.int32), np.empty(d + 1, np.int32)
    columns = np.empty(2 * indices.size, np.int32)
    filled = 0
    for k in range(d):
        parent[k] = -1
        mark[k] = k
        row_starts[k] = filled
        if filled + k > columns.size:
            longer = np.empty(2 * columns.size + k, np.int32)
            longer[:filled] = columns[:filled]
            columns = longer
        for p in range(low_starts[k], low_ends[k]):
            i = low[p]
            while mark[i] != k:
                mark[i] = k
                columns[filled] = i
                filled += 1
                starts[i + 1] += 1
                if parent[i] < 0:
                    parent[i] = k
                i = parent[i]
    row_starts[d] = filled
    columns = columns[:filled].copy()
    work = 0.0
    for k in range(d):
        work += 0.5 * starts[k + 1] * (starts[k + 1] + 3.0)
        starts[k + 1] += starts[k]
    rows, entries = np.empty(filled, np.int32), np.zeros(filled, np.float64)
    positions, free = np.empty(filled, np.int32), starts[:d].copy()
    for k in range(d):
        for p in range(row_starts[k], row_starts[k + 1]):
            j = columns[p]
            positions[p] = free[j]
            rows[free[j]] = k
            free[j] += 1
        for p in range(low_starts[k], low_ends[k]):
            entries[free[low[p]] - 1] = low_values[p]
    label, count = mark, 0
    for k in range(d - 1, -1, -1):  # components: the trees of the elimination forest
        label[k] = count if parent[k] < 0 else label[parent[k]]
        count += parent[k] < 0
    return Prepared(
        order, starts, rows, row_starts, columns, positions, entries, diagonal, label, count, work,
        largest,
    )  # fmt: skip


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


@vectorised
def factor_and_solve(
    matrix: Prepared, counts: Counts, tiny: float, solves: int, factor: Factor, x: Floats
) -> None:
    """Factorise M - s I for eight shifts s, and apply each inverse ``solves`` times to x (d, 8).

    Column by column: what the earlier columns subtract from one is gathered in a dense column.
    Smaller pivots than ``tiny`` count as that. All of ``counts`` but the shifts, ``factor`` and x
    are overwritten.
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
