"""A `Road` as OpenDRIVE 1.7: a road for each edge, and one for each path over a junction.

A road's reference line is the centre line of its leftmost lane, piece by piece straight, and the
lanes lie on its right, as `Road` has them; edges whose lanes are not parallel get a road for each
lane. Paths over a junction are connecting roads with one lane; where lanes touch, roads follow each
other or meet in a direct junction. Signals and crosswalks stand on the roads that lead to them.

References:
    ASAM OpenDRIVE 1.7.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from scenariogeneration import xodr
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sim.frames import FloatArray
from sim.geometry import borders, distances_along, pieces_of, points_at
from sim.road import Connection, Crossing, Lane, Road
from sim.road.lane_search import along

PARALLEL_M: Final = 0.25
"""Lanes of an edge that are nowhere further than this from where their widths place them share a
road, m (a vehicle is then on its lane)."""

SHORTEST_M: Final = 0.01
"""Pieces of a line shorter than this are left out, m."""

STRAIGHT_RAD: Final = 1e-5
"""Pieces of a line that bend by less than this are one, rad (as ASAM's checker has it; a
millimetre in 100 m)."""

TOUCHING_M: Final = 0.01
"""Lanes whose borders end this near to each other need no path between them, m (as ASAM's checker
has it)."""

LEAD_M: Final = 0.05
"""Connecting roads go on so far as the road before them, and end so far as the one after, m."""

SIGNAL_TYPE: Final = "1000001"
"""A traffic light with three colours, in OpenDRIVE's own catalogue of signals."""

FAST_MPS: Final = 22.3
"""Roads with a higher limit are motorways, others lie in a town (80 km/h)."""

FIRST_JUNCTION: Final = 10_000
"""The id of the first junction; those of roads are smaller."""

NO_DATE: Final = "1970-01-01T00:00:00"
"""The date in headers: files of the same episode are the same to the byte."""


class _Part(NamedTuple):
    """One road of the file: lanes of an edge, or a path over a junction.

    Attributes:
        road: as the library has it.
        lanes: from the left; their numbers are -1, -2, ...
        line: (P, 2) its reference line, m.
    """

    road: Any
    lanes: Sequence[Lane]
    line: FloatArray

    @property
    def length_m(self) -> float:
        """Length of the reference line, m."""
        return float(distances_along(self.line)[-1])

    @property
    def right_m(self) -> float:
        """How far the right edge lies to the right of the reference line, m."""
        return sum(lane.width_m for lane in self.lanes) - self.lanes[0].width_m / 2

    def end_of(self, lane: int, *, after: bool) -> tuple[FloatArray, FloatArray, float]:
        """The middle, direction and width of a lane at its end or start."""
        a, b = self.line[-2:] if after else self.line[:2]
        ahead = (b - a) / math.dist(a, b)
        widths = [one.width_m for one in self.lanes]
        k = -1 - lane
        off_m = widths[0] / 2 - sum(widths[:k]) - widths[k] / 2
        return (b if after else a) + off_m * np.array([-ahead[1], ahead[0]]), ahead, widths[k]


Place = tuple[_Part, int]
"""A lane's road and its number there."""

Way = tuple[_Part, int, _Part, int]
"""The road and lane from which a connection leads, and those to which it leads."""


def opendrive(road: Road, name: str) -> tuple[bytes, list[list[str]]]:
    """A road as an OpenDRIVE file, and the ids of the signals of each signal group.

    What a map does not tell is left out.
    """
    parts, places = _roads_of_edges(road)
    junctions = _meet(road, parts, places)
    signals = _add_signals(road, parts, places)
    for number, crossing in enumerate(road.crossings, start=1):
        _add_crosswalk([one for one in parts if one.road.road_type < 0], crossing, number)
    file = xodr.OpenDrive(name, revMinor="7")
    for part in parts:
        file.add_road(part.road)
    for junction in junctions:
        file.add_junction(junction)
    root = file.get_element()
    root.find("header").set("date", NO_DATE)
    for light in root.iter("signal"):
        light.set("country", "OpenDRIVE")  # the library writes capitals, which the schema refuses
    return as_bytes(root), signals


