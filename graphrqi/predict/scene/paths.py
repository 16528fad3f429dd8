"""Every way on from every lane, with the places on it where one may have to stop."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.road import Road
from sim.road.lane_graph import DIRECTIONS, LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

REACH_M: Final = 150.0
"""Paths go on at least this far beyond the lane they begin on (our choice: 5 s at 30 m/s)."""

MOST_LANES: Final = 10
"""Lanes per path at most (our choice)."""

MOST_PATHS: Final = 200
"""Paths per lane at most, those that go straight on first (our choice: a maze has any number)."""

PRIOR: Final = (0.5, 0.2, 0.25, 0.05)
"""How likely one goes straight, right, left or back where all are open (our choice; a third to a
half of urban junction traffic turns)."""

UNKNOWN_LIMIT_MPS: Final = 50.0 / 3.6
"""What wishes are reckoned by where no limit is known (our choice: the usual one in towns)."""

STOP_LINE_REACH_M: Final = 8.0
"""A crossing this close behind a stop line is waited for at the line (our choice: the depth of a
crosswalk and its set-back)."""


@dataclass(frozen=True, slots=True, eq=False)
class PathTable:
    """All paths of a road; lanes and gates padded at the end.

    Attributes:
        lane: (Q, P) lanes in order, -1 after the end.
        start: (Q, P) distance from the start of the first lane at which each begins, m; +inf after.
        limit: (Q, P) speed limit, m/s.
        probability: (Q,) of taking this path from its first lane.
        turn: (Q,) code into ``lane_graph.DIRECTIONS`` of the first turn on it, 0 if none.
        gate_x: (Q, G) places where one may have to stop, m; +inf after the last.
        gate_row: (Q, G) rows of the scene's table of closed gates: signal groups first, then the
            places where lanes and crossings meet, then yielding entries.
        first: (L,) first path of each lane.
        count: (L,) how many paths each lane has.
        groups: number of signal groups.
        yield_entry: (Y,) whether each yielding place is where a junction is entered: there one
            slows down until one can see.
        foe_gate: (F,) yielding place that each conflict belongs to.
        foe_lane: (F,) lane of those who have priority there.
        foe_s: (F,) distance along that lane at which the ways cross, m.
        beside: (2, L) lanes to the left and to the right of each, -1: none.
        apart: (2, L) how far apart the two centres are, m.
        way: (L, D) likeliest path from each lane that turns each way, -1: none.
        likeliest: (L,) likeliest path from each lane, 0 where there is none.
    """

    lane: IntArray
    start: FloatArray
    limit: FloatArray
    probability: FloatArray
    turn: IntArray
    gate_x: FloatArray
    gate_row: IntArray
    first: IntArray
    count: IntArray
    groups: int
    yield_entry: BoolArray
    foe_gate: IntArray
    foe_lane: IntArray
    foe_s: FloatArray
    beside: IntArray
    apart: FloatArray
    way: IntArray
    likeliest: IntArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road) -> PathTable:
        """The paths of a road, built on first use and kept."""
        return _build(road)


@functools.lru_cache(maxsize=32)
def limits(graph: LaneGraph) -> FloatArray:
    """(L,) speed limits that wishes are reckoned by, m/s."""
    return np.where(np.isnan(graph.limit), UNKNOWN_LIMIT_MPS, graph.limit)


def _continue(graph: LaneGraph, chain: list[int], beyond_m: float) -> Iterator[list[int]]:
    ways = graph.successors[chain[-1]]
    ways = ways[ways >= 0]
    if not ways.size or len(chain) >= MOST_LANES or beyond_m >= REACH_M:
        yield chain
        return
    for way in ways:
        yield from _continue(graph, [*chain, int(way)], beyond_m + float(graph.length[way]))


def _build(road: Road) -> PathTable:
    graph = LaneGraph.of(road)
    groups = len(road.signal_groups)
    lanes = graph.length.size
    first, count = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
    rows: list[list[int]] = []
    for lane in range(lanes):
        first[lane] = len(rows)
        if graph.drivable[lane]:
            rows += itertools.islice(_continue(graph, [lane], 0.0), MOST_PATHS)
        count[lane] = len(rows) - first[lane]
    yield_lane, yield_entry, foes = _yielding(road, graph)
    yield_row = {lane: groups + graph.cross_lane.size + y for y, lane in enumerate(yield_lane)}
    most = max((len(r) for r in rows), default=1)
    lane_table = np.full((len(rows), most), -1)
    start = np.full((len(rows), most), np.inf)
    limit_of, limit = limits(graph), np.zeros((len(rows), most))
    probability, turn = np.ones(len(rows)), np.zeros(len(rows), np.int64)
    gates: list[list[tuple[float, int]]] = []
    for q, chain in enumerate(rows):
        lane_table[q, : len(chain)] = chain
        begin = np.concatenate([[0.0], np.cumsum(graph.length[chain])[:-1]])
        start[q, : len(chain)] = begin
        limit[q, : len(chain)] = limit_of[chain]
        mine: list[tuple[float, int]] = []
        for j, lane in enumerate(chain):
            if j > 0:
                open_ways = graph.successors[chain[j - 1]]
                weights = [PRIOR[graph.direction[w]] for w in open_ways[open_ways >= 0]]
                probability[q] *= PRIOR[graph.direction[lane]] / sum(weights)
                if turn[q] == 0:
                    turn[q] = graph.direction[lane]
                if graph.signal[lane] >= 0:
                    mine.append((float(begin[j]), int(graph.signal[lane])))
            if j > 0 and lane in yield_row:
                mine.append((float(begin[j]), yield_row[lane]))
            for z in np.flatnonzero(graph.cross_lane == lane):
                near = float(graph.cross_s[z])
                at_line = j > 0 and graph.internal[lane] and near <= STOP_LINE_REACH_M
                mine.append((float(begin[j]) + (0.0 if at_line else near), groups + int(z)))
        gates.append(sorted(mine))
    width = max((len(g) for g in gates), default=0) or 1
    gate_x, gate_row = np.full((len(rows), width), np.inf), np.zeros((len(rows), width), np.int64)
    for q, some in enumerate(gates):
        for g, (at, row) in enumerate(some):
            gate_x[q, g], gate_row[q, g] = at, row
    beside = np.stack([graph.left, graph.right])
    way, likeliest = np.full((lanes, len(DIRECTIONS)), -1), np.zeros(lanes, np.int64)
    order = np.argsort(probability, kind="stable")  # the likeliest is written last
    origin = np.repeat(np.arange(lanes), count)[order]
    way[origin, turn[order]] = order
    likeliest[origin] = order
    return PathTable(
        lane=lane_table,
        start=start,
        limit=limit,
        probability=probability,
        turn=turn,
        gate_x=gate_x,
        gate_row=gate_row,
        first=first,
        count=count,
        groups=groups,
        yield_entry=np.array(yield_entry, dtype=np.bool_),
        foe_gate=np.array([f[0] for f in foes], dtype=np.int64),
        foe_lane=np.array([f[1] for f in foes], dtype=np.int64),
        foe_s=np.array([f[2] for f in foes], dtype=np.float64),
        beside=beside,
        apart=(graph.width[None] + graph.width[np.maximum(beside, 0)]) / 2,
        way=way,
        likeliest=likeliest,
    )


def _yielding(
    road: Road, graph: LaneGraph
) -> tuple[list[int], list[bool], list[tuple[int, int, float]]]:
    """Lanes on which others have priority, whether each is a junction entry, and the conflicts.

    At signals those who turn yield; elsewhere the road says who does. A way has priority over a
    yielding one if it does not yield itself, or if it turns right where the other turns left.
    """
    index = road.lane_index
    ways: dict[int, tuple[int, int, int, bool]] = {}  # lane: from, to, direction, yields
    entries: set[int] = set()
    for connection in road.connections:
        via = [index[v] for v in connection.via if v in index]
        if not via or connection.from_lane not in index or connection.to_lane not in index:
            continue
        entries.add(via[0])
        for lane in via:
            ways[lane] = (
                index[connection.from_lane],
                index[connection.to_lane],
                DIRECTIONS.index(connection.direction),
                connection.direction != "straight"
                if connection.signal >= 0
                else connection.must_yield,
            )
    right, left = DIRECTIONS.index("right"), DIRECTIONS.index("left")
    lanes: list[int] = []
    foes: list[tuple[int, int, float]] = []
    for lane, (origin, target, direction, yields) in ways.items():
        if not yields:
            continue
        lanes.append(lane)
        for other, (from_, to, way, also) in ways.items():
            first = not also or (way == right and direction == left)
            if from_ == origin or not first:
                continue
            at = _crossing_at(road.lanes[other].centerline, road.lanes[lane].centerline)
            if at is None and to == target:
                at = float(graph.length[other])
            if at is not None:
                foes.append((len(lanes) - 1, other, at))
    return lanes, [lane in entries for lane in lanes], foes


def _crossing_at(line: FloatArray, other: FloatArray) -> float | None:
    """Distance along a line at which another crosses it, m; None if it does not."""
    before = 0.0
    for a, b in itertools.pairwise(line):
        for c, d in itertools.pairwise(other):
            step, across, gap = b - a, d - c, c - a
            det = step[0] * across[1] - step[1] * across[0]
            if abs(det) > 1e-9:
                t = (gap[0] * across[1] - gap[1] * across[0]) / det
                u = (gap[0] * step[1] - gap[1] * step[0]) / det
                if 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0:
                    return before + float(t * np.hypot(*step))
        before += float(np.hypot(*(b - a)))
    return None
