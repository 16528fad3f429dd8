"""Kernels: L D L^T of a sparse symmetric matrix at eight shifts at once.

The symbolic part orders the graph (reverse Cuthill-McKee, per component), builds the elimination
tree and the pattern of the factor, and lists where every update of the factorisation lands. The
numeric part then streams through that list; every number is eight numbers, one per shift, so that
it runs in vector registers. The signs of the pivots count the eigenvalues below each shift
(Sylvester's law of inertia).

References:
    Cuthill, McKee (1969), Proc. 24th ACM Conf., 157-172.
    Liu (1990), The role of elimination trees in sparse factorization, SIMAX 11, 134-172.
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled
from graphrqi.spectrum.lanes import (
    any_below,
    inverse,
    larger,
    less,
    load,
    minus,
    plus,
    positive,
    spread,
    store,
    times,
)

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]


@compiled
def order_rows(indptr: Ints, indices: Ints) -> tuple[Ints, Ints, int]:
    """Reverse Cuthill-McKee order and connected components.

    Args:
        indptr: (d + 1,) row starts of a symmetric pattern.
        indices: its columns.

    Returns:
        (d,) row at each place of the order, (d,) component of each row, number of components.
    """
    d = indptr.size - 1
    order = np.empty(d, np.int32)
    label = np.empty(d, np.int32)
    mark = np.empty(d, np.int32)
    for i in range(d):
        label[i] = -1
        mark[i] = -1
    placed = 0
    count = 0
    stamp = 0
    for seed in range(d):
        if label[seed] >= 0:
            continue
        root = seed
        depth = -1
        for _ in range(3):  # walk towards the rim: a far vertex of small degree
            head, tail, level_end, levels = placed, placed + 1, placed + 1, 0
            order[placed] = root
            mark[root] = stamp
            last = placed
            while head < tail:
                i = order[head]
                head += 1
                for p in range(indptr[i], indptr[i + 1]):
                    j = indices[p]
                    if mark[j] != stamp:
                        mark[j] = stamp
                        order[tail] = j
                        tail += 1
                if head == level_end and head < tail:
                    last = head
                    level_end = tail
                    levels += 1
            stamp += 1
            if levels <= depth:
                break
            depth = levels
            best = order[last]
            for p in range(last, tail):
                j = order[p]
                if indptr[j + 1] - indptr[j] < indptr[best + 1] - indptr[best]:
                    best = j
            root = best
        head, tail = placed, placed + 1
        order[placed] = root
        label[root] = count
        while head < tail:
            i = order[head]
            head += 1
            first = tail
            for p in range(indptr[i], indptr[i + 1]):
                j = indices[p]
                if label[j] < 0:
                    label[j] = count
                    degree = indptr[j + 1] - indptr[j]
                    q = tail
                    while q > first:
                        other = order[q - 1]
                        if indptr[other + 1] - indptr[other] <= degree:
                            break
                        order[q] = other
                        q -= 1
                    order[q] = j
                    tail += 1
        placed = tail
        count += 1
    for p in range(d // 2):
        order[p], order[d - 1 - p] = order[d - 1 - p], order[p]
    return order, label, count


@compiled
def factor_pattern(
    indptr: Ints, indices: Ints, values: Floats, order: Ints
) -> tuple[Ints, Ints, Floats, Floats, float]:
    """Pattern of the factor, with the matrix's entries in it.

    Args:
        indptr: (d + 1,) row starts of the symmetric matrix, every diagonal entry stored.
        indices: its columns.
        values: its values.
        order: (d,) row at each place.

    Returns:
        (d + 1,) column starts, (f,) rows (places, ascending in each column), (f,) entries of the
        matrix there (0 where it fills in), (d,) its diagonal, and the number of multiplications
        a factorisation takes.
    """
    d = order.size
    place = np.empty(d, np.int32)
    for k in range(d):
        place[order[k]] = k
    parent = np.empty(d, np.int32)
    mark = np.empty(d, np.int32)
    starts = np.zeros(d + 1, np.int32)
    for k in range(d):
        parent[k] = -1
        mark[k] = k
        r = order[k]
        for p in range(indptr[r], indptr[r + 1]):
            i = place[indices[p]]
            if i < k:
                while mark[i] != k:
                    mark[i] = k
                    starts[i + 1] += 1
                    if parent[i] < 0:
                        parent[i] = k
                    i = parent[i]
    work = 0.0
    for k in range(d):
        work += 0.5 * starts[k + 1] * (starts[k + 1] + 3.0)
        starts[k + 1] += starts[k]
    rows = np.empty(starts[d], np.int32)
    entries = np.zeros(starts[d], np.float64)
    diagonal = np.empty(d, np.float64)
    free = starts.copy()
    for k in range(d):
        mark[k] = -1
    for k in range(d):
        mark[k] = k
        r = order[k]
        for p in range(indptr[r], indptr[r + 1]):
            i = place[indices[p]]
            if i == k:
                diagonal[k] = values[p]
            if i < k:
                j = i
                while mark[j] != k:
                    mark[j] = k
                    rows[free[j]] = k
                    free[j] += 1
                    j = parent[j]
                entries[free[i] - 1] = values[p]
    return starts, rows, entries, diagonal, work


@compiled
def update_targets(starts: Ints, rows: Ints) -> Ints:
    """Where each update of the factorisation lands.

    Args:
        starts: (d + 1,) column starts of the factor.
        rows: its rows.

    Returns:
        For every column, for every pair of its entries p < q in turn, the position of entry
        (row of q, row of p) in the factor.
    """
    d = starts.size - 1
    total = 0
    for j in range(d):
        c = starts[j + 1] - starts[j]
        total += c * (c - 1) // 2
    target = np.empty(total, np.int32)
    t = 0
    for j in range(d):
        end = starts[j + 1]
        for p in range(starts[j], end - 1):
            m = starts[rows[p]]
            for q in range(p + 1, end):
                while rows[m] != rows[q]:
                    m += 1
                target[t] = m
                t += 1
                m += 1
    return target


@compiled
def factor_and_solve(
    starts: Ints,
    rows: Ints,
    target: Ints,
    entries: Floats,
    diagonal: Floats,
    shifts: Floats,
    tiny: float,
    solves: int,
    factor: Floats,
    pivots: Floats,
    x: Floats,
    above: Floats,
    growth: Floats,
) -> None:
    """Factorise M - s I for eight shifts s and solve one system with each.

    Args:
        starts: (d + 1,) column starts of the factor.
        rows: (f,) its rows.
        target: :func:`update_targets`.
        entries: (f,) the matrix's entries.
        diagonal: (d,) its diagonal.
        shifts: (1, 8).
        tiny: size of the smallest pivot allowed.
        solves: how often each inverse is applied; 0 only counts.
        factor: (f, 8) room for the factor.
        pivots: (d, 8) room for the inverse pivots.
        x: (d, 8) right-hand sides in elimination order; the solutions afterwards.
        above: (1, 8) afterwards the number of eigenvalues above each shift.
        growth: (1, 8) afterwards the largest pivot: times 2.2e-16, the size of the error.
    """
    d = diagonal.size
    for p in range(entries.size):
        store(factor, p, spread(entries[p]))
    shift = load(shifts, 0)
    number, size = spread(0.0), spread(0.0)
    for j in range(d):
        store(pivots, j, minus(spread(diagonal[j]), shift))
    t = 0
    for j in range(d):
        b = load(pivots, j)
        if any_below(b, tiny):
            for q in range(8):
                if abs(pivots[j, q]) < tiny:
                    pivots[j, q] = -tiny if pivots[j, q] < 0.0 else tiny
            b = load(pivots, j)
        number = plus(number, 1.0, positive(b))
        size = larger(size, b)
        r = inverse(b)
        store(pivots, j, r)
        end = starts[j + 1]
        xj = load(x, j)
        for p in range(starts[j], end):
            w = load(factor, p)
            ratio = times(w, r)
            store(factor, p, ratio)
            i = rows[p]
            store(pivots, i, less(load(pivots, i), ratio, w))
            if solves > 0:
                store(x, i, less(load(x, i), ratio, xj))
            for q in range(p + 1, end):
                m = target[t]
                t += 1
                store(factor, m, less(load(factor, m), load(factor, q), ratio))
    store(above, 0, number)
    store(growth, 0, size)
    for again in range(solves):
        if again:
            for j in range(d):
                xj = load(x, j)
                for p in range(starts[j], starts[j + 1]):
                    store(x, rows[p], less(load(x, rows[p]), load(factor, p), xj))
        for j in range(d - 1, -1, -1):
            y = times(load(x, j), load(pivots, j))
            for p in range(starts[j], starts[j + 1]):
                y = less(y, load(factor, p), load(x, rows[p]))
            store(x, j, y)