def as_bytes(root: ET.Element) -> bytes:
    """An element as an indented file."""
    ET.indent(root)
    text = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return bytes(text) + b"\n"


def _roads_of_edges(road: Road) -> tuple[list[_Part], dict[str, Place]]:
    """A road for each edge, or for each of its lanes where these are not parallel."""
    edges: dict[str, list[Lane]] = {}
    for lane in road.lanes:
        if not lane.internal:
            edges.setdefault(lane.edge, []).append(lane)
    parts, places = list[_Part](), dict[str, Place]()
    for lanes in edges.values():
        lanes.sort(key=lambda one: -one.index)  # from the left
        for group in [lanes] if _parallel(lanes) else [[lane] for lane in lanes]:
            parts.append(_part(len(parts) + 1, group, group[0].centerline))
            places |= {lane.id: (parts[-1], -1 - k) for k, lane in enumerate(group)}
    return parts, places


def _parallel(lanes: Sequence[Lane]) -> bool:
    """Whether each lane lies where the widths of those on its left place it."""
    line, off_m = _cleaned(lanes[0].centerline), 0.0
    for one, then in itertools.pairwise(lanes):
        off_m += (one.width_m + then.width_m) / 2
        s, t, length_m = along(line, then.centerline)
        away = np.hypot(*(then.centerline - points_at(line, s)).T)  # more than t outside a bend
        t = np.where((s >= 0.0) & (s <= length_m), np.copysign(away, t), t)
        beyond_m = max(-s.min(), s.max() - length_m)
        longer_m = abs(then.length_m - length_m)
        aside_m = np.abs(t + off_m).max()
        if aside_m > PARALLEL_M or beyond_m > 0.5 or longer_m > 2.0 * off_m + 0.5:
            return False
    return True


def _cleaned(line: FloatArray) -> FloatArray:
    """A line without pieces that are too short or go on straight; two points at least."""
    kept = [line[0]]
    for point in line[1:]:
        if math.dist(point, kept[-1]) >= SHORTEST_M:
            kept.append(point)
    if len(kept) == 1:
        kept.append(kept[0] + np.array([SHORTEST_M, 0.0]))
    bent = [kept[0]]
    for point, then in itertools.pairwise(kept[1:]):
        (ax, ay), (bx, by) = point - bent[-1], then - point
        if abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by)) > STRAIGHT_RAD:
            bent.append(point)
    return np.array([*bent, kept[-1]])


def _part(
    number: int, lanes: Sequence[Lane], line: FloatArray, junction: int = -1,
    widths_m: tuple[float, float] | None = None,
) -> _Part:  # fmt: skip
    """A road of lanes, from the left; of a path, with its own widths at its start and its end."""
    line = _cleaned(line)
    length_m = float(distances_along(line)[-1])
    view = xodr.PlanView()
    for a, b in itertools.pairwise(line):
        heading = math.atan2(b[1] - a[1], b[0] - a[0])
        view.add_fixed_geometry(xodr.Line(math.dist(a, b)), float(a[0]), float(a[1]), heading)
    section = xodr.LaneSection(0, xodr.Lane(lane_type=xodr.LaneType.none))
    for lane in lanes:
        kind = "sidewalk" if lane.walking else "driving" if lane.cars else "restricted"
        begin_m, end_m = widths_m or (lane.width_m, lane.width_m)
        growth = (end_m - begin_m) / length_m
        made = xodr.Lane(lane_type=getattr(xodr.LaneType, kind), a=begin_m, b=growth)
        mark = xodr.RoadMarkType.solid if lane is lanes[-1] else xodr.RoadMarkType.broken
        made.add_roadmark(xodr.RoadMark(mark, 0.12))
        section.add_right_lane(made)
    first_m, last_m = widths_m or (lanes[0].width_m, lanes[0].width_m)
    sections = xodr.Lanes()
    sections.add_laneoffset(xodr.LaneOffset(0, first_m / 2, (last_m - first_m) / 2 / length_m))
    sections.add_lanesection(section)
    road = xodr.Road(number, view, sections, junction, name=lanes[0].edge)
    limits = [lane.speed_limit_mps for lane in lanes if not lane.walking]
    limit = max((one for one in limits if math.isfinite(one)), default=None)
    fast = limit is not None and limit > FAST_MPS
    road.add_type(xodr.RoadType.motorway if fast else xodr.RoadType.town, speed=limit)
    return _Part(road, lanes, line)


