"""Where vehicles are along lanes, found by looking at the lanes near each vehicle only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.highway.lanes import corners
from sim.road.cells import Cells, boxes_of, cells_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

STRETCH_MARGIN_M: Final = 1.0
"""A vehicle this far beyond a lane's edge is still on it (highway-env's)."""

PATH_MARGIN_M: Final = 0.5
"""The same on junction paths, which lie close together."""

BEHIND_M: Final = 40.0
"""A vehicle this far before the beginning of a lane, and in line with it, is on it already."""

ALIGNED: Final = 0.5
"""A vehicle turned by more than 60 degrees from a lane crosses it and is not on it. On stretches,
unlike on junction paths, one that faces the other way is."""

CELL_M: Final = 50.0
"""Width of the cells in which lanes are looked for, m (`BEHIND_M` and a lane)."""

LONGEST_M: Final = 40.0
"""Length up to which a vehicle beyond the end of a lane is still on it with its rear, m (twice a
lorry's)."""

ROUNDING_M: Final = 1e-3
"""Lanes are searched this much farther from vehicles than they can be, m."""


class LaneLines(NamedTuple):
    """The centre lines of K lanes in pieces, and who counts as on each lane.

    Attributes:
        start: (P, 2) m.
        direction: (P, 2).
        size: (P,) m.
        begin: (P,) distance along the lane, m.
        first: (K,) first piece of each lane.
        last: (K,) last piece of each lane.
        connector: (K,) whether it crosses a junction.
        margin: (K,) how far aside a vehicle is still on it, m.
        length: (K,) m.
        behind: (K,) how far before its beginning a vehicle is on it, m.
        cells: the lanes by the places at which a vehicle may be on them.
    """

    start: FloatArray
    direction: FloatArray
    size: FloatArray
    begin: FloatArray
    first: IntArray
    last: IntArray
    connector: BoolArray
    margin: FloatArray
    length: FloatArray
    behind: FloatArray
    cells: Cells


class OnLanes(NamedTuple):
    """The vehicles on each of K lanes: E entries, by lane, then by distance along it.

    Attributes:
        first: (K + 1,) where each lane's entries begin, and E.
        row: (E,) which vehicle.
        s: (E,) its distance along the lane, m.
        along: (E,) its speed along the lane, m/s.
    """

    first: IntArray
    row: IntArray
    s: FloatArray
    along: FloatArray


def lane_lines(lanes: Sequence[AbstractLane], connector: Sequence[bool]) -> LaneLines:
    """The lines of a road's lanes.

    Args:
        lanes: of the road.
        connector: whether each crosses a junction.
    """
    crosses = np.array(connector, dtype=np.bool_)
    width = np.array([lane.width for lane in lanes], dtype=np.float64)
    margin = width / 2 + np.where(crosses, PATH_MARGIN_M, STRETCH_MARGIN_M)
    behind = np.where(crosses, 0.0, BEHIND_M)
    lines = corners(lanes)
    step = np.concatenate([np.diff(line, axis=0) for line in lines])
    size = np.hypot(step[:, 0], step[:, 1])
    direction = step / size[:, None]
    count = np.array([len(line) - 1 for line in lines], dtype=np.int64)
    last = np.cumsum(count) - 1
    first = last + 1 - count
    reached = [
        np.concatenate(
            [line, [line[0] - back * direction[a], line[-1] + LONGEST_M / 2 * direction[b]]]
        )
        for line, back, a, b in zip(lines, behind, first, last, strict=True)
    ]
    boxes = boxes_of(reached, ROUNDING_M)
    boxes[:, :2] -= margin[:, None]
    boxes[:, 2:] += margin[:, None]
    return LaneLines(
        start=np.concatenate([line[:-1] for line in lines]).astype(np.float64),
        direction=direction,
        size=size,
        begin=np.concatenate(
            [np.cumsum(size[a : b + 1]) - size[a : b + 1] for a, b in zip(first, last, strict=True)]
        ),
        first=first,
        last=last,
        connector=crosses,
        margin=margin,
        length=np.array([lane.length for lane in lanes], dtype=np.float64),
        behind=behind,
        cells=cells_of(boxes, np.arange(len(lanes)), CELL_M),
    )


@in_place(inner=True)
def project(x: float, y: float, k: int, lines: LaneLines) -> tuple[float, float, int]:
    """The place on a lane nearest to a point.

    Returns:
        Its distance along the lane, m, how far away it is, m, and the piece that it is on.
    """
    best, s, piece = np.inf, 0.0, lines.first[k]
    first, last = lines.first[k], lines.last[k]
    for g in range(first, last + 1):
        dx, dy = x - lines.start[g, 0], y - lines.start[g, 1]
        along = dx * lines.direction[g, 0] + dy * lines.direction[g, 1]
        across = dy * lines.direction[g, 0] - dx * lines.direction[g, 1]
        clipped = along
        if along < 0.0 and g > first:
            clipped = 0.0
        elif along > lines.size[g] and g < last:
            clipped = lines.size[g]
        beyond = along - clipped
        if max(abs(across), abs(beyond)) >= best:
            continue  # the distance is no less than either
        distance = math.hypot(across, beyond) if beyond != 0.0 else abs(across)
        if distance < best:
            best, s, piece = distance, lines.begin[g] + clipped, g
    return s, best, piece


def distances_along(xy: FloatArray, lane: IntArray, lines: LaneLines) -> FloatArray:
    """(n,) distance of each point (n, 2) along the lane (n,) that is given for it, m."""
    s = np.empty(len(lane))
    _find_distances(xy, lane, lines, s)
    return s


@in_place()
def _find_distances(xy: FloatArray, lane: IntArray, lines: LaneLines, s: FloatArray) -> None:
    for i in range(len(lane)):
        s[i] = project(xy[i, 0], xy[i, 1], lane[i], lines)[0]


def find_on_lanes(
    xy: FloatArray, heading: FloatArray, speed: FloatArray, length: FloatArray, lines: LaneLines
) -> OnLanes:
    """The vehicles on each lane; those at the same place are in the order of rows.

    Args:
        xy: (n, 2) m.
        heading: (n,) rad.
        speed: (n,) m/s.
        length: (n,) m; those of more than `LONGEST_M` count as that long.
        lines: of the lanes.
    """
    found, room = 8 * len(xy) + 8, 0
    while found > room:  # once more if there are more entries than there was room for
        room = found
        row, lane = np.empty(room, np.int64), np.empty(room, np.int64)
        s, along = np.empty(room), np.empty(room)
        found = _find_entries(xy, heading, speed, length, lines, row, lane, s, along)
    first = np.zeros(len(lines.first) + 1, np.int64)
    on = OnLanes(first, np.empty(found, np.int64), np.empty(found), np.empty(found))
    _sort_entries(row, lane, s, along, np.empty(len(lines.first), np.int64), on)
    return on


@in_place()
def _find_entries(
    xy: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    lines: LaneLines,
    row: IntArray,
    lane: IntArray,
    s: FloatArray,
    along: FloatArray,
) -> int:
    """Find the lanes that each vehicle is on.

    Args:
        xy: (n, 2) and the next four as of `find_on_lanes`.
        heading: (n,).
        speed: (n,).
        length: (n,).
        lines: of the lanes.
        row: (R,) receives the vehicle of each entry; entries without room are left out.
        lane: (R,) receives its lane.
        s: (R,) receives its distance along the lane, m.
        along: (R,) receives its speed along the lane, m/s.

    Returns:
        How many entries there are.
    """
    cells, found = lines.cells, 0
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        column, line = (x - cells.x0) / cells.size, (y - cells.y0) / cells.size
        if not (0.0 <= column < cells.columns and 0.0 <= line < cells.rows):
            continue
        cell = int(line) * cells.columns + int(column)
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for at in range(cells.first[cell], cells.first[cell + 1]):
            k = cells.items[at]
            place, distance, piece = project(x, y, k, lines)
            facing = cos * lines.direction[piece, 0] + sin * lines.direction[piece, 1]
            aligned = facing if lines.connector[k] else abs(facing)
            if not (
                distance <= lines.margin[k]
                and aligned > ALIGNED
                and place >= -lines.behind[k]
                and place <= lines.length[k] + min(length[i], LONGEST_M) / 2
            ):
                continue
            if found < row.size:
                row[found], lane[found], s[found], along[found] = i, k, place, speed[i] * facing
            found += 1
    return found


@in_place()
def _sort_entries(
    row: IntArray, lane: IntArray, s: FloatArray, along: FloatArray, end: IntArray, out: OnLanes
) -> None:
    """Sort entries by lane, then by distance along it; equals stay as they are.

    Args:
        row: (R,) vehicles, of which as many count as there is room for in ``out``.
        lane: (R,) their lanes.
        s: (R,) their distances along these, m.
        along: (R,) their speeds along these, m/s.
        end: (K,) room to work in.
        out: receives the entries; ``first`` must be 0 before.
    """
    first, order, distances, speeds = out.first, out.row, out.s, out.along
    for e in range(order.size):
        first[lane[e] + 1] += 1
    for k in range(end.size):
        end[k] = first[k]
        first[k + 1] += first[k]
    for e in range(order.size):
        k = lane[e]
        at = end[k]
        while at > first[k] and distances[at - 1] > s[e]:
            order[at], distances[at], speeds[at] = order[at - 1], distances[at - 1], speeds[at - 1]
            at -= 1
        order[at], distances[at], speeds[at] = row[e], s[e], along[e]
        end[k] += 1
