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
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scenariogeneration import xodr
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sim.frames import FloatArray
from sim.geometry import distances_along, pieces_of, points_at
from sim.road import Connection, Crossing, Lane, Road

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

NO_DATE: Final = "1970-01-01T00:00:00"
"""The date in headers: files of the same episode are the same to the byte."""


@dataclass
class _Part:
    """One road: some lanes of an edge, or a path over a junction.

    Attributes:
        number: its id.
        lanes: from the left.
        line: (P, 2) its reference line, m.
        junction: the id of the junction that it crosses; -1 for none.
        before: what comes before it: a road's number and lane, for each lane; or a junction's id.
        after: likewise.
        widths: of a connecting road's lane at its beginning and its end, m; None for the lane's.
    """

    number: int
    lanes: list[Lane]
    line: FloatArray
    junction: int = -1
    before: list[tuple[int, int, int]] | int | None = None
    after: list[tuple[int, int, int]] | int | None = None
    widths: tuple[float, float] | None = None

    @property
    def length_m(self) -> float:
        """Length of the reference line, m."""
        return float(distances_along(self.line)[-1])

    def end_of(self, lane: int, *, after: bool) -> tuple[FloatArray, FloatArray, float]:
        """The middle, direction and width of a lane (-1: the leftmost) at its end or start."""
        a, b = self.line[-2:] if after else self.line[:2]
        along = (b - a) / math.dist(a, b)
        left = np.array([-along[1], along[0]])
        widths = [one.width_m for one in self.lanes]
        k = -1 - lane
        off_m = widths[0] / 2 - sum(widths[:k]) - widths[k] / 2
        return (b if after else a) + off_m * left, along, widths[k]

    @property
    def right_m(self) -> float:
        """How far the right edge lies to the right of the reference line, m."""
        return sum(lane.width_m for lane in self.lanes) - self.lanes[0].width_m / 2


@dataclass
class _Roads:
    """The roads made so far, and the road of each lane with the lane's number on it."""

    parts: list[_Part] = field(default_factory=list)
    place: dict[str, tuple[_Part, int]] = field(default_factory=dict)

    def add(self, lanes: Sequence[Lane], line: FloatArray, junction: int = -1) -> _Part:
        """A new road of lanes, from the left."""
        part = _Part(len(self.parts) + 1, list(lanes), _cleaned(line), junction)
        self.parts.append(part)
        return part


@dataclass(frozen=True)
class RoadFile:
    """A road's file.

    Attributes:
        content: the XML.
        signals: for each signal group of the road, the ids of its signals.
    """

    content: bytes
    signals: tuple[tuple[str, ...], ...]


def opendrive(road: Road, name: str) -> RoadFile:
    """A road as OpenDRIVE; what a map does not tell is left out."""
    roads = _roads_of_edges(road)
    junctions = _meet(road, roads)
    signals: list[list[str]] = [[] for _ in road.signal_groups]
    made = {part.number: _element(part) for part in roads.parts}
    _add_signals(road, roads, made, signals)
    for number, crossing in enumerate(road.crossings):
        _add_crosswalk(roads, made, crossing, number)
    file = xodr.OpenDrive(name, revMinor="7")
    for one in made.values():
        file.add_road(one)
    for junction in junctions:
        file.add_junction(junction)
    root = file.get_element()
    header = root.find("header")
    assert header is not None
    header.set("date", NO_DATE)
    for light in root.iter("signal"):
        light.set("country", "OpenDRIVE")  # the library writes capitals, which the schema refuses
    return RoadFile(as_bytes(root), tuple(map(tuple, signals)))


def as_bytes(root: ET.Element) -> bytes:
    """An element as an indented file."""
    ET.indent(root)
    text = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return bytes(text) + b"\n"


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
        turn = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
        if abs(turn) > STRAIGHT_RAD:
            bent.append(point)
    return np.array([*bent, kept[-1]])


def _roads_of_edges(road: Road) -> _Roads:
    """A road for each edge, or for each of its lanes where these are not parallel."""
    edges: dict[str, list[Lane]] = {}
    for lane in road.lanes:
        if not lane.internal:
            edges.setdefault(lane.edge, []).append(lane)
    roads = _Roads()
    for lanes in edges.values():
        lanes.sort(key=lambda one: -one.index)  # from the left
        for group in [lanes] if _parallel(lanes) else [[lane] for lane in lanes]:
            part = roads.add(group, group[0].centerline)
            for k, lane in enumerate(group):
                roads.place[lane.id] = part, -1 - k
    return roads


def _parallel(lanes: Sequence[Lane]) -> bool:
    """Whether each lane lies where the widths of those on its left place it."""
    first, off_m = lanes[0], 0.0
    for one, then in itertools.pairwise(lanes):
        off_m += (one.width_m + then.width_m) / 2
        s, t = _along(first.centerline, then.centerline)
        beyond_m = max(-s.min(), s.max() - first.length_m)
        longer_m = abs(then.length_m - first.length_m)
        aside_m = np.abs(t + off_m).max()
        if aside_m > PARALLEL_M or beyond_m > 0.5 or longer_m > 2.0 * off_m + 0.5:
            return False
    return True


