"""Paths that lead on from lanes, the stop constraints along them, and priority at junctions.

Movements are compared only where their lanes come near each other, so the cost grows with the
number of lanes and not with its square.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from sim.geometry import meeting
from sim.road import Road
from sim.road.cells import boxes_of, members, near_pairs
from sim.road.lane_graph import CELL_M, DIRECTIONS, NEAR_M, LaneGraph


@dataclass(frozen=True, slots=True, eq=False)
class Priority:
    """The yielding places of a road, and the lanes of those that have priority there.

    Attributes:
        lane: (Y,) lane on which others have priority.
        entry: (Y,) whether it is where a junction is entered.
        foe_first: (L + 1,) where the conflicts of each lane with priority begin in the next two.
        foe_place: (F,) yielding place that each conflict belongs to.
        foe_s: (F,) distance along the lane with priority at which the two movements cross, m.
    """

    lane: IntArray
    entry: BoolArray
    foe_first: IntArray
    foe_place: IntArray
    foe_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Movements:
    """The junction lanes: where each comes from and leads to, how it turns, whether it yields."""

    lane: IntArray
    origin: IntArray
    target: IntArray
    direction: IntArray
    yields: BoolArray
    entry: BoolArray


def priority_of(road: Road, graph: LaneGraph) -> Priority:
    """Find the yielding places of a road.

    At signals turning vehicles yield; at other junctions the road defines priority. A movement has
    priority over a yielding one if it does not yield itself, or turns right where the other turns
    left.
    """
    moves = _movements(road)
    places = np.flatnonzero(moves.yields)
    place, other = _may_conflict(road, moves, places)
    one = places[place]
    right, left = DIRECTIONS.index("right"), DIRECTIONS.index("left")
    first = ~moves.yields[other]
    first |= (moves.direction[other] == right) & (moves.direction[one] == left)
    keep = first & (moves.origin[other] != moves.origin[one])
    place, other, one = place[keep], other[keep], one[keep]
    lines = [road.lanes[i].centerline for i in moves.lane.tolist()]
    met = [meeting(lines[i], lines[j]) for i, j in zip(one.tolist(), other.tolist(), strict=True)]
    at = np.array([np.nan if each is None else each.along_other for each in met])
    merges = np.isnan(at) & (moves.target[other] == moves.target[one])
    at[merges] = graph.length[moves.lane[other[merges]]]
    meets = ~np.isnan(at)
    foe, place, at = moves.lane[other[meets]], place[meets], at[meets]
    order = np.argsort(foe, kind="stable")
    return Priority(
        lane=moves.lane[places],
        entry=moves.entry[places],
        foe_first=np.searchsorted(foe[order], np.arange(len(road.lanes) + 1)),
        foe_place=place[order],
        foe_s=at[order],
    )


def _movements(road: Road) -> _Movements:
    index = road.lane_index
    ways: dict[int, tuple[int, int, int, int, bool]] = {}
    entries: list[int] = []
    for connection in road.connections:
        via = [index[v] for v in connection.via if v in index]
        if not via or connection.from_lane not in index or connection.to_lane not in index:
            continue
        entries.append(via[0])
        signalled = connection.signal >= 0
        yields = connection.direction != "straight" if signalled else connection.must_yield
        way = index[connection.from_lane], index[connection.to_lane]
        direction = DIRECTIONS.index(connection.direction)
        ways |= {lane: (lane, *way, direction, yields) for lane in via}
    table = np.array(list(ways.values()), dtype=np.int64).reshape(-1, 5).T
    yields, entry = table[4].astype(np.bool_), np.isin(table[0], entries)
    return _Movements(table[0], table[1], table[2], table[3], yields, entry)


def _may_conflict(road: Road, moves: _Movements, places: IntArray) -> tuple[IntArray, IntArray]:
    """Yielding places and movements that come near them or end on the same lane, in order."""
    boxes = boxes_of([road.lanes[i].centerline for i in moves.lane.tolist()], NEAR_M)
    near = near_pairs(boxes[places], boxes, CELL_M)
    by_target = np.argsort(moves.target, kind="stable")
    ordered = moves.target[by_target]
    begin = np.searchsorted(ordered, moves.target[places])
    count = np.searchsorted(ordered, moves.target[places], side="right") - begin
    place, number = members(begin, count)
    same = by_target[number]
    most = max(moves.lane.size, 1)
    pairs = np.unique(
        np.concatenate([near[:, 0] * most + near[:, 1], place * most + same]).astype(np.int64)
    )
    return pairs // most, pairs % most


REACH_M: Final = 150.0
"""Paths continue at least this far beyond their first lane, unless more is asked for (5 s at 30
m/s)."""

MOST_LANES: Final = 10
"""Lanes per path and `REACH_M` at most."""

MOST_PATHS: Final = 200
"""Paths per lane at most, straight ones first (a maze has any number)."""

PRIOR: Final = (0.5, 0.2, 0.25, 0.05)
"""Probability of going straight, right, left or back where all are open (a third to a half of urban
junction traffic turns)."""

UNKNOWN_LIMIT_MPS: Final = 50.0 / 3.6
"""Speed limit assumed where none is known (the usual one in towns)."""

STOP_LINE_REACH_M: Final = 8.0
"""Vehicles wait at the stop line for a crossing this close behind it (the depth of a crosswalk and
its set-back)."""


class PathColumns(NamedTuple):
    """The columns of a `PathTable` that compiled functions read, as one argument; see there."""

    lane: IntArray
    start: FloatArray
    limit: FloatArray
    stop_x: FloatArray
    stop_row: IntArray
    lane_length: FloatArray
    kinds: IntArray


@functools.lru_cache(maxsize=32)
def limits_known(graph: LaneGraph) -> bool:
    """Whether the speed limit of every lane for vehicles is known."""
    return not np.isnan(graph.limit[graph.drivable]).any()


@functools.lru_cache(maxsize=32)
def limits(graph: LaneGraph) -> FloatArray:
    """(L,) speed limits, m/s; `UNKNOWN_LIMIT_MPS` where none is known."""
    return np.where(np.isnan(graph.limit), UNKNOWN_LIMIT_MPS, graph.limit)


class PathTable:
    """The paths of a road; those of a lane are worked out when somebody comes near it.

    Rows are paths, in the order in which they were needed; those of one lane follow each other.
    Lanes and stop constraints are padded at the end. A row never changes once it is there; arrays
    are replaced by larger ones. Paths continue ``reach_m`` beyond their first lane.

    Attributes:
        lane: (Q, P) lanes in order, -1 after the end.
        start: (Q, P) distance from the start of the first lane at which each begins, m; +inf after.
        limit: (Q, P) speed limit, m/s.
        probability: (Q,) of taking this path from its first lane.
        turn: (Q,) code into ``lane_graph.DIRECTIONS`` of the first turn on it, 0 if none.
        stop_x: (Q, G) distances of the stop constraints along it, m; +inf after the last.
        stop_row: (Q, G) their rows among the scene's ``stop_state``: signal groups first, then the
            places where lanes and crossings meet, then yielding places.
        first: (L,) first path of each lane.
        options: (L,) how many paths each lane has; 0 where they have not been needed yet.
        groups: number of signal groups.
        kinds: (2,) where signal groups, and where crossings, end among the rows of ``stop_state``.
        priority: the yielding places; drivers slow down where a junction is entered.
        beside: (2, L) lanes to the left and to the right of each, -1: none.
        lane_spacing: (2, L) distance between the two centre lines, m.
        by_turn: (L, D) likeliest path from each lane that turns each way, -1: none.
        likeliest: (L,) likeliest path from each lane, 0 where there is none.
        lane_length: (L,) m.
    """

    def __init__(self, road: Road, reach_m: float = REACH_M) -> None:
        graph = LaneGraph.of(road)
        lanes = graph.length.size
        self.road, self._graph, self._reach_m = road, graph, reach_m
        self._onward = [[i for i in row if i >= 0] for row in graph.successors.tolist()]
        self.groups = len(road.signal_groups)
        self.kinds = np.array([self.groups, self.groups + graph.cross_lane.size])
        self.priority = priority_of(road, graph)
        self._yield_row = np.full(lanes, -1)
        self._yield_row[self.priority.lane] = self.kinds[1] + np.arange(self.priority.lane.size)
        prior = np.asarray(PRIOR)[graph.direction]
        self._prior = prior, _together(graph, prior)
        self.first, self.options = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
        self.lane, self.start = np.full((0, 1), -1), np.full((0, 1), np.inf)
        self.limit, self.probability = np.zeros((0, 1)), np.ones(0)
        self.turn = np.zeros(0, np.int64)
        self.stop_x, self.stop_row = np.full((0, 1), np.inf), np.zeros((0, 1), np.int64)
        self.beside = np.stack([graph.left, graph.right])
        self.lane_spacing = (graph.width[None] + graph.width[np.maximum(self.beside, 0)]) / 2
        self.by_turn = np.full((lanes, len(DIRECTIONS)), -1)
        self.likeliest = np.zeros(lanes, np.int64)
        self.lane_length = graph.length
        self.cover(np.flatnonzero(graph.drivable)[:1])  # padding and agents off the road name row 0

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road, reach_m: float = REACH_M) -> PathTable:
        """The paths of a road, kept with what has been worked out of them."""
        return PathTable(road, reach_m)

    @property
    def columns(self) -> PathColumns:
        """The columns that compiled functions read."""
        return PathColumns(*(getattr(self, name) for name in PathColumns._fields))

    def cover(self, lane: IntArray) -> None:
        """Work out the paths of lanes (n,) and of those beside them, where they are missing."""
        lane = lane[lane >= 0]
        near = np.unique([lane, *self.beside[:, lane]])
        near = near[near >= 0]
        near = near[(self.options[near] == 0) & self._graph.drivable[near]]
        if near.size:
            self._add(near)

    def options_of(self, lane: IntArray) -> tuple[IntArray, IntArray]:
        """All paths of lanes (n,): (m,) which of these lanes each is of, and (m,) the paths."""
        return members(self.first[lane], self.options[lane])

    def along(self, path: IntArray, x: FloatArray) -> tuple[IntArray, FloatArray]:
        """(n, H) lanes and distances along them, m, of distances x (n, H) along paths (n,)."""
        start = self.start[path]
        on = np.maximum((start[:, None] <= x[..., None]).sum(axis=2) - 1, 0)
        lane = np.take_along_axis(self.lane[path], on, axis=1)
        return lane, x - np.take_along_axis(start, on, axis=1)

    def _add(self, lanes: IntArray) -> None:
        """Append the paths of some lanes."""
        graph, count = self._graph, len(self.lane)
        found = [self._chains(lane) for lane in lanes.tolist()]
        options = np.array([len(chains) for chains in found])
        self.options[lanes], self.first[lanes] = options, count + np.cumsum(options) - options
        lane = _padded([chain for chains in found for chain in chains], -1)
        there = lane >= 0
        length = np.where(there, graph.length[lane], 0.0)
        start = np.where(there, np.cumsum(length, axis=1) - length, np.inf)
        (prior, together), after = self._prior, lane[:, 1:]
        share = np.where(after >= 0, prior[after] / together[lane[:, :-1]], 1.0)
        probability = share.prod(axis=1)
        code = np.where(after >= 0, graph.direction[after], 0)
        code = np.concatenate([code, np.zeros_like(lane[:, :1])], axis=1)
        turn = np.take_along_axis(code, (code > 0).argmax(axis=1)[:, None], axis=1)[:, 0]
        stops = [self._stop_constraints(*path) for path in zip(lane, start, strict=True)]
        self.lane = _joined(self.lane, lane, -1)
        self.start = _joined(self.start, start, np.inf)
        self.limit = _joined(self.limit, np.where(there, limits(graph)[lane], 0.0), 0.0)
        self.probability = np.concatenate([self.probability, probability])
        self.turn = np.concatenate([self.turn, turn])
        at = _padded([[x for x, _ in one] for one in stops], np.inf)
        row = _padded([[row for _, row in one] for one in stops], 0)
        self.stop_x = _joined(self.stop_x, at, np.inf)
        self.stop_row = _joined(self.stop_row, row, 0)
        order = np.argsort(probability, kind="stable")  # the last one written stays
        self.likeliest[lane[order, 0]] = count + order
        self.by_turn[lane[order, 0], turn[order]] = count + order

    def _chains(self, lane: int) -> list[list[int]]:
        """The paths from a lane, each a list of lanes: depth first, `MOST_PATHS` at most."""
        most = math.ceil(MOST_LANES * self._reach_m / REACH_M)
        found: list[list[int]] = []
        open_: list[tuple[list[int], float]] = [([lane], 0.0)]
        while open_ and len(found) < MOST_PATHS:
            chain, beyond_m = open_.pop()
            ways = self._onward[chain[-1]]
            if not ways or len(chain) >= most or beyond_m >= self._reach_m:
                found.append(chain)
                continue
            open_ += [
                ([*chain, way], beyond_m + float(self.lane_length[way])) for way in reversed(ways)
            ]
        return found

    def _stop_constraints(self, lanes: IntArray, start: FloatArray) -> list[tuple[float, int]]:
        """Distance along a path and row of each of its stop constraints, in order."""
        graph = self._graph
        found: list[tuple[float, int]] = []
        for j, lane in enumerate(lanes[lanes >= 0].tolist()):
            begin = float(start[j])
            guards = graph.signal[lane], self._yield_row[lane]
            found += [(begin, int(row)) for row in guards if j > 0 and row >= 0]
            for z in range(graph.cross_first[lane], graph.cross_first[lane + 1]):
                near = float(graph.cross_s[z])
                at_line = j > 0 and graph.internal[lane] and near <= STOP_LINE_REACH_M
                found.append((begin + (0.0 if at_line else near), self.groups + z))
        return sorted(found)


def _together(graph: LaneGraph, prior: FloatArray) -> FloatArray:
    """(L,) sum of the priors of the lanes that can follow each; 1 where none does."""
    ways = np.where(graph.successors >= 0, prior[graph.successors], 0.0)
    return np.where(graph.ahead >= 0, ways.sum(axis=1), 1.0)


def _joined(old: NDArray[Any], new: NDArray[Any], fill: float) -> NDArray[Any]:
    """Rows of both, as wide as the wider ones."""
    wide = max(old.shape[1], new.shape[1])
    parts = [
        np.pad(one, ((0, 0), (0, wide - one.shape[1])), constant_values=fill) for one in (old, new)
    ]
    return np.concatenate(parts)


def _padded(rows: Sequence[Sequence[float]], fill: float) -> NDArray[Any]:
    """(Q, longest, at least 1) rows of different lengths, filled up at the end."""
    longest = max((len(row) for row in rows), default=0) or 1
    return np.array([[*row, *[fill] * (longest - len(row))] for row in rows])
