"""The shapes of a road that pictures draw: surfaces, painted lines, zebra crossings, stop lines.

The replay page, videos and the highway viewer draw these points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull

from sim.frames import FloatArray
from sim.geometry import distances_along, offset_line, points_at
from sim.road import Lane, Road

DASH_M: Final = (3.0, 6.0)
"""Length of a dash and of the gap after it, m (common on urban roads)."""

BAR_M: Final = (0.5, 0.5)
"""Width of a zebra's bar and of the gap after it, m."""

LONGEST_M: Final = 1_000.0
"""Longest part of a crossing that is drawn, m (broken maps have crossings across a country)."""

CORNER_M: Final = 4.0
"""How much wider a junction's paving is than its asphalt, m (two sidewalks)."""

SAME_LINE_M: Final = 0.5
"""Lane borders of two directions that are this close are one line, m."""


@dataclass(frozen=True, slots=True, eq=False)
class StopLine:
    """Where vehicles stop.

    Attributes:
        line: (2, 2) its ends, m.
        signal: index of the signal group that it obeys, -1 if none.
    """

    line: FloatArray
    signal: int


@dataclass(frozen=True, slots=True, eq=False)
class RoadShapes:
    """Everything about a road that does not move; polygons and lines are (P, 2), m.

    Attributes:
        paving: polygons people walk on.
        asphalt: polygons vehicles drive on.
        dashes: (D, 2, 2) ends of each dash between lanes.
        edges: lines along the border of the carriageway.
        middles: lines between the two directions.
        bars: the four-cornered bars of zebra crossings.
        stops: stop lines.
    """

    paving: tuple[FloatArray, ...]
    asphalt: tuple[FloatArray, ...]
    dashes: FloatArray
    edges: tuple[FloatArray, ...]
    middles: tuple[FloatArray, ...]
    bars: tuple[FloatArray, ...]
    stops: tuple[StopLine, ...]


def band(line: FloatArray, width_m: float) -> FloatArray:
    """The outline of a band along a line.

    Args:
        line: (P, 2) m.
        width_m: m.

    Returns:
        (2 P, 2) its right side (for y up) forwards, then its left side backwards, m.

    Examples:
        >>> band(np.array([[0.0, 0.0], [4.0, 0.0]]), 2.0).tolist()
        [[0.0, -1.0], [4.0, -1.0], [4.0, 1.0], [0.0, 1.0]]
    """
    right, left = offset_line(line, -width_m / 2), offset_line(line, width_m / 2)
    return np.concatenate([right, left[::-1]])


def hull(points: FloatArray) -> FloatArray:
    """The convex hull of points (n, 2), counter-clockwise."""
    return points[ConvexHull(points, qhull_options="QJ").vertices]


def zebra_bars(line: FloatArray, width_m: float) -> list[FloatArray]:
    """(4, 2) corners of each bar of a zebra crossing along a line (P, 2), m."""
    step = line[-1] - line[0]
    size = float(np.hypot(*step))
    direction = step / size
    aside = np.array([-direction[1], direction[0]]) * width_m / 2
    bars = []
    for begin in np.arange(BAR_M[1] / 2, min(size, LONGEST_M) - BAR_M[0], sum(BAR_M)):
        a, b = line[0] + direction * begin, line[0] + direction * (begin + BAR_M[0])
        bars.append(np.array([a - aside, b - aside, b + aside, a + aside]))
    return bars


def dashes_along(line: FloatArray) -> FloatArray:
    """(D, 2, 2) ends of the dashes along a line (P, 2), m."""
    length_m = distances_along(line)[-1]
    begin = np.arange(0.0, length_m, sum(DASH_M))
    end = np.minimum(begin + DASH_M[0], length_m)
    return np.stack([points_at(line, begin), points_at(line, end)], axis=1)


def road_shapes(road: Road) -> RoadShapes:
    """Everything about a road that pictures draw."""
    plain = [lane for lane in road.lanes if not lane.internal]
    driving = [lane for lane in plain if not lane.walking]
    asphalt = [band(lane.centerline, lane.width_m) for lane in driving]
    paving = [band(lane.centerline, lane.width_m) for lane in plain if lane.walking]
    for paths in _junctions(road):
        bands = [band(path.centerline, path.width_m) for path in paths]
        asphalt.append(hull(np.concatenate(bands)))
        if any(lane.walking for lane in plain):
            bands = [band(path.centerline, path.width_m + CORNER_M) for path in paths]
            paving.append(hull(np.concatenate(bands)))
    dashes, edges, middles = _painted(driving)
    bars = [bar for c in road.crossings for bar in zebra_bars(c.centerline, c.width_m)]
    return RoadShapes(
        paving=tuple(paving),
        asphalt=tuple(asphalt),
        dashes=np.concatenate(dashes) if dashes else np.empty((0, 2, 2)),
        edges=tuple(edges),
        middles=tuple(middles),
        bars=tuple(bars),
        stops=_stop_lines(road, driving),
    )


def _junctions(road: Road) -> list[list[Lane]]:
    """The paths of vehicles across each junction; a net names them ``:JUNCTION_number``."""
    found: dict[str, list[Lane]] = {}
    for lane in road.lanes:
        if lane.internal and not lane.walking:
            found.setdefault(lane.edge.rpartition("_")[0], []).append(lane)
    return list(found.values())


def _right_and_left(lane: Lane) -> tuple[FloatArray, FloatArray]:
    half_m = lane.width_m / 2
    return offset_line(lane.centerline, -half_m), offset_line(lane.centerline, half_m)


def _painted(
    driving: list[Lane],
) -> tuple[list[FloatArray], list[FloatArray], list[FloatArray]]:
    """Dashes, edges and middle lines of the lanes."""
    dashes, edges, middles = [], [], []
    leftmost = {lane.edge: lane for lane in sorted(driving, key=lambda lane: lane.index)}
    rightmost = {lane.edge: lane for lane in sorted(driving, key=lambda lane: -lane.index)}
    borders = {edge: _right_and_left(lane)[1] for edge, lane in leftmost.items()}
    for lane in driving:
        right, left = _right_and_left(lane)
        if rightmost[lane.edge] is lane:
            edges.append(right)
        if leftmost[lane.edge] is not lane or lane.opposite:
            dashes.append(dashes_along(left))
        elif any(
            np.hypot(*(left[0] - other[-1])) < SAME_LINE_M
            for edge, other in borders.items()
            if edge != lane.edge
        ):
            middles.append(left)
        else:
            edges.append(left)
    return dashes, edges, middles


def _stop_lines(road: Road, driving: list[Lane]) -> tuple[StopLine, ...]:
    """A line at the end of every lane that has a signal, a rule or a crossing there."""
    found = []
    for lane in driving:
        ways = [link for link in road.connections if link.from_lane == lane.id]
        held = any(link.must_stop or (link.must_yield and link.signal < 0) for link in ways)
        end = lane.centerline[-1]
        crossed = any(
            _distance(end, crossing.centerline) < crossing.width_m / 2 + 1.5
            for crossing in road.crossings
        )
        signal = max((link.signal for link in ways), default=-1)
        if ways and (held or crossed or signal >= 0):
            right, left = _right_and_left(lane)
            found.append(StopLine(np.stack([right[-1], left[-1]]), signal))
    return tuple(found)


def _distance(point: FloatArray, line: FloatArray) -> float:
    """From a point to the straight line between a line's ends, m."""
    a, b = line[0], line[-1]
    u = np.clip(np.dot(point - a, b - a) / max(float(np.dot(b - a, b - a)), 1e-9), 0.0, 1.0)
    return float(np.hypot(*(point - a - u * (b - a))))
