"""Places in metres and along lines, compiled: the lane that fits a place, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.compiled import compiled, in_place

FIT_CELL_M, FIT_MARGIN_M = 16.0, 4.0
"""Width of the cells into which lane pieces are sorted, m, and the margin within which a cell
lists them, m."""


@in_place(inner=True)
def _cell_at(at: float, origin: float, width: float, cells: int) -> int:
    """Column of cells in which a coordinate lies; the nearest for one outside, m."""
    column = (at - origin) / width
    if column < 1.0:
        return 0
    return int(column) if column < cells else cells - 1


@in_place()
def fit(
    xy: Any, heading: Any, start: Any, direction: Any, length: Any, turn_cost_m: Any, cells: Any,
    best: Any, at: Any, left: Any,
) -> None:  # fmt: skip
    """Find the straight piece of lane that fits each place and heading best.

    The first of equally good pieces is taken.

    Args:
        xy: (n, 2) m.
        heading: (n,) rad.
        start: (G, 2) where each piece begins, m.
        direction: (G, 2) unit vectors.
        length: (G,) m.
        turn_cost_m: (G,) what facing across a piece costs, m; the other way costs twice as much.
        cells: `sim.road.cells.Cells` of the pieces; each cell lists at least all pieces within
            `FIT_MARGIN_M` of it.
        best: (n,) receives the piece.
        at: (n,) receives the distance along it, m, from 0 to its length.
        left: (n,) receives the signed distance to its left, m.
    """
    x0, y0, size, columns, rows, first, items = cells
    for i in range(len(xy)):
        best[i], at[i], left[i] = 0, np.nan, np.nan
        x, y = xy[i, 0], xy[i, 1]
        east, north = np.cos(heading[i]), np.sin(heading[i])
        least, most, reach = np.inf, np.inf, 0
        cx, cy = _cell_at(x, x0, size, columns), _cell_at(y, y0, size, rows)
        while True:  # the own cell, then squares twice as wide until nothing nearer can be outside
            west, right = max(cx - reach, 0), min(cx + reach, columns - 1)
            south, top = max(cy - reach, 0), min(cy + reach, rows - 1)
            for row in range(south, top + 1):
                for p in range(first[row * columns + west], first[row * columns + right + 1]):
                    g = items[p]
                    dx, dy = x - start[g, 0], y - start[g, 1]
                    ux, uy = direction[g, 0], direction[g, 1]
                    along = dx * ux + dy * uy
                    across = ux * dy - uy * dx
                    clipped = min(max(along, 0.0), length[g])
                    beyond = along - clipped
                    if across * across + beyond * beyond > most:
                        continue
                    cost = np.hypot(across, beyond)
                    cost += turn_cost_m[g] * (1.0 - (east * ux + north * uy))
                    if cost < least or (cost == least and g < best[i]):
                        most = 1.001 * cost * cost  # farther away than this nothing is better
                        least, best[i], at[i], left[i] = cost, g, clipped, across
            if west == 0 and south == 0 and right == columns - 1 and top == rows - 1:
                break
            if reach == 0:
                inside = x0 <= x <= x0 + columns * size and y0 <= y <= y0 + rows * size
                known = FIT_MARGIN_M if inside else 0.0
            else:
                known = np.inf
                if west > 0:
                    known = min(known, x - (x0 + west * size))
                if right < columns - 1:
                    known = min(known, x0 + (right + 1) * size - x)
                if south > 0:
                    known = min(known, y - (y0 + south * size))
                if top < rows - 1:
                    known = min(known, y0 + (top + 1) * size - y)
            if least < 0.999 * known:
                break
            reach = max(1, 2 * reach)


@in_place()
def place(
    lane: Any, s: Any, offset: Any, first: Any, last: Any, piece_at: Any, start: Any,
    direction: Any, xy: Any, piece: Any,
) -> None:  # fmt: skip
    """Find places given in lane coordinates; beyond either end a lane goes on straight.

    Args:
        lane: (n,) lanes.
        s: (n,) distance along them, m.
        offset: (n,) distance to the left of the centre line, m.
        first: (L,) first piece of each lane.
        last: (L,) last piece.
        piece_at: (G,) distance along its lane at which each piece begins, m.
        start: (G, 2) where it begins, m.
        direction: (G, 2) unit vectors.
        xy: (n, 2) receives the positions, m.
        piece: (n,) receives the piece that each is on.
    """
    for i in range(lane.size):
        g = first[lane[i]]
        while g < last[lane[i]] and piece_at[g + 1] <= s[i]:
            g += 1
        along, ux, uy = s[i] - piece_at[g], direction[g, 0], direction[g, 1]
        xy[i, 0] = start[g, 0] + ux * along + offset[i] * -uy
        xy[i, 1] = start[g, 1] + uy * along + offset[i] * ux
        piece[i] = g


@in_place()
def along_at(line: Any, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """`along` of one place (x, y)."""
    begin, nearest, found, left = 0.0, np.inf, 0.0, 0.0
    pieces = len(line) - 1
    for k in range(pieces):
        east, north = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
        size = np.hypot(east, north)
        east, north = east / size, north / size
        dx, dy = x - line[k, 0], y - line[k, 1]
        forward, aside = dx * east + dy * north, east * dy - north * dx
        clipped = forward
        if k > 0:
            clipped = max(clipped, 0.0)
        if k < pieces - 1:
            clipped = min(clipped, size)
        away = np.hypot(aside, forward - clipped)
        if away < nearest:
            nearest, found, left = away, begin + clipped, aside
        begin += size
    return found, left, begin


@compiled
def along(line: Any, xy: Any) -> tuple[Any, Any, Any]:
    """Places in the coordinates of a line that goes on straight at both ends.

    Args:
        line: (P, 2) points, m.
        xy: (n, 2) places, m.

    Returns:
        (n,) distance along it, m (negative before it, above its length after it), (n,) distance to
        its left, m, and its length, m.

    Examples:
        >>> u, left, total = along(np.array([[0.0, 0.0], [0.0, 8.0]]), np.array([[1.0, 9.0]]))
        >>> u.tolist(), left.tolist(), total
        ([9.0], [-1.0], 8.0)
    """
    n, total = len(xy), 0.0
    u, left = np.empty(n), np.empty(n)
    for i in range(n):
        u[i], left[i], total = along_at(line, xy[i, 0], xy[i, 1])
    if n == 0:
        _, _, total = along_at(line, 0.0, 0.0)
    return u, left, total