def _along(line: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) distances along a line and (n,) to its left, m; its ends go on straight."""
    pieces = pieces_of(line)
    off = points[:, None] - pieces.start
    along = (off * pieces.direction).sum(axis=2)
    left = pieces.direction[:, 0] * off[..., 1] - pieces.direction[:, 1] * off[..., 0]
    low, high = np.zeros(len(pieces.length)), pieces.length.copy()
    low[0], high[-1] = -np.inf, np.inf
    nearest = np.clip(along, low, high)
    away = np.hypot(left, along - nearest)
    place = np.arange(len(points)), away.argmin(axis=1)
    return pieces.at[place[1]] + nearest[place], np.copysign(away, left)[place]


def _meet(road: Road, roads: _Roads) -> list[Any]:
    """The junctions; roads are told what comes before and after them, paths become roads."""
    lanes = {lane.id: lane for lane in road.lanes}
    links = [
        link for link in road.connections if {link.from_lane, link.to_lane} <= roads.place.keys()
    ]
    parts = {part.number: part for part in roads.parts}
    # connections that share the end or the beginning of a road meet
    ways = np.array([_way(link, roads) for link in links], dtype=np.int64).reshape(-1, 4)
    places = 2 * ways[:, 0] + 1, 2 * ways[:, 2]
    joined = coo_array((np.ones(len(ways)), places), shape=(2 * len(parts) + 2,) * 2)
    _, meets = connected_components(joined)
    groups: dict[int, list[Connection]] = {}
    for link, at in zip(links, meets[places[0]].tolist(), strict=True):
        groups.setdefault(at, []).append(link)
    junctions: list[Any] = []
    for group in groups.values():
        direct = all(_touch(link, roads) for link in group)
        through = [_way(link, roads) for link in group]
        begins, ends = ({way[side] for way in through} for side in (0, 2))
        if direct and len(begins) == len(ends) == 1:
            parts[through[0][0]].after = [way[1:] for way in through]
            parts[through[0][2]].before = [(way[3], way[0], way[1]) for way in through]
            continue
        number = 10_000 + len(junctions)
        if not direct:
            through = [_path(link, lanes, roads, number) for link in group]
        for begin in begins:
            parts[begin].after = number
        for end in ends:
            parts[end].before = number
        junctions.append(_junction(number, direct, through))
    return junctions


def _way(link: Connection, roads: _Roads) -> tuple[int, int, int, int]:
    """The road and lane from which a connection leads, and those to which it leads."""
    begin, lane = roads.place[link.from_lane]
    end, to_lane = roads.place[link.to_lane]
    return begin.number, lane, end.number, to_lane


def _touch(link: Connection, roads: _Roads) -> bool:
    """Whether a connection needs no path: its lanes meet without a gap, a bend or a step."""
    (begin, lane), (end, to_lane) = roads.place[link.from_lane], roads.place[link.to_lane]
    at, along, width = begin.end_of(lane, after=True)
    there, onward, wide = end.end_of(to_lane, after=False)
    apart_m = max(math.dist(at, there), abs(width - wide), math.dist(along, onward) * width)
    return not link.via and apart_m < TOUCHING_M


def _path(
    link: Connection, lanes: dict[str, Lane], roads: _Roads, junction: int
) -> tuple[int, int, int, int]:
    """A connection of a junction as a road of its own, and the way onto that road."""
    (begin, from_lane), (end, to_lane) = roads.place[link.from_lane], roads.place[link.to_lane]
    at, along, width = begin.end_of(from_lane, after=True)
    there, onward, wide = end.end_of(to_lane, after=False)
    over = [lanes[via] for via in link.via if via in lanes]
    # it begins and ends as its roads do, so that no gap opens at their borders
    first, last = [at, at + LEAD_M * along], [there - LEAD_M * onward, there]
    line = np.concatenate([first, *(one.centerline for one in over), last])
    part = roads.add([over[0] if over else lanes[link.from_lane]], line, junction)
    part.widths = width, wide
    part.before, part.after = [(-1, begin.number, from_lane)], [(-1, end.number, to_lane)]
    return begin.number, from_lane, part.number, -1


def _element(part: _Part) -> Any:
    """A road as the library has it."""
    view = xodr.PlanView()
    for a, b in itertools.pairwise(part.line):
        heading = math.atan2(b[1] - a[1], b[0] - a[0])
        view.add_fixed_geometry(xodr.Line(math.dist(a, b)), float(a[0]), float(a[1]), heading)
    centre = xodr.Lane(lane_type=xodr.LaneType.none)
    section = xodr.LaneSection(0, centre)
    for k, lane in enumerate(part.lanes):
        kind = "sidewalk" if lane.walking else "driving" if lane.cars else "restricted"
        begin_m, end_m = part.widths or (lane.width_m, lane.width_m)
        growth = (end_m - begin_m) / part.length_m
        made = xodr.Lane(lane_type=getattr(xodr.LaneType, kind), a=begin_m, b=growth)
        last = k == len(part.lanes) - 1
        mark = xodr.RoadMarkType.solid if last else xodr.RoadMarkType.broken
        made.add_roadmark(xodr.RoadMark(mark, 0.12))
        for what, links in (("predecessor", part.before), ("successor", part.after)):
            for mine, _, other in links if isinstance(links, list) else ():
                if mine == -1 - k:
                    made.add_link(what, other)
                    break
        section.add_right_lane(made)
    lanes = xodr.Lanes()
    first_m, last_m = part.widths or (part.lanes[0].width_m, part.lanes[0].width_m)
    slope = (last_m - first_m) / 2 / part.length_m
    lanes.add_laneoffset(xodr.LaneOffset(0, first_m / 2, slope))
    lanes.add_lanesection(section)
    made_road = xodr.Road(part.number, view, lanes, part.junction, name=part.lanes[0].edge)
    limits = [lane.speed_limit_mps for lane in part.lanes if not lane.walking]
    known = [limit for limit in limits if math.isfinite(limit)]
    fast = bool(known) and max(known) > FAST_MPS
    kind_of_road = xodr.RoadType.motorway if fast else xodr.RoadType.town
    made_road.add_type(kind_of_road, speed=max(known) if known else None)
    for links, add, point in (
        (part.before, made_road.add_predecessor, xodr.ContactPoint.end),
        (part.after, made_road.add_successor, xodr.ContactPoint.start),
    ):
        if isinstance(links, list):
            add(xodr.ElementType.road, links[0][1], point)
        elif links is not None:
            add(xodr.ElementType.junction, links)
    return made_road


def _junction(number: int, direct: bool, ways: Sequence[tuple[int, int, int, int]]) -> Any:
    """A junction of ways, each from a road and lane onto others."""
    kind = xodr.JunctionType.direct if direct else xodr.JunctionType.default
    made = xodr.Junction(f"junction {number}", number, kind)
    joined: dict[tuple[int, int], Any] = {}
    for begin, lane, onto, to_lane in ways:
        if (begin, onto) not in joined:
            joined[begin, onto] = xodr.Connection(begin, onto, xodr.ContactPoint.start)
        joined[begin, onto].add_lanelink(lane, to_lane)
    for one in joined.values():
        made.add_connection(one)
    return made


def _add_signals(road: Road, roads: _Roads, made: dict[int, Any], signals: list[list[str]]) -> None:
    """A light for each signal group at the end of each road that it controls."""
    controlled: dict[tuple[int, int], list[int]] = {}
    parts = {part.number: part for part in roads.parts}
    for link in road.connections:
        if link.signal >= 0 and link.from_lane in roads.place:
            part, lane = roads.place[link.from_lane]
            controlled.setdefault((part.number, link.signal), []).append(lane)
    for count, ((number, group), lanes) in enumerate(sorted(controlled.items()), start=1):
        part = parts[number]
        light = xodr.Signal(
            s=part.length_m, t=-part.right_m, country="OpenDRIVE", Type=SIGNAL_TYPE, id=str(count),
            name=road.signal_groups[group], dynamic=xodr.Dynamic.yes, zOffset=3.0, height=1.0,
            width=0.4,
        )  # fmt: skip
        light.add_validity(min(lanes), max(lanes))
        made[number].signals.append(light)  # add_signal counts ids over all files of a process
        signals[group].append(str(count))


def _add_crosswalk(roads: _Roads, made: dict[int, Any], crossing: Crossing, number: int) -> None:
    """A crosswalk as an object of the nearest road that it crosses, or of any."""
    begin, end = crossing.centerline[0], crossing.centerline[-1]
    middle, way = (begin + end) / 2, end - begin
    size = float(np.hypot(*way))
    usual = [part for part in roads.parts if part.junction < 0]
    named = [part for part in usual if part.lanes[0].edge in crossing.edges] or usual
    if size <= 0 or not named:
        return
    part = min(named, key=lambda one: float(np.hypot(*(one.line - middle).T).min()))
    (along,), (left,) = _along(part.line, middle[None])
    s = float(np.clip(along, 0.0, part.length_m))
    t = float(np.clip(left, -part.right_m, part.lanes[0].width_m / 2))
    pieces = pieces_of(part.line)
    dx, dy = pieces.direction[max(int(np.searchsorted(pieces.at, s)) - 1, 0)]
    origin = points_at(part.line, np.array([s]))[0] + t * np.array([-dy, dx])
    across = np.array([-way[1], way[0]]) / size * (crossing.width_m / 2)
    outline = xodr.Outline(id=0, closed=True)
    for corner in (begin + across, begin - across, end - across, end + across):
        u, v = np.array([[dx, dy], [-dy, dx]]) @ (corner - origin)
        outline.add_corner(xodr.CornerLocal(float(u), float(v), 0.0, 0.01))
    walk = xodr.Object(
        s, t, xodr.ObjectType.crosswalk, id=str(number + 1), name=crossing.id,
        orientation=xodr.Orientation.none, length=size, width=crossing.width_m, height=0.01,
    )  # fmt: skip
    walk.add_outline(outline)
    made[part.number].objects.append(walk)
