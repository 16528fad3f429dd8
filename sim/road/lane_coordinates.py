"""Places in metres and along lanes, compiled: the lane that fits a place, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.compiled import in_place

FIT_CELL_M, FIT_MARGIN_M = 16.0, 4.0
"""Width of the cells into which lane pieces are sorted, m, and the margin within which a cell
lists them, m."""


@in_place()
def fit(
    xy: Any, heading: Any, start: Any, direction: Any, length: Any, turn_cost_m: Any, cells: Any,
    best: Any, at: Any, left: Any,
) -> None:  # fmt: skip
    """Find the piece of lane that fits each place and heading best, the first of equally good ones.

    Pieces have starts, directions, lengths and costs of facing across them (facing back costs twice
    as much), in m. Each of ``cells`` lists all pieces within `FIT_MARGIN_M` of it. The last three
    arrays receive the piece, the distance along it and the signed distance to its left, m.
    """
    x0, y0, size, columns, rows, first, items = cells
    for i in range(len(xy)):
        best[i], at[i], left[i] = 0, np.nan, np.nan
        x, y = xy[i, 0], xy[i, 1]
        east, north = np.cos(heading[i]), np.sin(heading[i])
        cx = int(min(max((x - x0) / size, 0.0), columns - 1.0))
        cy = int(min(max((y - y0) / size, 0.0), rows - 1.0))
        least, most, reach = np.inf, np.inf, 0
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
            aside = min(x - x0 - (cx - reach) * size, x0 + (cx + reach + 1) * size - x)
            above = min(y - y0 - (cy - reach) * size, y0 + (cy + reach + 1) * size - y)
            if least < 0.999 * (FIT_MARGIN_M + min(aside, above)):
                break
            reach = max(1, 2 * reach)


@in_place()
def place(
    lane: Any, s: Any, offset: Any, first: Any, last: Any, piece_at: Any, start: Any,
    direction: Any, xy: Any, piece: Any,
) -> None:  # fmt: skip
    """Find places given in lane coordinates, as of `sim.road.lane_graph.LaneGraph.position`.

    The last two arrays receive (n, 2) positions, m, and the pieces beside them.
    """
    for i in range(lane.size):
        g = first[lane[i]]
        while g < last[lane[i]] and piece_at[g + 1] <= s[i]:
            g += 1
        along, ux, uy = s[i] - piece_at[g], direction[g, 0], direction[g, 1]
        xy[i, 0] = start[g, 0] + ux * along + offset[i] * -uy
        xy[i, 1] = start[g, 1] + uy * along + offset[i] * ux
        piece[i] = g
