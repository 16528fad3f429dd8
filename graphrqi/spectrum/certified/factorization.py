"""Kernels: L D L^T of a sparse symmetric matrix at eight shifts at once.

The symbolic part builds the elimination tree and the pattern of the factor, by columns and by
rows. In the numeric part every number is
eight numbers, one per shift, so that it runs in vector registers. The signs of the pivots count
the eigenvalues below each shift (Sylvester's law of inertia).

References:
    Liu (1990), The role of elimination trees in sparse factorization, SIMAX 11, 134-172.
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.spectrum.certified.simd import (
    any_below,
    inverse,
    larger,
    less,
    load,
    minus,
    more,
    plus,
    positive,
    spread,
    store,
    times,
)
from sim.compiled import compiled

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]
Ids: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
PatternArrays: TypeAlias = tuple[Ints, Ints, Ints, Ints, Ints, Floats, Floats]

GOLDEN = -0x61C8864680B583EB
"""2^64 over the golden ratio, less 2^64: its multiples look random (Knuth, The Art of Computer
Programming 3, section 6.4)."""
UNCHANGED = 1e-9
"""Rows whose products with the same noise differ by less count as equal (rounding makes 1e-14)."""
SHIFT, ABOVE, GROWTH = 0, 1, 2  # rows of a batch of eight shifts


class Pattern(NamedTuple):
    """A symmetric matrix in the pattern of its factor, rows and columns in elimination order.

    Attributes:
        starts: (d + 1,) column starts of the factor.
        rows: (f,) its rows, ascending in each column.
        row_starts: (d + 1,) its row starts.
        columns: (f,) its columns, by row.
        positions: (f,) where those entries are in the columns.
        entries: (f,) the matrix's entries, 0 where the factor fills in.
        diagonal: (d,) its diagonal.
    """

    starts: Ints
    rows: Ints
    row_starts: Ints
    columns: Ints
    positions: Ints
    entries: Floats
    diagonal: Floats


class FactorMemory(NamedTuple):
    """Memory that a factorisation writes on.

    Attributes:
        factor: (f, 8) the factor times its pivots.
        pivots: (d, 8) the inverse pivots.
        column: (d, 8) a dense column.
    """

    factor: Floats
    pivots: Floats
    column: Floats


@compiled
def factor_pattern(
    ids: Ids,
    indptr: Ints,
    indices: Ints,
    values: Floats,
    sign: float,
    order: Ints,
    earlier: Floats,
) -> tuple[PatternArrays, Ints, int, float, float, Floats, Bools]:
    """Pattern of the factor, with the matrix's entries in it.

    Args:
        ids: (n,) the vehicle of each row.
        indptr: row starts of the symmetric matrix, every diagonal entry stored.
        indices: its columns.
        values: its values.
        sign: 1 or -1, which the entries in the pattern are multiplied with.
        order: (d,) row at each place; rows it does not name, and their columns, are left out.
        earlier: (n,) the product of an earlier matrix with noise, infinite for a new row.

    Returns:
        What makes a `Pattern`; (d,) connected component of each place and how many there are; the
        number of multiplications a factorisation takes; the largest entry of the diagonal, at
        least 1; and, in the rows named, (n,) the product of the matrix with noise that depends on
        the ids only and (n,) whether it differs from the earlier one.
    """
    d, n = order.size, ids.size
    place, noise = np.empty(n, np.int32), np.empty(n, np.float64)
    for i in range(n):
        place[i] = -1
        noise[i] = float((ids[i] * GOLDEN) >> 11) * 2.0**-52
    low_starts, low_ends = np.empty(d + 1, np.int32), np.empty(d + 1, np.int32)
    low_starts[0] = low_ends[0] = 0
    for k in range(d):
        r = order[k]
        place[r] = k
        low_starts[k + 1] = low_ends[k + 1] = low_starts[k] + indptr[r + 1] - indptr[r]
    # The lower triangle by rows, columns ascending. The loop does not branch: an entry that is
    # not below the diagonal is overwritten by the next one, and one that is left out (place -1)
    # is written behind the last.
    low, low_values = np.empty(indices.size + 1, np.int32), np.empty(indices.size + 1, np.float64)
    diagonal = np.empty(d, np.float64)
    product, changed = np.empty(n, np.float64), np.empty(n, np.bool_)
    largest = 1.0
    for k in range(d):
        r = order[k]
        total = 0.0
        for p in range(indptr[r], indptr[r + 1]):
            total += values[p] * noise[indices[p]]
            i = place[indices[p]]
            t = low_ends[i]
            low[t], low_values[t] = k, sign * values[p]
            low_ends[i] = t + (i > k)
            if i == k:
                diagonal[k] = sign * values[p]
                largest = max(largest, values[p])
        product[r], changed[r] = total, abs(total - earlier[r]) > UNCHANGED
    # The columns of every row of the factor, along the elimination tree.
    parent, mark = np.empty(d, np.int32), np.empty(d, np.int32)
    starts, row_starts = np.empty(d + 1, np.int32), np.empty(d + 1, np.int32)
    for k in range(d + 1):
        starts[k] = 0
    columns = np.empty(2 * indices.size, np.int32)
    filled = 0
    for k in range(d):
        parent[k] = -1
        mark[k] = k
        row_starts[k] = filled
        if filled + k > columns.size:
            longer = np.empty(2 * columns.size + k, np.int32)
            for p in range(filled):
                longer[p] = columns[p]
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
    work = 0.0
    for k in range(d):
        work += 0.5 * starts[k + 1] * (starts[k + 1] + 3.0)
        starts[k + 1] += starts[k]
    rows, entries = np.empty(filled, np.int32), np.empty(filled, np.float64)
    positions, free = np.empty(filled, np.int32), np.empty(d, np.int32)
    for p in range(filled):
        entries[p] = 0.0
    for k in range(d):
        free[k] = starts[k]
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
    pattern = (starts, rows, row_starts, columns, positions, entries, diagonal)
    return pattern, label, count, work, largest, product, changed


@compiled
def factor_and_solve(
    pattern: Pattern,
    batch: Floats,
    tiny: float,
    factorise: bool,
    solves: int,
    memory: FactorMemory,
    x: Floats,
) -> None:
    """Factorise M - s I for eight shifts s and solve one system with each.

    Column by column: what the earlier columns subtract from one is gathered in a dense column.

    Args:
        pattern: M.
        batch: (3 or more, 8) the shifts in row SHIFT; ABOVE is overwritten by the number of
            eigenvalues above each, GROWTH by the largest pivot: times 2.2e-16, the size of the
            error.
        tiny: size of the smallest pivot allowed.
        factorise: whether to; if not, ``memory`` is that of an earlier call with the same shifts,
            and ``batch`` stays as it is.
        solves: how often each inverse is applied; 0 only counts.
        memory: overwritten.
        x: (d, 8) right-hand sides in elimination order; the solutions afterwards.
    """
    starts, rows, row_starts, columns, positions, entries, diagonal = pattern
    factor, pivots, column = memory
    d = diagonal.size
    shift = load(batch, SHIFT)
    number, size = spread(0.0), spread(0.0)
    for i in range(d if factorise else 0):
        for m in range(starts[i], starts[i + 1]):
            store(column, rows[m], spread(entries[m]))
        b = minus(spread(diagonal[i]), shift)
        xi = load(x, i)
        for p in range(row_starts[i], row_starts[i + 1]):
            j, m = columns[p], positions[p]
            w = load(factor, m)
            ratio = times(w, load(pivots, j))
            b = less(b, w, ratio)
            if solves > 0:
                xi = less(xi, w, load(x, j))
            for q in range(m + 1, starts[j + 1]):
                store(column, rows[q], less(load(column, rows[q]), load(factor, q), ratio))
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
            store(factor, m, load(column, rows[m]))
        if solves > 0:
            store(x, i, times(xi, r))
    if factorise:
        store(batch, ABOVE, number)
        store(batch, GROWTH, size)
    # Two sums side by side: each addition waits for the one before it.
    for again in range(solves):
        if again or not factorise:
            for i in range(d):
                xi = load(x, i)
                p, end = row_starts[i], row_starts[i + 1]
                half = spread(0.0)
                while p + 1 < end:
                    xi = less(xi, load(factor, positions[p]), load(x, columns[p]))
                    half = less(half, load(factor, positions[p + 1]), load(x, columns[p + 1]))
                    p += 2
                if p < end:
                    xi = less(xi, load(factor, positions[p]), load(x, columns[p]))
                store(x, i, times(plus(xi, 1.0, half), load(pivots, i)))
        for j in range(d - 1, -1, -1):
            sum_j = half = spread(0.0)
            p, end = starts[j], starts[j + 1]
            while p + 1 < end:
                sum_j = more(sum_j, load(factor, p), load(x, rows[p]))
                half = more(half, load(factor, p + 1), load(x, rows[p + 1]))
                p += 2
            if p < end:
                sum_j = more(sum_j, load(factor, p), load(x, rows[p]))
            sum_j = plus(sum_j, 1.0, half)
            store(x, j, less(load(x, j), sum_j, load(pivots, j)))