def _meet(road: Road, parts: list[_Part], places: dict[str, Place]) -> list[Any]:
    """The junctions; roads are told what comes before and after them, paths become roads."""
    lanes = {lane.id: lane for lane in road.lanes}
    links = [one for one in road.connections if {one.from_lane, one.to_lane} <= places.keys()]
    ways = [(*places[one.from_lane], *places[one.to_lane]) for one in links]
    # connections that share the end or the beginning of a road meet
    ids = np.array([(way[0].road.id, way[2].road.id) for way in ways], np.int64).reshape(-1, 2)
    count = 2 * len(parts) + 1
    graph = coo_array((np.ones(len(ids)), (ids[:, 0], ids[:, 1] + len(parts))), (count, count))
    groups: dict[int, list[int]] = {}
    for index, at in enumerate(connected_components(graph)[1][ids[:, 0]].tolist()):
        groups.setdefault(at, []).append(index)
    junctions: list[Any] = []
    for group in groups.values():
        direct = all(_touch(links[i], ways[i]) for i in group)
        begins = {ways[i][0].road.id: ways[i][0] for i in group}
        ends = {ways[i][2].road.id: ways[i][2] for i in group}
        if direct and len(begins) == len(ends) == 1:
            begin, _, end, _ = ways[group[0]]
            _connect(begin, "successor", end, [(ways[i][1], ways[i][3]) for i in group])
            _connect(end, "predecessor", begin, [(ways[i][3], ways[i][1]) for i in group])
            continue
        number = FIRST_JUNCTION + len(junctions)
        for begin in begins.values():
            begin.road.add_successor(xodr.ElementType.junction, number)
        for end in ends.values():
            end.road.add_predecessor(xodr.ElementType.junction, number)
        joined: dict[tuple[int, int], Any] = {}
        for i in group:
            begin, lane, onto, to_lane = ways[i]
            if not direct:
                onto, to_lane = _path(links[i], ways[i], lanes, number, len(parts) + 1), -1
                parts.append(onto)
            both = begin.road.id, onto.road.id
            if both not in joined:
                joined[both] = xodr.Connection(*both, xodr.ContactPoint.start)
            joined[both].add_lanelink(lane, to_lane)
        kind = xodr.JunctionType.direct if direct else xodr.JunctionType.default
        junctions.append(xodr.Junction(f"junction {number}", number, kind))
        for one in joined.values():
            junctions[-1].add_connection(one)
    return junctions


def _connect(part: _Part, what: str, other: _Part, lanes: Sequence[tuple[int, int]]) -> None:
    """Tell a road which one comes before or after it, and its lanes which of its lanes."""
    after = what == "successor"
    add = part.road.add_successor if after else part.road.add_predecessor
    point = xodr.ContactPoint.start if after else xodr.ContactPoint.end
    add(xodr.ElementType.road, other.road.id, point)
    own = part.road.lanes.lanesections[0].rightlanes
    for mine, its in dict(reversed(lanes)).items():  # of several, the first
        own[-1 - mine].add_link(what, its)


