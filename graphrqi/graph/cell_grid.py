"""From positions to a Laplacian: a cell grid for neighbours, then one pass to CSR.

The neighbours are those of a brute-force search, exactly: squared distances are computed by the
same arithmetic and ties are broken by the vehicle's id. The grid only decides which vehicles
need not be looked at. Expected cost is O(n) for n vehicles, whether they fill an area, follow
a line or have stragglers far away.

References:
    Bentley, Weide, Yao (1980), Optimal expected-time algorithms for closest point problems,
    ACM TOMS 6, 563-580.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled, in_place

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Ids = NDArray[np.int64]
Grid: TypeAlias = tuple[float, float, float, int, int, float, Ints, Ints]

CROWDED = 8.0
"""Vehicles in a vehicle's cell, on average, above which cells are halved."""
MAX_CELLS_PER_VEHICLE = 16
"""Bound on the grid's memory."""


@in_place(inner=True)
def cell_at(at: float, origin: float, width: float, cells: int) -> int:
    """Column of cells in which a coordinate lies; the nearest for one outside, m."""
    column = (at - origin) / width
    if column < 1.0:
        return 0
    return int(column) if column < cells else cells - 1


def cell_grid(xy: Floats, smallest: float) -> Grid:
    """Sort points into square cells; border cells also hold the points outside the grid.

    Args:
        xy: (n, 2) positions, m.
        smallest: the cells are at least this wide, m.

    Returns:
        Origin x and y, cell width, columns, rows, rounding slack of cell borders (all m);
        first item of each cell and, after the last one's, n, with room to spare; (n,) points by
        cell.
    """
    n = len(xy)
    # cells are halved only while that makes at most 16 for each vehicle, and 64
    start, items = np.empty(MAX_CELLS_PER_VEHICLE * n + 65, np.int32), np.empty(n, np.int32)
    x0, y0, width_m, columns, rows, slack_m = _sort_into_cells(
        xy, smallest, np.empty(n, np.int32), start, items
    )
    return x0, y0, width_m, columns, rows, slack_m, start, items


@in_place()
def _sort_into_cells(
    xy: Floats, smallest: float, cell_of: Ints, start: Ints, items: Ints
) -> tuple[float, float, float, int, int, float]:
    """See `cell_grid`; ``cell_of`` is room to work in."""
    n = len(xy)
    if n == 0:  # there is no bounding box
        start[0] = start[1] = 0
        return 0.0, 0.0, 1.0, 1, 1, 0.0
    x0, x1, y0, y1 = -math.inf, math.inf, -math.inf, math.inf
    for _ in range(3):  # bounding box, drawn in to 3 sigma: a straggler must not set the scale
        m = 0
        mx = my = vx = vy = 0.0
        ax, bx, ay, by = math.inf, -math.inf, math.inf, -math.inf
        for i in range(n):
            x, y = xy[i, 0], xy[i, 1]
            if x0 <= x <= x1 and y0 <= y <= y1:
                m += 1
                dx, dy = x - mx, y - my
                mx += dx / m
                my += dy / m
                vx += dx * (x - mx)
                vy += dy * (y - my)
                ax, bx, ay, by = min(ax, x), max(bx, x), min(ay, y), max(by, y)
        if m == 0:
            break
        sx, sy = 3.0 * math.sqrt(vx / m), 3.0 * math.sqrt(vy / m)
        x0, x1, y0, y1 = max(ax, mx - sx), min(bx, mx + sx), max(ay, my - sy), min(by, my + sy)
    width, height = max(x1 - x0, 0.0), max(y1 - y0, 0.0)
    extent = max(width, height)
    h = max(max(math.sqrt(2.0 * width * height / n), 2.0 * extent / n), smallest)
    if h <= 1e-9 * (abs(x0) + abs(y0) + extent) or h <= 0.0:
        h = max(extent, 1.0)
    while True:
        columns, rows = int(width / h) + 1, int(height / h) + 1
        for c in range(columns * rows + 1):
            start[c] = 0
        for i in range(n):
            column, row = cell_at(xy[i, 0], x0, h, columns), cell_at(xy[i, 1], y0, h, rows)
            cell_of[i] = row * columns + column
            start[cell_of[i] + 1] += 1
        crowd = 0.0
        for c in range(columns * rows):
            crowd += float(start[c + 1]) * float(start[c + 1])
        if crowd <= CROWDED * n or 0.5 * h < smallest or 0.5 * h <= 1e-9 * extent:
            break
        if 4 * columns * rows > MAX_CELLS_PER_VEHICLE * n + 64:
            break
        h *= 0.5
    for c in range(columns * rows):
        start[c + 1] += start[c]
    for i in range(n - 1, -1, -1):
        start[cell_of[i] + 1] -= 1
        items[start[cell_of[i] + 1]] = i
    for c in range(columns * rows):
        start[c] = start[c + 1]
    start[columns * rows] = n
    return x0, y0, h, columns, rows, 1e-12 * (extent + h)


