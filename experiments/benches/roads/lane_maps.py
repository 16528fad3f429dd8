"""A road lane by lane as a Lanelet2, CommonRoad or Argoverse 2 map, to try the readers with.

Every lane for cars and every path over a junction becomes a lanelet or lane segment with its
borders, successors and neighbours. Limits, signals and priority are left out, as many maps do.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from sim.frames import FloatArray
from sim.road import Lane, Road

DEGREE_M: Final = 111_320.0
"""Length of a degree on the equator, m; readers take ``local_x`` and ``local_y`` where they are."""

SAME_POINT_M: Final = 0.5
"""Ends of borders as near as this are one point (less than a lane's width)."""


@dataclass
class _Part:
    """One lane with its place among the others."""

    number: int
    left: FloatArray
    right: FloatArray
    internal: bool
    after: list[int] = field(default_factory=list)
    before: list[int] = field(default_factory=list)
    left_of: int | None = None
    right_of: int | None = None


def _parts(road: Road) -> list[_Part]:
    """The lanes for cars, numbered from 1."""
    lanes = [lane for lane in road.lanes if lane.cars and not lane.walking]
    parts = {
        lane.id: _Part(k, *_borders(lane), lane.internal) for k, lane in enumerate(lanes, start=1)
    }
    for link in road.connections:
        chain = [one for one in (link.from_lane, *link.via, link.to_lane) if one in parts]
        for one, then in pairwise(chain):
            if parts[then].number not in parts[one].after:
                parts[one].after.append(parts[then].number)
                parts[then].before.append(parts[one].number)
    place = {(lane.edge, lane.index): lane.id for lane in lanes if not lane.internal}
    for (edge, index), name in place.items():
        other = place.get((edge, index + 1))
        if other is not None:
            parts[name].left_of, parts[other].right_of = parts[other].number, parts[name].number
            parts[other].right = parts[name].left
    return list(parts.values())


def _borders(lane: Lane) -> tuple[FloatArray, FloatArray]:
    """(P, 2) the left and the right border of a lane, m."""
    line = lane.centerline
    step = np.gradient(line, axis=0)
    size = np.maximum(np.hypot(*step.T), 1e-9)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / size[:, None]
    return line + lane.width_m / 2 * normal, line - lane.width_m / 2 * normal


def commonroad_map(road: Road) -> str:
    """A road as a CommonRoad scenario without obstacles (2020a)."""

    def bound(side: str, line: FloatArray) -> str:
        points = "".join(f"<point><x>{x:.3f}</x><y>{y:.3f}</y></point>" for x, y in line)
        return f"<{side}Bound>{points}</{side}Bound>"

    def adjacent(side: str, other: int | None) -> str:
        return f'<adjacent{side} ref="{other}" drivingDir="same"/>' if other is not None else ""

    rows = [
        f'<lanelet id="{one.number}">{bound("left", one.left)}{bound("right", one.right)}'
        + "".join(f'<predecessor ref="{other}"/>' for other in one.before)
        + "".join(f'<successor ref="{other}"/>' for other in one.after)
        + adjacent("Left", one.left_of)
        + adjacent("Right", one.right_of)
        + "<laneletType>urban</laneletType></lanelet>"
        for one in _parts(road)
    ]
    return (
        '<?xml version="1.0"?>\n<commonRoad benchmarkID="ZAM_Odd-1_1_T-1" '
        f'commonRoadVersion="2020a" timeStepSize="0.1">{"".join(rows)}</commonRoad>\n'
    )


def argoverse2_map(road: Road) -> str:
    """A road as an Argoverse 2 map."""

    def border(line: FloatArray) -> list[dict[str, float]]:
        return [{"x": round(float(x), 3), "y": round(float(y), 3), "z": 0.0} for x, y in line]

    segments = {
        str(one.number): {
            "id": one.number,
            "is_intersection": one.internal,
            "lane_type": "VEHICLE",
            "left_lane_boundary": border(one.left),
            "left_lane_mark_type": "DASHED_WHITE" if one.left_of else "SOLID_WHITE",
            "right_lane_boundary": border(one.right),
            "right_lane_mark_type": "DASHED_WHITE" if one.right_of else "SOLID_WHITE",
            "left_neighbor_id": one.left_of,
            "right_neighbor_id": one.right_of,
            "predecessors": one.before,
            "successors": one.after,
        }
        for one in _parts(road)
    }
    return json.dumps({"lane_segments": segments, "pedestrian_crossings": {}, "drivable_areas": {}})


@dataclass
class _Points:
    """Points of borders; ends that are near to each other are one point."""

    places: list[tuple[float, float]] = field(default_factory=list)
    _ends: list[int] = field(default_factory=list)

    def end(self, x: float, y: float) -> int:
        """The number of a point at which borders meet."""
        for number in self._ends:
            if np.hypot(x - self.places[number - 1][0], y - self.places[number - 1][1]) < (
                SAME_POINT_M
            ):
                return number
        self._ends.append(self.inner(x, y))
        return self._ends[-1]

    def inner(self, x: float, y: float) -> int:
        """The number of a new point."""
        self.places.append((x, y))
        return len(self.places)

    def line(self, points: FloatArray) -> list[int]:
        """The numbers of a border's points."""
        (first, *between, last) = points.tolist()
        return [self.end(*first), *(self.inner(*one) for one in between), self.end(*last)]


def lanelet2_map(road: Road) -> str:
    """A road as a Lanelet2 map; lanelets that share a border may be changed to."""
    points, ways, relations = _Points(), list[str](), list[str]()
    first_way, first_lanelet = 1_000_000, 2_000_000
    drawn: dict[int, int] = {}
    for one in _parts(road):
        numbers = []
        for side, line in (("left", one.left), ("right", one.right)):
            key = id(line)
            if key not in drawn:
                drawn[key] = first_way + len(ways)
                inner = side == "left" and one.left_of is not None
                inner |= side == "right" and one.right_of is not None
                refs = "".join(f'<nd ref="{number}"/>' for number in points.line(line))
                ways.append(
                    f'<way id="{drawn[key]}">{refs}<tag k="type" v="line_thin"/>'
                    f'<tag k="subtype" v="{"dashed" if inner else "solid"}"/></way>'
                )
            numbers.append(drawn[key])
        relations.append(
            f'<relation id="{first_lanelet + one.number}">'
            f'<member type="way" ref="{numbers[0]}" role="left"/>'
            f'<member type="way" ref="{numbers[1]}" role="right"/>'
            + "".join(f'<tag k="{k}" v="{v}"/>' for k, v in _tags(one))
            + "</relation>"
        )
    nodes = [
        f'<node id="{number}" lat="{y / DEGREE_M:.9f}" lon="{x / DEGREE_M:.9f}">'
        f'<tag k="local_x" v="{x:.3f}"/><tag k="local_y" v="{y:.3f}"/></node>'
        for number, (x, y) in enumerate(points.places, start=1)
    ]
    rows = "\n".join([*nodes, *ways, *relations])
    return f'<?xml version="1.0"?>\n<osm version="0.6">{rows}</osm>\n'


def _tags(part: _Part) -> Iterable[tuple[str, str]]:
    yield from (("type", "lanelet"), ("subtype", "road"), ("location", "urban"))
    yield from (("one_way", "yes"), ("participant:vehicle", "yes"))
    if part.internal:
        yield "turn_direction", "straight"
