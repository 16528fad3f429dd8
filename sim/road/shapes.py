"""The shapes of a road that pictures draw: surfaces, painted lines, zebra crossings, stop lines.

The replay page, videos and the highway viewer draw these points.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from sim.frames import FloatArray
from sim.geometry import borders, distances_along, points_at
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

STOP_M: Final = 1.5
"""Lanes that end this close to a crossing have a stop line, m."""


class StopLine(NamedTuple):
    """Where vehicles stop: (2, 2) the line's ends, m, and its signal group, -1 if none."""

    line: FloatArray
    signal: int


class RoadShapes(NamedTuple):
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

    paving: list[FloatArray]
    asphalt: list[FloatArray]
    dashes: FloatArray
    edges: list[FloatArray]
    middles: list[FloatArray]
    bars: list[FloatArray]
    stops: list[StopLine]


def road_shapes(road: Road) -> RoadShapes:
    """Everything about a road that pictures draw."""
    driving = [lane for lane in road.lanes if not (lane.internal or lane.walking)]
    walking = [lane for lane in road.lanes if lane.walking and not lane.internal]
    asphalt = [_band(lane.centerline, lane.width_m) for lane in driving]
    paving = [_band(lane.centerline, lane.width_m) for lane in walking]
    junctions: dict[str, list[Lane]] = {}  # a net names their paths :JUNCTION_number
    for lane in road.lanes:
        if lane.internal and not lane.walking:
            junctions.setdefault(lane.edge.rpartition("_")[0], []).append(lane)
    for paths in junctions.values():
        asphalt.append(_hull(paths, 0.0))
        if walking:
            paving.append(_hull(paths, CORNER_M))
    bars = [bar for one in road.crossings for bar in _bars(one.centerline, one.width_m)]
    return RoadShapes(paving, asphalt, *_painted(driving), bars, _stop_lines(road, driving))


def _band(line: FloatArray, width_m: float) -> FloatArray:
    """(2 P, 2) the outline of a band along a line (P, 2): its right side, then its left back."""
    left, right = borders(line, width_m)
    return np.concatenate([right, left[::-1]])


def _hull(paths: list[Lane], wider_m: float) -> FloatArray:
    """The convex hull of paths across a junction, counter-clockwise."""
    points = np.concatenate([_band(path.centerline, path.width_m + wider_m) for path in paths])
    return points[ConvexHull(points, qhull_options="QJ").vertices]


def _parts(line: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """(n, 2, 2) ends of n parts of a line (P, 2), m."""
    return np.stack([points_at(line, begin), points_at(line, end)], axis=1)


def _bars(line: FloatArray, width_m: float) -> list[FloatArray]:
    """(4, 2) corners of each bar of a zebra crossing between the ends of a line (P, 2), m."""
    straight = line[[0, -1]]
    length_m = min(float(distances_along(straight)[-1]), LONGEST_M)
    begin = np.arange(BAR_M[1] / 2, length_m - BAR_M[0], sum(BAR_M))
    return [_band(bar, width_m) for bar in _parts(straight, begin, begin + BAR_M[0])]


def _painted(driving: list[Lane]) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
    """Dashes, edges and middle lines of the lanes."""
    dashes, edges, middles = [np.empty((0, 2, 2))], list[FloatArray](), list[FloatArray]()
    rightmost = {lane.edge: lane for lane in sorted(driving, key=lambda lane: -lane.index)}
    leftmost = {lane.edge: lane for lane in sorted(driving, key=lambda lane: lane.index)}
    ends = [borders(lane.centerline, lane.width_m)[0][-1] for lane in leftmost.values()]
    for lane in driving:
        left, right = borders(lane.centerline, lane.width_m)
        if rightmost[lane.edge] is lane:
            edges.append(right)
        if leftmost[lane.edge] is not lane or lane.opposite:
            length_m = distances_along(left)[-1]
            begin = np.arange(0.0, length_m, sum(DASH_M))
            dashes.append(_parts(left, begin, np.minimum(begin + DASH_M[0], length_m)))
            continue
        near = np.hypot(*(np.array(ends) - left[0]).T) < SAME_LINE_M
        near &= np.array([edge != lane.edge for edge in leftmost])
        (middles if near.any() else edges).append(left)
    return np.concatenate(dashes), edges, middles


def _stop_lines(road: Road, driving: list[Lane]) -> list[StopLine]:
    """A line at the end of every lane that has a signal, a rule or a crossing there."""
    found = []
    for lane in driving:
        ways = [link for link in road.connections if link.from_lane == lane.id]
        held = any(link.must_stop or (link.must_yield and link.signal < 0) for link in ways)
        end = lane.centerline[-1]
        crossed = any(_distance(end, c.centerline) < c.width_m / 2 + STOP_M for c in road.crossings)
        signal = max((link.signal for link in ways), default=-1)
        if ways and (held or crossed or signal >= 0):
            left, right = borders(lane.centerline, lane.width_m)
            found.append(StopLine(np.stack([right[-1], left[-1]]), signal))
    return found


def _distance(point: FloatArray, line: FloatArray) -> float:
    """From a point to the straight line between a line's ends, m."""
    a, b = line[0], line[-1]
    u = np.clip(np.dot(point - a, b - a) / max(float(np.dot(b - a, b - a)), 1e-9), 0.0, 1.0)
    return float(np.hypot(*(point - a - u * (b - a))))