def nearest_neighbors(ids: Ids, xy: Floats, k: int, grid: Grid) -> Ints:
    """The nearest others of every vehicle, by distance, then by id.

    Args:
        ids: (n,) different ids.
        xy: (n, 2) positions, m.
        k: how many, at most n - 1.
        grid: `cell_grid` of the positions.

    Returns:
        (n * k,) positions of the neighbours, nearest first.
    """
    target = np.empty(ids.size * k + 1, np.int32)  # room for one that is not among the last one's
    if k > 0:
        _find_nearest(ids, xy, k, grid, np.empty(k + 1), target)
    return target[:-1]


@in_place()
def _find_nearest(ids: Ids, xy: Floats, k: int, grid: Grid, distance: Floats, target: Ints) -> None:
    """See `nearest_neighbors`; ``distance`` is room to work in."""
    x0, y0, h, columns, rows, slack, start, items = grid
    for i in range(ids.size):
        base = i * k
        x, y = xy[i, 0], xy[i, 1]
        cx, cy = cell_at(x, x0, h, columns), cell_at(y, y0, h, rows)
        found = 0
        ring = 0
        while True:
            for gy in range(max(cy - ring, 0), min(cy + ring, rows - 1) + 1):
                edge = gy == cy - ring or gy == cy + ring
                gx = cx - ring
                while gx <= cx + ring:
                    if 0 <= gx < columns:
                        cell = gy * columns + gx
                        for p in range(start[cell], start[cell + 1]):
                            j = items[p]
                            if j == i:
                                continue
                            dx, dy = xy[j, 0] - x, xy[j, 1] - y
                            square = dx * dx + dy * dy
                            if found == k and square > distance[k - 1]:
                                continue
                            # behind the k-th is room for one that is not among them
                            q = base + found
                            while q > base:
                                nearer, other = distance[q - base - 1], target[q - 1]
                                if square > nearer or (square == nearer and ids[j] > ids[other]):
                                    break
                                distance[q - base] = nearer
                                target[q] = other
                                q -= 1
                            distance[q - base] = square
                            target[q] = j
                            found += found < k
                    gx += 1 if edge or ring == 0 else 2 * ring
            bound = math.inf  # how near an unvisited vehicle can be
            if cx - ring > 0:
                bound = min(bound, x - (x0 + (cx - ring) * h))
            if cx + ring < columns - 1:
                bound = min(bound, x0 + (cx + ring + 1) * h - x)
            if cy - ring > 0:
                bound = min(bound, y - (y0 + (cy - ring) * h))
            if cy + ring < rows - 1:
                bound = min(bound, y0 + (cy + ring + 1) * h - y)
            if bound == math.inf:
                break
            bound -= slack
            if found == k and bound > 0.0 and distance[k - 1] < bound * bound * (1.0 - 1e-12):
                break
            ring += 1


@compiled
def within_radius(xy: Floats, radius_m: float, grid: Grid) -> tuple[Ints, Ints]:
    """All others within a distance of every vehicle.

    Args:
        xy: (n, 2) positions, m.
        radius_m: the distance, included.
        grid: `cell_grid` of the positions.

    Returns:
        (n + 1,) starts and the positions of the vehicles within reach.
    """
    n = len(xy)
    starts = np.empty(n + 1, np.int32)
    starts[0] = 0
    x0, y0, h, columns, rows, slack, start, items = grid
    square = radius_m * radius_m
    reach = radius_m * (1.0 + 1e-12) + slack
    target = np.empty(0, np.int32)
    for filling in range(2):
        m = 0
        for i in range(n):
            x, y = xy[i, 0], xy[i, 1]
            left, right = cell_at(x - reach, x0, h, columns), cell_at(x + reach, x0, h, columns)
            low, high = cell_at(y - reach, y0, h, rows), cell_at(y + reach, y0, h, rows)
            for gy in range(low, high + 1):
                for p in range(start[gy * columns + left], start[gy * columns + right + 1]):
                    j = items[p]
                    dx, dy = xy[j, 0] - x, xy[j, 1] - y
                    if j != i and dx * dx + dy * dy <= square:
                        if filling:
                            target[m] = j
                        m += 1
            starts[i + 1] = m
        if not filling:
            target = np.empty(m, np.int32)
    return starts, target


