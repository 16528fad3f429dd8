"""Turns a `Road` into a road network of highway-env, with arrays for all that it cannot hold.

Edges that follow one another lane by lane, where no other edge joins or leaves, become one stretch.
Every connection across a junction becomes one lane, a junction path, from the end of a stretch to
the start of another. highway-env counts lanes from the left, `Road` from the right.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork
from scipy.sparse import lil_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from behaviors.errors import InputError
from sim.frames import FloatArray, IntArray
from sim.highway import state
from sim.highway.lanes import LaneIndex, PolylineLane, Stretch
from sim.highway.places import closest_lane
from sim.highway.state import Net, Records, listed
from sim.input_files import without_collection
from sim.road import Connection, Lane, Road
from sim.road.cells import Cells, boxes_of, cells_of, near_pairs
from sim.road.lane_graph import LaneGraph

STUB_M, TIGHT_M = 0.1, 5.0
"""A junction path between lanes that touch is this long. A path of a smaller mean radius is tight
(a car's turning circle)."""

CELL_M, ROUNDING_M = 50.0, 1e-3
"""Width of the cells in which lanes are looked for (`BEHIND_M` and a lane). Lanes are searched this
much farther from vehicles than they can be."""

OPPOSITE_M, SAME_SPOT_M = 1.2, 0.5
"""An opposite lane is a neighbour if its centre line is within this many lane widths. Lanes that
run over a crossing nearer to each other than this, m, do so at the same spot."""

SAMPLE_M, HALF_CAR_M = 0.5, 2.3
"""Junction paths are compared at points this far apart to find where they conflict. In a bend a
car's corners swing out by half its length squared over the radius."""

CONFLICT_M, WIDEST_M = 2.2, 3.0
"""Junction paths nearer than this conflict (a car's width and a little). Paths farther apart than
this do not, however far cars swing out (side by side)."""


@dataclass(eq=False)
class HighwayNetwork(RoadNetwork):  # type: ignore[misc]
    """A `Road` in highway-env's terms; `build_network` makes it, and nothing changes it then."""

    road: Road
    graph: dict[str, dict[str, list[PolylineLane]]] = field(default_factory=dict)  # highway-env's
    lanes: dict[LaneIndex, PolylineLane] = field(default_factory=dict)
    # the path from a lane to each next stretch; each path's connection, and the lane where it ends
    onward: dict[tuple[LaneIndex, Stretch], LaneIndex] = field(default_factory=dict)
    links: dict[LaneIndex, Connection] = field(default_factory=dict)
    exit_of: dict[LaneIndex, LaneIndex] = field(default_factory=dict)
    # the stretch of each edge, and the lanes over each lane of the road; where they begin on it, m
    edges: dict[str, tuple[Stretch, float]] = field(default_factory=dict)
    placed: dict[str, list[tuple[LaneIndex, float]]] = field(default_factory=dict)
    arrays: Net = field(init=False)

    @cached_property
    def keys(self) -> list[LaneIndex]:
        """The lanes in the order of their numbers."""
        return list(self.lanes)

    @cached_property
    def number(self) -> dict[LaneIndex, int]:
        """The number of each lane."""
        return {key: k for k, key in enumerate(self.lanes)}

    @cached_property
    def stretch_number(self) -> dict[Stretch, int]:
        """The number of each stretch and of the junction paths between any two of them."""
        return {one: i for i, one in enumerate(dict.fromkeys(key[:2] for key in self.lanes))}

    def get_closest_lane_index(
        self, position: FloatArray, heading: float | None = None
    ) -> LaneIndex:
        """The lane closest to a place, m, for a heading, rad; of equal ones the first."""
        (x, y), turned = position, math.nan if heading is None else float(heading)
        return self.keys[closest_lane(float(x), float(y), turned, self.arrays)]

    def strips_of(self, lane: LaneIndex) -> Records:
        """The rows of `STRIP` of a lane."""
        row = self.arrays.lanes[self.number[lane]]
        strips: Records = self.arrays.strips[row.strip : row.strip_end]
        return strips

    def stretches(self, route: Sequence[str]) -> list[Stretch]:
        """The stretches that a route of edges runs over; an `InputError` if there are none."""
        found: list[Stretch] = []
        reached_m = 0.0
        for edge in route:
            if edge not in self.edges:
                raise InputError(
                    f"route: found edge {edge!r}, expected a drivable edge of {self.road.name!r}"
                )
            stretch, begin_m = self.edges[edge]
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

    def onward_lane(self, lane: LaneIndex, way: tuple[Stretch, ...]) -> LaneIndex | None:
        """The lane that follows on a way over stretches; None at its end or on a wrong lane."""
        if lane in self.exit_of:
            return self.exit_of[lane]
        after = way[way.index(lane[:2]) + 1 :] if lane[:2] in way else ()
        return self.onward.get((lane, after[0])) if after else None

    def way_to(self, goal: Stretch, lane: int) -> tuple[Stretch, ...] | None:
        """The shortest way from a lane to a stretch, or else to the nearest where the road ends.

        It has the stretches after the lane's own, which it does not use again, nor the lanes beside
        it; None if the lane leads nowhere. On a road that never ends it is the way to the farthest.
        """
        lanes, then = self.arrays.lanes, self.arrays.ways["stretch"]
        stretch, names = lanes["stretch"], list(self.stretch_number)
        n, here = len(names), int(stretch[lane])
        begin = np.repeat(np.arange(lanes.size), lanes["way_end"] - lanes["way"])
        length = np.ones(n)
        length[stretch[::-1]] = lanes["length"][::-1]  # of each one's first lane
        used = (then != here) & ((stretch[begin] != here) | (begin == lane))
        graph = lil_array((n, n))
        graph[stretch[begin[used]], then[used]] = length[then[used]]
        found, ways = dijkstra(graph.tocsr(), indices=[here], return_predecessors=True)
        away, before = found[0], ways[0]
        away[here] = np.inf
        reached, end = np.isfinite(away), self.stretch_number[goal]
        if not reached.any():
            return None
        if not reached[end]:
            ends = reached & ~np.isin(np.arange(n), stretch[begin])
            away[~(ends if ends.any() else reached)] = np.nan
            end = int(np.nanargmin(away) if ends.any() else np.nanargmax(away))
        way = []
        while end != here:
            way.append(names[end])
            end = int(before[end])
        return tuple(way[::-1])

    def lanes_towards(self, stretch: Stretch, then: Stretch | None) -> list[LaneIndex]:
        """The lanes of a stretch from which the next stretch can be reached; all if None."""
        every = [(*stretch, i) for i in range(len(self.graph[stretch[0]][stretch[1]]))]
        if then is None:
            return every
        return [lane for lane in every if (lane, then) in self.onward]


@without_collection()  # a city has a million objects, all of which stay
def build_network(road: Road) -> HighwayNetwork:
    """The highway-env network of a road; an `InputError` if it has no drivable lane."""
    by_id = {lane.id: lane for lane in road.lanes}
    driving: dict[str, list[Lane]] = {}
    for lane in road.lanes:
        if lane.cars and not lane.walking and not lane.internal:
            driving.setdefault(lane.edge, []).append(lane)
    if not driving:
        raise InputError(f"road {road.name!r}: found no drivable lane, expected at least one")
    for lanes in driving.values():
        lanes.sort(key=lambda lane: -lane.index)  # from the left
    connections = sorted(  # from the left, as lanes are counted
        (c for c in road.connections if c.from_lane in by_id and c.to_lane in by_id),
        key=lambda c: -by_id[c.from_lane].index,
    )
    follows = _continuations(driving, connections, by_id)
    joins = [
        c for c in connections if follows.get(by_id[c.from_lane].edge) != by_id[c.to_lane].edge
    ]
    made = HighwayNetwork(road)
    _add_stretches(made, driving, connections, follows, by_id)
    _add_junction_paths(made, joins, by_id)
    made.lanes.update(made.lanes_dict())
    made.arrays = _arrays(made, _add_wrong_side_lanes(made))
    return made


def _add_stretches(
    made: HighwayNetwork,
    driving: dict[str, list[Lane]],
    connections: list[Connection],
    follows: dict[str, str],
    by_id: dict[str, Lane],
) -> None:
    """Add the lanes of every chain of edges that follow one another."""
    link_of = {(link.from_lane, by_id[link.to_lane].edge): link for link in connections[::-1]}
    begun = set(follows.values())
    for edge in [edge for edge in driving if edge not in begun]:
        chain = [edge]
        while chain[-1] in follows:
            chain.append(follows[chain[-1]])
        key = (f"{chain[0]}<", f"{chain[-1]}>")
        for k, lane in enumerate(driving[edge]):
            pieces, at = [lane], 0.0
            for after in chain[1:]:
                link = link_of[pieces[-1].id, after]
                pieces += [by_id[via] for via in (*link.via, link.to_lane)]
            for piece in pieces:
                made.placed.setdefault(piece.id, []).append(((*key, k), at))
                if k == 0 and not piece.internal:
                    made.edges[piece.edge] = key, at
                at += piece.length_m
            points = np.concatenate([_points(piece) for piece in pieces])
            made.add_lane(*key, PolylineLane(points, lane.width_m, lane.speed_limit_mps))


def _add_junction_paths(
    made: HighwayNetwork, connections: list[Connection], by_id: dict[str, Lane]
) -> None:
    """Add a lane for every connection of lanes that cars may use."""
    placed = made.placed
    for link in connections:
        if link.from_lane not in placed or link.to_lane not in placed:
            continue
        begin, end = by_id[link.from_lane], by_id[link.to_lane]
        before, after = placed[begin.id][0][0], placed[end.id][0][0]
        if (before, after[:2]) in made.onward:
            continue  # the same stretch is reached already, on a lane beside
        inner = [by_id[via] for via in link.via]
        lines = [_points(piece) for piece in inner]
        points = np.concatenate(lines or [_points(begin)[-1:], _points(end)[:1]])
        if np.hypot(*(points - points[0]).T).max() < STUB_M:
            points = _stub(points[0], _points(begin))
        key = (before[1], after[0])
        path = (*key, len(made.graph.get(key[0], {}).get(key[1], [])))
        limit = min((p.speed_limit_mps for p in inner), default=end.speed_limit_mps)
        made.add_lane(*key, PolylineLane(points, begin.width_m, limit))
        at = 0.0
        for piece in inner:
            placed.setdefault(piece.id, []).append((path, at))
            at += piece.length_m
        made.onward[before, after[:2]] = path
        made.exit_of[path], made.links[path] = after, link


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
    """The one edge that follows an edge lane by lane, where nothing else leaves or joins.

    Edges that only follow one another round stay apart.
    """
    out: dict[str, list[Connection]] = {}
    into: dict[str, set[str]] = {}
    for link in connections:
        begin, end = by_id[link.from_lane].edge, by_id[link.to_lane].edge
        out.setdefault(begin, []).append(link)
        into.setdefault(end, set()).add(begin)
    follows = {}
    for edge, links in out.items():
        (end, *others) = {by_id[link.to_lane].edge for link in links}
        if others or edge not in driving or end not in driving or into[end] != {edge}:
            continue
        ends = sorted(c.from_lane for c in links), sorted(c.to_lane for c in links)
        whole = ends == tuple(sorted(lane.id for lane in driving[each]) for each in (edge, end))
        if whole and all(
            c.signal < 0 and not c.must_stop and c.direction == "straight" for c in links
        ):
            follows[edge] = end
    chained = set()
    for edge in follows.keys() - set(follows.values()):
        while edge in follows:
            chained.add(edge)
            edge = follows[edge]
    return {edge: then for edge, then in follows.items() if edge in chained}


def _add_wrong_side_lanes(made: HighwayNetwork) -> dict[LaneIndex, LaneIndex]:
    """Add lanes over the nearest opposite one beside each stretch; these by its leftmost lane."""
    found: dict[LaneIndex, LaneIndex] = {}
    ordered = sorted({stretch for stretch, _ in made.edges.values()})
    leftmost = [made.lanes[(*stretch, 0)] for stretch in ordered]
    middles = [lane.position(lane.length / 2, 0.0) for lane in leftmost]
    reach_m = OPPOSITE_M * max(lane.width for lane in leftmost)
    near = boxes_of([middle[None] for middle in middles], reach_m)
    boxes = boxes_of([lane.points for lane in leftmost], 0.0)
    for one, other in near_pairs(near, boxes, CELL_M).tolist():
        stretch, lane, opposite = ordered[one], leftmost[one], leftmost[other]
        left = (*stretch, 0)
        if left in found or other == one or abs(opposite.length - lane.length) > 1.0:
            continue
        s, across = opposite.local_coordinates(middles[one])
        facing = np.cos(opposite.heading_at(s) - lane.heading_at(lane.length / 2))
        inside = 0.0 < s < opposite.length
        if facing < -0.99 and inside and abs(across) < OPPOSITE_M * lane.width:
            key, points = (f"~{stretch[0]}", f"~{stretch[1]}", 0), opposite.points[::-1]
            made.lanes[key] = PolylineLane(points, opposite.width, opposite.speed_limit, True)
            made.add_lane(*key[:2], made.lanes[key])
            found[left] = key
    return found


def _arrays(made: HighwayNetwork, wrong_side: dict[LaneIndex, LaneIndex]) -> Net:
    """The arrays of a network; ``wrong_side`` has the lanes over opposite ones."""
    keys, number, objects = made.keys, made.number, list(made.lanes.values())
    lanes = np.zeros(len(keys), state.LANE)
    for name, of in (("length", "length"), ("limit", "speed_limit"), ("width", "width")):
        lanes[name] = [getattr(lane, of) for lane in objects]
    for name in ("signal", "entry", "exit", "opposite", "own"):
        lanes[name] = -1
    ways: list[list[tuple[int, int]]] = [[] for _ in keys]
    for (lane, then), path in made.onward.items():
        row, link = lanes[number[path]], made.links[path]
        row.connector, row.signal = True, link.signal
        row.must_yield, row.must_stop = link.must_yield, link.must_stop
        row.entry, row.exit = number[lane], number[made.exit_of[path]]
        ways[number[lane]].append((made.stretch_number[then], number[path]))
    for lane, wrong in wrong_side.items():
        lanes["opposite"][number[lane]], lanes["own"][number[wrong]] = number[wrong], number[lane]
    turned = [lane.turns["heading"][-1] - lane.turns["heading"][0] for lane in objects]
    lanes["tight"] = lanes["length"] < TIGHT_M * np.abs(turned)
    lanes["wrong"] = lanes["own"] >= 0
    margin = np.where(lanes["connector"], state.PATH_MARGIN_M, state.STRETCH_MARGIN_M)
    lanes["margin"] = lanes["width"] / 2 + margin
    lanes["behind"] = np.where(lanes["connector"], 0.0, state.BEHIND_M)
    for name, step in (("left", -1), ("right", 1)):
        beside = [number.get((*key[:2], key[2] + step), -1) for key in keys]
        lanes[name] = np.where(lanes["connector"] | lanes["wrong"], -1, beside)
    lanes["stretch"] = [made.stretch_number[key[:2]] for key in keys]
    crossings, spots, strips = _crossings(made)
    return Net(
        lanes=lanes,
        pieces=listed(lanes, "piece", [lane.pieces for lane in objects], state.PIECE),
        turns=listed(lanes, "turn", [lane.turns for lane in objects], state.TURN),
        ways=listed(lanes, "way", ways, state.WAY),
        conflicts=listed(lanes, "conflict", _conflicts(made, lanes["entry"]), state.CONFLICT),
        strips=listed(lanes, "strip", strips, state.STRIP),
        crossings=crossings,
        spots=spots,
        cells=_cells([lane.points for lane in objects], lanes),
        has_paths=bool(made.links),
        has_wrong=bool(wrong_side),
    )


def _conflicts(made: HighwayNetwork, entry: IntArray) -> list[list[tuple[Any, ...]]]:
    """The rows of `CONFLICT` of each lane; paths that begin on the same lane have none."""
    rows: list[list[tuple[Any, ...]]] = [[] for _ in made.lanes]
    place = {id(way): i for i, way in enumerate(made.road.connections)}
    ways, numbers = list(made.links.values()), [made.number[key] for key in made.links]
    paths = [made.lanes[key] for key in made.links]
    at = [np.linspace(0.0, p.length, max(int(p.length / SAMPLE_M), 1) + 1) for p in paths]
    xy = [path.position(s, 0.0) for path, s in zip(paths, at, strict=True)]
    boxes, swing = boxes_of(xy, WIDEST_M / 2), [_swing(each) for each in xy]
    for a, b in near_pairs(boxes, boxes, CELL_M).tolist():
        if a >= b or entry[numbers[a]] == entry[numbers[b]]:
            continue
        reach = np.minimum(CONFLICT_M + swing[a][:, None] + swing[b], WIDEST_M)
        close = cdist(xy[a], xy[b]) < reach
        if close.any():
            yields = place[id(ways[b])] in ways[a].yields_to
            yielded = place[id(ways[a])] in ways[b].yields_to
            span, other = (
                s[np.flatnonzero(close.any(axis=1 - k))[[0, -1]]].tolist()
                for k, s in enumerate((at[a], at[b]))
            )
            rows[numbers[a]].append((numbers[b], yields - yielded, *span, *other))
            rows[numbers[b]].append((numbers[a], yielded - yields, *other, *span))
    return [sorted(each, key=lambda row: row[2]) for each in rows]


def _crossings(made: HighwayNetwork) -> tuple[Records, Records, list[list[Any]]]:
    """The crossings, their spots, and the rows of `STRIP` of each lane, by their beginning."""
    strips: list[list[Any]] = [[] for _ in made.lanes]
    graph = LaneGraph.of(made.road)
    spans = (graph.cross_lane, graph.cross_id, graph.cross_s, graph.cross_exit_s, graph.cross_u)
    for lane, crossing, near, far, u in zip(*(each.tolist() for each in spans), strict=True):
        for key, at in made.placed.get(made.road.lanes[lane].id, ()):
            strips[made.number[key]].append((crossing, -1, at + near, at + far, u))
    found: list[list[tuple[float, float]]] = [[] for _ in made.road.crossings]
    for rows, lane in zip(strips, made.lanes.values(), strict=True):
        rows.sort(key=lambda row: row[2])
        for crossing, _, _, _, u in rows:
            if all(abs(u - other) >= SAME_SPOT_M for other, _ in found[crossing]):
                found[crossing].append((u, lane.width / 2))
    crossings = np.zeros(len(found), state.CROSSING)
    crossings["signal"] = [one.signal for one in made.road.crossings]
    crossings["priority"] = [one.priority for one in made.road.crossings]
    spots = listed(crossings, "spot", [sorted(places) for places in found], state.SPOT)
    for rows in strips:
        for r, (crossing, _, *span, u) in enumerate(rows):
            first, end = crossings["spot"][crossing], crossings["spot_end"][crossing]
            near = np.abs(spots["u"][first:end] - u) < SAME_SPOT_M
            rows[r] = (crossing, first + int(np.argmax(near)), *span, u)
    return crossings, spots, strips


def _cells(lines: list[FloatArray], lanes: Records) -> Cells:
    """The lanes by the places at which a vehicle may be on them."""
    reached = []
    for line, behind in zip(lines, lanes["behind"], strict=True):
        first, last = line[1] - line[0], line[-1] - line[-2]
        back = line[0] - behind * first / np.hypot(*first)
        ahead = line[-1] + state.LONGEST_M / 2 * last / np.hypot(*last)
        reached.append(np.concatenate([line, [back, ahead]]))
    boxes = boxes_of(reached, ROUNDING_M)
    boxes[:, :2] -= lanes["margin"][:, None]
    boxes[:, 2:] += lanes["margin"][:, None]
    return cells_of(boxes, np.arange(len(lines)), CELL_M)


def _swing(xy: FloatArray) -> FloatArray:
    """How far a car swings out of a path at each of its points (n, 2), (n,) m."""
    step = np.diff(xy, axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))))
    per_m = np.concatenate([[0.0], turn / np.maximum(np.hypot(*step[1:].T), 1e-9), [0.0]])
    return HALF_CAR_M**2 * per_m
