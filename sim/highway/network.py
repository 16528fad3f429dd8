"""Turns a `Road` into highway-env's `RoadNetwork`, and keeps the facts that the latter cannot hold.

Edges that follow one another lane by lane, where no other edge joins or leaves, become one stretch.
Every connection across a junction becomes one lane, a junction path, from the end of a stretch to
the start of another. highway-env counts lanes from the left, `Road` from the right.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from highway_env.road.lane import LineType
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.highway.conflicts import Conflict, find_conflicts
from sim.highway.lanes import LaneIndex, NearLanesNetwork, PolylineLane
from sim.highway.tables import LaneTables
from sim.road import Connection, Lane, Road
from sim.road.cells import boxes_of, near_pairs
from sim.road.lane_graph import LaneGraph
from sim.xml_tree import without_collection

FloatArray = NDArray[np.float64]

STUB_M: Final = 0.1
"""A junction path between lanes that touch is this long, m."""

OPPOSITE_M: Final = 1.2
"""An opposite lane is a neighbour if its centre line is within this many lane widths."""

CELL_M: Final = 50.0
"""Width of the cells in which opposite lanes are looked for, m (half a block)."""


class Strip(NamedTuple):
    """Where a lane runs over a crossing: its number, from where to where, m, and how far along it.

    ``near_s`` and ``far_s`` are distances along the lane, ``u`` is the lane's along the crossing.
    """

    crossing: int
    near_s: float
    far_s: float
    u: float


class LaneInfo(NamedTuple):
    """The facts about a lane that highway-env's network cannot hold.

    Attributes:
        connector: whether it crosses a junction.
        signal: signal group that guards its entry, -1 if none.
        must_yield: whether other vehicles have priority over those that enter it.
        must_stop: whether there is a stop sign before it.
        strips: where it runs over crossings, in order.
        conflicts: with other junction paths, in order of their beginning.
        way: which of the road's connections it is, -1 if none.
    """

    connector: bool = False
    signal: int = -1
    must_yield: bool = False
    must_stop: bool = False
    strips: tuple[Strip, ...] = ()
    conflicts: tuple[Conflict, ...] = ()
    way: int = -1


@dataclass(frozen=True)
class HighwayNetwork:
    """A `Road` in highway-env's terms.

    Attributes:
        road: where it came from.
        net: the highway-env network.
        info: further facts about each lane.
        lanes: every lane by its index (the same objects as in ``net``).
        stretch_of: the stretch, as (from, to), of each edge of ``road``.
        onward: the junction path from a lane to each next stretch.
        exit_of: the lane on which each junction path ends.
        wrong_side: for each leftmost lane beside one of the opposite direction, a lane that runs
            over that one in this direction, for those that overtake on the wrong side.
        edge_at: the edges of each stretch with the distance at which each begins, m.
    """

    road: Road
    net: RoadNetwork
    info: dict[LaneIndex, LaneInfo]
    lanes: dict[LaneIndex, PolylineLane]
    stretch_of: dict[str, tuple[str, str]]
    onward: dict[tuple[LaneIndex, tuple[str, str]], LaneIndex]
    exit_of: dict[LaneIndex, LaneIndex]
    wrong_side: dict[LaneIndex, LaneIndex]
    edge_at: dict[tuple[str, str], tuple[tuple[str, float], ...]] = field(default_factory=dict)

    @cached_property
    def tables(self) -> LaneTables:
        """The lanes as arrays, in that order."""
        return LaneTables(self)

    def stretches(self, route: Sequence[str]) -> list[tuple[str, str]]:
        """The stretches that a route of edges runs over.

        Raises:
            InputError: if an edge is not of this road, two stretches are not connected, or an
                edge follows itself.
        """
        found: list[tuple[str, str]] = []
        reached_m = 0.0
        for edge in route:
            if edge not in self.stretch_of:
                raise InputError(
                    f"route: found edge {edge!r}, expected a drivable edge of {self.road.name!r}"
                )
            stretch = self.stretch_of[edge]
            begin_m = dict(self.edge_at[stretch])[edge]
            if not found or found[-1] != stretch:
                found.append(stretch)
            elif begin_m <= reached_m:
                raise InputError(
                    f"route: found edge {edge!r} again or behind the one before, expected one "
                    "further along"
                )
            reached_m = begin_m
        for one, then in itertools.pairwise(found):
            if not self.lanes_towards(one, then):
                raise InputError(
                    f"route: found no way from {one[1].rstrip('>')!r} to "
                    f"{then[0].rstrip('<')!r} on road {self.road.name!r}, expected a connection"
                )
        return found

    def lanes_towards(
        self, stretch: tuple[str, str], then: tuple[str, str] | None
    ) -> list[LaneIndex]:
        """The lanes of a stretch from which the next stretch can be reached; all if None."""
        every = [(*stretch, i) for i in range(len(self.net.graph[stretch[0]][stretch[1]]))]
        if then is None:
            return every
        return [lane for lane in every if (lane, then) in self.onward]


def _without_rings(follows: dict[str, str]) -> dict[str, str]:
    """The edge that each edge continues as; edges that only follow one another round stay apart."""
    chained = set()
    for edge in follows.keys() - set(follows.values()):
        while edge in follows:
            chained.add(edge)
            edge = follows[edge]
    return {edge: then for edge, then in follows.items() if edge in chained}


@without_collection()  # a city has a million objects, all of which stay
def build_network(road: Road) -> HighwayNetwork:
    """The highway-env network of a road.

    Args:
        road: read from a SUMO net.

    Returns:
        Stretches, junction paths and lanes over those of the opposite direction.

    Raises:
        InputError: if the road has no drivable lane.
    """
    by_id = {lane.id: lane for lane in road.lanes}
    driving: dict[str, list[Lane]] = {}
    for lane in road.lanes:
        if lane.cars and not lane.walking and not lane.internal:
            driving.setdefault(lane.edge, []).append(lane)
    if not driving:
        raise InputError(f"road {road.name!r}: found no drivable lane, expected at least one")
    for lanes in driving.values():
        lanes.sort(key=lambda lane: -lane.index)  # from the left
    numbers = {id(way): i for i, way in enumerate(road.connections)}
    connections = sorted(  # from the left, as lanes are counted
        (c for c in road.connections if c.from_lane in by_id and c.to_lane in by_id),
        key=lambda c: -by_id[c.from_lane].index,
    )
    net = NearLanesNetwork()
    follows = _without_rings(_continuations(driving, connections, by_id))
    placed = _add_stretches(net, driving, connections, follows, by_id)
    joins = [
        c for c in connections if follows.get(by_id[c.from_lane].edge) != by_id[c.to_lane].edge
    ]
    paths, onward, exit_of = _add_junction_paths(net, joins, numbers, by_id, placed.lanes)
    geometry: dict[LaneIndex, PolylineLane] = dict(net.lanes_dict())
    strips = _strips(road, placed.lanes)
    begins = {path: lane for (lane, _), path in onward.items()}
    conflicts = find_conflicts({i: geometry[i] for i in exit_of}, begins)
    info = {
        index: paths.get(index, LaneInfo())._replace(
            strips=tuple(sorted(strips.get(index, ()), key=lambda s: s.near_s)),
            conflicts=tuple(
                conflict._replace(yields=_yields(paths[index].way, paths[conflict.other].way, road))
                for conflict in sorted(conflicts.get(index, ()), key=lambda c: c.begin_s)
            ),
        )
        for index in geometry
    }
    wrong_side = _add_wrong_side_lanes(net, geometry, info, set(placed.stretch_of.values()))
    return HighwayNetwork(
        road=road,
        net=net,
        info=info,
        lanes=geometry,
        stretch_of=placed.stretch_of,
        onward=onward,
        exit_of=exit_of,
        wrong_side=wrong_side,
        edge_at=placed.edge_at,
    )


def _yields(one: int, other: int, road: Road) -> int:
    """1 if a connection gives way to another one, -1 if the other does, 0 if both or neither do."""
    ways = road.connections
    return int(other in ways[one].yields_to) - int(one in ways[other].yields_to)


class _Placed(NamedTuple):
    """Where the lanes and edges of a `Road` lie in highway-env's network.

    Attributes:
        lanes: the lanes of the network that run over each lane of the road, by its id, with the
            distance at which they begin to, m.
        stretch_of: see `HighwayNetwork`.
        edge_at: see `HighwayNetwork`.
    """

    lanes: dict[str, list[tuple[LaneIndex, float]]]
    stretch_of: dict[str, tuple[str, str]]
    edge_at: dict[tuple[str, str], tuple[tuple[str, float], ...]]


def _add_stretches(
    net: RoadNetwork,
    driving: dict[str, list[Lane]],
    connections: list[Connection],
    follows: dict[str, str],
    by_id: dict[str, Lane],
) -> _Placed:
    """Add the lanes of every chain of edges that follow one another."""
    placed = _Placed({}, {}, {})
    begun = set(follows.values())
    leaving: dict[str, list[Connection]] = {}
    for link in connections:
        leaving.setdefault(link.from_lane, []).append(link)
    for edge in driving:
        if edge in begun:
            continue
        chain = [edge]
        while chain[-1] in follows and follows[chain[-1]] not in chain:
            chain.append(follows[chain[-1]])
        key = (f"{chain[0]}<", f"{chain[-1]}>")
        starts: list[tuple[str, float]] = []
        for k, lane in enumerate(driving[edge]):
            pieces, at = [lane], 0.0
            for after in chain[1:]:
                link = next(c for c in leaving[pieces[-1].id] if by_id[c.to_lane].edge == after)
                pieces += [by_id[via] for via in link.via]
                pieces.append(by_id[link.to_lane])
            for piece in pieces:
                placed.lanes.setdefault(piece.id, []).append(((*key, k), at))
                if k == 0 and not piece.internal:
                    starts.append((piece.edge, at))
                at += piece.length_m
            points = np.concatenate([_points(piece) for piece in pieces])
            left = LineType.CONTINUOUS_LINE if k == 0 else LineType.STRIPED
            last = k == len(driving[edge]) - 1
            right = LineType.CONTINUOUS_LINE if last else LineType.NONE
            net.add_lane(
                *key, PolylineLane(points, lane.width_m, (left, right), lane.speed_limit_mps)
            )
        placed.edge_at[key] = tuple(starts)
        for one in chain:
            placed.stretch_of[one] = key
    return placed


def _add_junction_paths(
    net: RoadNetwork,
    connections: list[Connection],
    numbers: dict[int, int],
    by_id: dict[str, Lane],
    places: dict[str, list[tuple[LaneIndex, float]]],
) -> tuple[
    dict[LaneIndex, LaneInfo], dict[tuple[LaneIndex, tuple[str, str]], LaneIndex],
    dict[LaneIndex, LaneIndex],
]:  # fmt: skip
    """Add a lane for every connection; returns their info, ``onward`` and ``exit_of``."""
    info: dict[LaneIndex, LaneInfo] = {}
    onward: dict[tuple[LaneIndex, tuple[str, str]], LaneIndex] = {}
    exit_of: dict[LaneIndex, LaneIndex] = {}
    for link in connections:
        if link.from_lane not in places or link.to_lane not in places:
            continue  # a lane that cars may not use
        begin, end = by_id[link.from_lane], by_id[link.to_lane]
        from_index, to_index = places[begin.id][0][0], places[end.id][0][0]
        if (from_index, to_index[:2]) in onward:
            continue  # the same stretch is reached already, on a lane beside
        inner = [by_id[via] for via in link.via]
        points = (
            np.concatenate([_points(piece) for piece in inner])
            if inner
            else np.stack([_points(begin)[-1], _points(end)[0]])
        )
        if np.hypot(*(points - points[0]).T).max() < STUB_M:
            points = _stub(points[0], _points(begin))
        key = (from_index[1], to_index[0])
        index = (*key, len(net.graph.get(key[0], {}).get(key[1], [])))
        limit = min((p.speed_limit_mps for p in inner), default=end.speed_limit_mps)
        net.add_lane(*key, PolylineLane(points, begin.width_m, speed_limit=limit))
        at = 0.0
        for piece in inner:
            places.setdefault(piece.id, []).append((index, at))
            at += piece.length_m
        onward[from_index, to_index[:2]] = index
        exit_of[index] = to_index
        info[index] = LaneInfo(
            connector=True,
            signal=link.signal,
            must_yield=link.must_yield,
            must_stop=link.must_stop,
            way=numbers[id(link)],
        )
    return info, onward, exit_of


def _stub(at: FloatArray, before: FloatArray) -> FloatArray:
    """A short path from a point, in the direction in which the lane before it ends."""
    step = before[-1] - before[max(np.flatnonzero((before != before[-1]).any(axis=1)), default=0)]
    size = float(np.hypot(*step))
    return np.stack([at, at + STUB_M * (step / size if size > 0 else np.array([1.0, 0.0]))])


def _points(lane: Lane) -> FloatArray:
    return np.asarray(lane.centerline * np.array([1.0, -1.0]), dtype=np.float64)


def _continuations(
    driving: dict[str, list[Lane]], connections: list[Connection], by_id: dict[str, Lane]
) -> dict[str, str]:
    """The one edge that follows an edge lane by lane, where nothing else leaves or joins."""
    out: dict[str, list[Connection]] = {}
    into: dict[str, set[str]] = {}
    for link in connections:
        begin, end = by_id[link.from_lane].edge, by_id[link.to_lane].edge
        out.setdefault(begin, []).append(link)
        into.setdefault(end, set()).add(begin)
    found = {}
    for edge, links in out.items():
        ends = {by_id[link.to_lane].edge for link in links}
        (end, *others) = ends
        if others or edge not in driving or end not in driving:  # or where cars may not drive
            continue
        begins, goals = [c.from_lane for c in links], [c.to_lane for c in links]
        whole = sorted(begins) == sorted(lane.id for lane in driving[edge]) and sorted(
            goals
        ) == sorted(lane.id for lane in driving[end])
        free = all(c.signal < 0 and not c.must_stop and c.direction == "straight" for c in links)
        if whole and free and into[end] == {edge}:
            found[edge] = end
    return found


def _strips(
    road: Road, places: dict[str, list[tuple[LaneIndex, float]]]
) -> dict[LaneIndex, list[Strip]]:
    graph = LaneGraph.of(road)
    found: dict[LaneIndex, list[Strip]] = {}
    for z in range(graph.cross_lane.size):
        for index, at in places.get(road.lanes[int(graph.cross_lane[z])].id, ()):
            found.setdefault(index, []).append(
                Strip(
                    crossing=int(graph.cross_id[z]),
                    near_s=at + float(graph.cross_s[z]),
                    far_s=at + float(graph.cross_exit_s[z]),
                    u=float(graph.cross_u[z]),
                )
            )
    return found


def _add_wrong_side_lanes(
    net: RoadNetwork,
    lanes: dict[LaneIndex, PolylineLane],
    info: dict[LaneIndex, LaneInfo],
    stretches: set[tuple[str, str]],
) -> dict[LaneIndex, LaneIndex]:
    """Add a lane over the nearest lane of the opposite direction beside each stretch."""
    wrong_side: dict[LaneIndex, LaneIndex] = {}
    ordered = sorted(stretches)
    leftmost = [lanes[(*stretch, 0)] for stretch in ordered]
    middles = [lane.position(lane.length / 2, 0.0) for lane in leftmost]
    reach_m = OPPOSITE_M * max(lane.width for lane in leftmost)
    lines = [lane.points for lane in leftmost]
    pairs = near_pairs(
        boxes_of([middle[None] for middle in middles], reach_m), boxes_of(lines, 0.0), CELL_M
    )
    for one, others in itertools.groupby(pairs.tolist(), key=lambda pair: pair[0]):
        stretch, lane, middle = ordered[one], leftmost[one], middles[one]
        left = (*stretch, 0)
        for _, number in others:
            opposite = leftmost[number]
            if number == one or abs(opposite.length - lane.length) > 1.0:
                continue
            s, across = opposite.local_coordinates(middle)
            facing = np.cos(opposite.heading_at(s) - lane.heading_at(lane.length / 2))
            inside = 0.0 < s < opposite.length
            if facing < -0.99 and inside and abs(across) < OPPOSITE_M * lane.width:
                key = (f"~{stretch[0]}", f"~{stretch[1]}")
                made = PolylineLane(
                    lines[number][::-1], opposite.width,
                    speed_limit=opposite.speed_limit, forbidden=True,
                )  # fmt: skip
                net.add_lane(*key, made)
                index = (*key, 0)
                lanes[index], info[index], wrong_side[left] = made, LaneInfo(), index
                break
    return wrong_side