def join(
    row_of: Ids,
    d: int,
    xy: Floats,
    starts: Ints,
    target: Ints,
    scale_m: float,
    old_indptr: Ints,
    old_indices: Ints,
    old_values: Floats,
) -> tuple[Ints, Ints, Floats]:
    """Laplacian of the graph that one observation adds to an earlier one.

    Args:
        row_of: (n,) row of every vehicle seen.
        d: rows of the new graph; those of the earlier one come first.
        xy: (n, 2) positions, m.
        starts: (n + 1,) where each vehicle's list of others begins.
        target: the positions of the vehicles it is joined to.
        scale_m: edges weigh exp(-distance / scale_m); 1 where it is not positive, m.
        old_indptr: (c + 1,) the earlier Laplacian in CSR.
        old_indices: its column numbers, sorted in each row.
        old_values: its values.

    Returns:
        Row starts, columns and values of the new Laplacian (every diagonal entry is stored,
        columns sorted); the last two have room to spare.
    """
    edges = target.size
    room = 2 * edges + d + old_indices.size
    indptr, indices, values = np.empty(d + 1, np.int32), np.empty(room, np.int32), np.empty(room)
    _join(
        row_of, d, xy, (starts, target), scale_m, (old_indptr, old_indices, old_values),
        np.empty((2, d), np.int32), np.empty((2, d + 2), np.int32), np.empty((2, edges), np.int32),
        (indptr, indices, values),
    )  # fmt: skip
    return indptr, indices, values


@in_place()
def _join(
    row_of: Ids,
    d: int,
    xy: Floats,
    lists: tuple[Ints, Ints],
    scale_m: float,
    old: tuple[Ints, Ints, Floats],
    rows: Ints,
    begins: Ints,
    chosen: Ints,
    new: tuple[Ints, Ints, Floats],
) -> None:
    """See `join`; ``rows``, ``begins`` and ``chosen`` are room to work in."""
    starts, target = lists
    old_indptr, old_indices, old_values = old
    indptr, indices, values = new
    n, m, c = row_of.size, target.size, old_indptr.size - 1
    seen, known = rows[0], rows[1]
    # Transposing twice sorts the lists: `a` holds who chose a row, `b` whom the row chose.
    a_start, b_start, a, b = begins[0], begins[1], chosen[0], chosen[1]
    for r in range(d):
        seen[r] = known[r] = -1
    for i in range(n):
        seen[row_of[i]] = i
    for r in range(d + 2):
        a_start[r] = b_start[r] = 0
    for p in range(m):
        a_start[row_of[target[p]] + 2] += 1
    for r in range(d):
        a_start[r + 2] += a_start[r + 1]
        b_start[r + 2] = b_start[r + 1]
        if seen[r] >= 0:
            b_start[r + 2] += starts[seen[r] + 1] - starts[seen[r]]
    for r in range(d):
        if seen[r] >= 0:
            for p in range(starts[seen[r]], starts[seen[r] + 1]):
                t = row_of[target[p]]
                a[a_start[t + 1]] = r
                a_start[t + 1] += 1
    for r in range(d):
        for p in range(a_start[r], a_start[r + 1]):
            t = a[p]
            b[b_start[t + 1]] = r
            b_start[t + 1] += 1

    indptr[0] = 0
    z = 0
    for r in range(d):
        pa, ea, pb, eb = a_start[r], a_start[r + 1], b_start[r], b_start[r + 1]
        po, eo = 0, 0
        if r < c:
            po, eo = old_indptr[r], old_indptr[r + 1]
        same = scale_m <= 0.0 and r < c  # most rows stay as they were, and are copied
        for p in range(po, eo):
            known[old_indices[p]] = r
        for p in range(pa, ea):
            same = same and known[a[p]] == r
        for p in range(pb, eb):
            same = same and known[b[p]] == r
        if same:
            for p in range(po, eo):
                indices[z + p - po], values[z + p - po] = old_indices[p], old_values[p]
            z += eo - po
            indptr[r + 1] = z
            continue
        degree = 0.0
        diagonal = -1
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
            weight = 0.0
            if po < eo and old_indices[po] == t:
                weight = -old_values[po]
                po += 1
            fresh = False
            if pa < ea and a[pa] == t:
                fresh = True
                pa += 1
            if pb < eb and b[pb] == t:
                fresh = True
                pb += 1
            if t == r:
                continue
            if fresh:
                weight = 1.0
                if scale_m > 0.0:
                    i, j = seen[r], seen[t]
                    dx, dy = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
                    weight = math.exp(-math.sqrt(dx * dx + dy * dy) / scale_m)
            if weight > 0.0:
                indices[z] = t
                values[z] = -weight
                degree += weight
                z += 1
        values[diagonal] = degree
        indptr[r + 1] = z
