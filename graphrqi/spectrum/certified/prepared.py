"""A Laplacian prepared for factorisations: elimination order, and the pattern of its factor.

References:
    Liu (1990), The role of elimination trees in sparse factorization, SIMAX 11, 134. Cuthill, McKee
    (1969), Reducing the bandwidth of sparse symmetric matrices, Proc. 24th ACM Conf., 157-172.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from sim.compiled import compiled

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]
Bools: TypeAlias = NDArray[np.bool_]


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
    """Prepare a Laplacian, or its negative, in reverse Cuthill-McKee order.

    Args:
        graph: its Laplacian is the matrix.
        sign: 1, or -1 for its negative.
    """
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
