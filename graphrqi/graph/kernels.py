"""Compiled: nearest neighbours, and the Laplacian that they make."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Ids = NDArray[np.int64]

DIRECTION = np.array([math.cos(1.0), math.sin(1.0)])
"""Vehicles are sorted along this direction, which no straight road of a usual map is square to."""


def nearest_neighbors(ids: Ids, xy: Floats, k: int) -> Ints:
    """The nearest others of every vehicle, by distance, then by id.

    Vehicles are sorted along one direction. The search goes both ways from each. It ends where the
    distance along that direction alone exceeds that of the k-th found. The result is exact. The
    search is slow only if most traffic is square to the direction.

    Args:
        ids: (n,) different ids.
        xy: (n, 2) positions, m.
        k: how many, at most n - 1.

    Returns:
        (n, k) positions of the neighbours in ``ids``, nearest first.
    """
    found = np.empty((ids.size, k), np.int32)
    if k > 0:
        along = xy @ DIRECTION
        order = np.argsort(along, kind="stable")
        slack_m = 1e-15 * float(np.abs(xy).max())
        place = np.empty((ids.size, k), np.int32)
        square, who = np.empty(k + 1), np.empty(k + 1, np.int32)
        _find_nearest(ids[order], xy[order], along[order], slack_m, square, who, place)
        found[order] = order[place]
    return found


@in_place()
def _find_nearest(
    ids: Ids, xy: Floats, along: Floats, slack: float, square: Floats, who: Ints, out: Ints
) -> None:
    """See `nearest_neighbors`; ``square`` and ``who`` (k + 1,) are room to work in."""
    n, k = out.shape
    for i in range(n):
        found = 0
        low, high = i - 1, i + 1
        while low >= 0 or high < n:
            below = along[i] - along[low] if low >= 0 else math.inf
            above = along[high] - along[i] if high < n else math.inf
            j, away = (low, below) if below <= above else (high, above)
            least = away - slack
            if found == k and least > 0.0 and least * least * (1.0 - 1e-12) > square[k - 1]:
                break
            low, high = (low - 1, high) if below <= above else (low, high + 1)
            dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
            distance = dx * dx + dy * dy
            q = found
            while q > 0 and (
                distance < square[q - 1] or (distance == square[q - 1] and ids[j] < ids[who[q - 1]])
            ):
                square[q], who[q] = square[q - 1], who[q - 1]
                q -= 1
            square[q], who[q] = distance, j
            found += found < k
        for q in range(k):
            out[i, q] = who[q]


def join(
    row_of: Ids, d: int, neighbors: Ints, old_indptr: Ints, old_indices: Ints
) -> tuple[Ints, Ints, Floats]:
    """Laplacian of the graph that one observation adds to an earlier one.

    Args:
        row_of: (n,) row of each vehicle.
        d: rows of the new graph.
        neighbors: (n, k) its neighbours, as indices of ``row_of``.
        old_indptr: (c + 1,) the earlier Laplacian's row starts.
        old_indices: its columns.

    Returns:
        Row starts, columns and values of the new Laplacian, every diagonal entry stored; the last
        two have room to spare.
    """
    edges = neighbors.size
    room = 2 * edges + d + old_indices.size
    indptr, indices, values = np.empty(d + 1, np.int32), np.empty(room, np.int32), np.empty(room)
    _join(
        row_of, d, neighbors, (old_indptr, old_indices), np.empty(d, np.int32),
        np.empty((2, d + 2), np.int32), np.empty((2, edges), np.int32), (indptr, indices, values),
    )  # fmt: skip
    return indptr, indices, values


@in_place()
def _join(
    row_of: Ids,
    d: int,
    neighbors: Ints,
    old: tuple[Ints, Ints],
    seen: Ints,
    begins: Ints,
    chosen: Ints,
    new: tuple[Ints, Ints, Floats],
) -> None:
    """See `join`; ``seen``, ``begins`` and ``chosen`` are room to work in."""
    n, k = neighbors.shape
    old_indptr, old_indices = old
    indptr, indices, values = new
    c = old_indptr.size - 1
    # Transposing twice sorts the lists: `a` holds who chose a row, `b` whom the row chose.
    a_start, b_start, a, b = begins[0], begins[1], chosen[0], chosen[1]
    for r in range(d):
        seen[r] = -1
    for i in range(n):
        seen[row_of[i]] = i
    for r in range(d + 2):
        a_start[r] = b_start[r] = 0
    for i in range(n):
        for q in range(k):
            a_start[row_of[neighbors[i, q]] + 2] += 1
    for r in range(d):
        a_start[r + 2] += a_start[r + 1]
        b_start[r + 2] = b_start[r + 1] + (k if seen[r] >= 0 else 0)
    for r in range(d):
        if seen[r] >= 0:
            for q in range(k):
                t = row_of[neighbors[seen[r], q]]
                a[a_start[t + 1]] = r
                a_start[t + 1] += 1
    for r in range(d):
        for p in range(a_start[r], a_start[r + 1]):
            b[b_start[a[p] + 1]] = r
            b_start[a[p] + 1] += 1
    indptr[0] = z = 0
    for r in range(d):  # merge three sorted lists: chosen by, chosen, and joined before
        pa, ea, pb, eb, po, eo = a_start[r], a_start[r + 1], b_start[r], b_start[r + 1], 0, 0
        if r < c:
            po, eo = old_indptr[r], old_indptr[r + 1]
        begin, diagonal = z, -1
        while True:
            t = d
            if pa < ea:
                t = a[pa]
            if pb < eb and b[pb] < t:
                t = b[pb]
            if po < eo and old_indices[po] < t:
                t = old_indices[po]
            if diagonal < 0 and t >= r:
                diagonal = z
                indices[z] = r
                z += 1
            if t == d:
                break
            pa += pa < ea and a[pa] == t
            pb += pb < eb and b[pb] == t
            po += po < eo and old_indices[po] == t
            if t != r:
                indices[z] = t
                values[z] = -1.0
                z += 1
        values[diagonal] = z - begin - 1
        indptr[r + 1] = z