def _touch(link: Connection, way: Way) -> bool:
    """Whether a connection needs no path: its lanes meet without a gap, a bend or a step."""
    begin, lane, end, to_lane = way
    at, ahead, width = begin.end_of(lane, after=True)
    there, onward, wide = end.end_of(to_lane, after=False)
    apart_m = max(math.dist(at, there), abs(width - wide), math.dist(ahead, onward) * width)
    return not link.via and apart_m < TOUCHING_M


def _path(
    link: Connection, way: Way, lanes: dict[str, Lane], junction: int, number: int
) -> _Part:  # fmt: skip
    """A connection of a junction as a road of its own."""
    begin, from_lane, end, to_lane = way
    at, ahead, width = begin.end_of(from_lane, after=True)
    there, onward, wide = end.end_of(to_lane, after=False)
    over = [lanes[via] for via in link.via if via in lanes]
    # it begins and ends as its roads do, so that no gap opens at their borders
    first, last = [at, at + LEAD_M * ahead], [there - LEAD_M * onward, there]
    line = np.concatenate([first, *(one.centerline for one in over), last])
    path = _part(number, [*over, lanes[link.from_lane]][:1], line, junction, (width, wide))
    _connect(path, "predecessor", begin, [(-1, from_lane)])
    _connect(path, "successor", end, [(-1, to_lane)])
    return path


def _add_signals(road: Road, parts: list[_Part], places: dict[str, Place]) -> list[list[str]]:
    """A light for each signal group at the end of each road that it controls; ids by group."""
    controlled: dict[tuple[int, int], list[int]] = {}
    for link in road.connections:
        if link.signal >= 0 and link.from_lane in places:
            part, lane = places[link.from_lane]
            controlled.setdefault((part.road.id, link.signal), []).append(lane)
    ids: list[list[str]] = [[] for _ in road.signal_groups]
    for count, ((number, group), lanes) in enumerate(sorted(controlled.items()), start=1):
        part = parts[number - 1]
        light = xodr.Signal(
            s=part.length_m, t=-part.right_m, country="OpenDRIVE", Type=SIGNAL_TYPE, id=str(count),
            name=road.signal_groups[group], dynamic=xodr.Dynamic.yes, zOffset=3.0, height=1.0,
            width=0.4,
        )  # fmt: skip
        light.add_validity(min(lanes), max(lanes))
        part.road.signals.append(light)  # add_signal counts ids over all files of a process
        ids[group].append(str(count))
    return ids


def _add_crosswalk(parts: list[_Part], crossing: Crossing, number: int) -> None:
    """A crosswalk as an object of the nearest road that it crosses, or of any."""
    begin, end = crossing.centerline[[0, -1]]
    middle, size = (begin + end) / 2, math.dist(begin, end)
    named = [part for part in parts if part.lanes[0].edge in crossing.edges] or parts
    if size <= 0 or not named:
        return
    part = min(named, key=lambda one: float(np.hypot(*(one.line - middle).T).min()))
    (s,), (t,), length_m = along(part.line, middle[None])
    s, t = np.clip(s, 0.0, length_m), np.clip(t, -part.right_m, part.lanes[0].width_m / 2)
    pieces = pieces_of(part.line)
    dx, dy = pieces.direction[max(int(np.searchsorted(pieces.at, s)) - 1, 0)]
    origin = points_at(part.line, np.array([s]))[0] + t * np.array([-dy, dx])
    outline = xodr.Outline(id=0, closed=True)
    right, left = borders(crossing.centerline[[-1, 0]], crossing.width_m)
    for corner in (left[1], right[1], right[0], left[0]):
        u, v = np.array([[dx, dy], [-dy, dx]]) @ (corner - origin)
        outline.add_corner(xodr.CornerLocal(float(u), float(v), 0.0, 0.01))
    walk = xodr.Object(
        float(s), float(t), xodr.ObjectType.crosswalk, id=str(number), name=crossing.id,
        orientation=xodr.Orientation.none, length=size, width=crossing.width_m, height=0.01,
    )  # fmt: skip
    walk.add_outline(outline)
    part.road.objects.append(walk)
