"""Every path that leads on from every lane, with the stop constraints along it."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.road import Road
from sim.road.lane_graph import DIRECTIONS, LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

REACH_M: Final = 150.0
"""Paths continue at least this far beyond their first lane (our choice: 5 s at 30 m/s)."""

MOST_LANES: Final = 10
"""Lanes per path at most (our choice)."""

MOST_PATHS: Final = 200
"""Paths per lane at most, straight ones first (our choice: a maze has any number)."""

PRIOR: Final = (0.5, 0.2, 0.25, 0.05)
"""Probability of going straight, right, left or back where all are open (our choice; a third to a
half of urban junction traffic turns)."""

UNKNOWN_LIMIT_MPS: Final = 50.0 / 3.6
"""Speed limit assumed where none is known (our choice: the usual one in towns)."""

STOP_LINE_REACH_M: Final = 8.0
"""Vehicles wait at the stop line for a crossing this close behind it (our choice: the depth of a
crosswalk and its set-back)."""


@dataclass(frozen=True, slots=True, eq=False)
class PathTable:
    """All paths of a road; lanes and stop constraints are padded at the end.

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
        options: (L,) how many paths each lane has.
        groups: number of signal groups.
        yield_entry: (Y,) whether each yielding place is where a junction is entered: drivers slow
            down there until they can see.
        foe_place: (F,) yielding place that each conflict belongs to.
        foe_lane: (F,) lane of the vehicles that have priority there.
        foe_s: (F,) distance along that lane at which the two movements cross, m.
        beside: (2, L) lanes to the left and to the right of each, -1: none.
        lane_spacing: (2, L) distance between the two centre lines, m.
        by_turn: (L, D) likeliest path from each lane that turns each way, -1: none.
        likeliest: (L,) likeliest path from each lane, 0 where there is none.
        lane_length: (L,) m.
    """

    lane: IntArray
    start: FloatArray
    limit: FloatArray
    probability: FloatArray
    turn: IntArray
    stop_x: FloatArray
    stop_row: IntArray
    first: IntArray
    options: IntArray
    groups: int
    yield_entry: BoolArray
    foe_place: IntArray
    foe_lane: IntArray
    foe_s: FloatArray
    beside: IntArray
    lane_spacing: FloatArray
    by_turn: IntArray
    likeliest: IntArray
    lane_length: FloatArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road) -> PathTable:
        """The paths of a road, built on first use and kept."""
        return _build(road)


class PathColumns(NamedTuple):
    """The columns of a `PathTable` that compiled functions read, as one argument; see there."""

    lane: IntArray
    start: FloatArray
    limit: FloatArray
    turn: IntArray
    stop_x: FloatArray
    stop_row: IntArray
    beside: IntArray
    lane_spacing: FloatArray
    by_turn: IntArray
    lane_length: FloatArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(paths: PathTable) -> PathColumns:
        """The columns of a table, gathered once."""
        return PathColumns(*(getattr(paths, name) for name in PathColumns._fields))


@functools.lru_cache(maxsize=32)
def limits(graph: LaneGraph) -> FloatArray:
    """(L,) speed limits, m/s; `UNKNOWN_LIMIT_MPS` where none is known."""
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
    first, options = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
    chains: list[list[int]] = []
    for lane in range(lanes):
        first[lane] = len(chains)
        if graph.drivable[lane]:
            chains += itertools.islice(_continue(graph, [lane], 0.0), MOST_PATHS)
        options[lane] = len(chains) - first[lane]
    yield_lane, yield_entry, foes = _yielding(road, graph)
    yield_row = {lane: groups + graph.cross_lane.size + y for y, lane in enumerate(yield_lane)}
    begins = [np.concatenate([[0.0], np.cumsum(graph.length[chain])[:-1]]) for chain in chains]
    stops = [
        _stop_constraints(graph, chain, begin, groups, yield_row)
        for chain, begin in zip(chains, begins, strict=True)
    ]
    ways = [_way(graph, chain) for chain in chains]
    probability = np.array([p for p, _ in ways], dtype=np.float64)
    turn = np.array([t for _, t in ways], dtype=np.int64)
    beside = np.stack([graph.left, graph.right])
    by_turn, likeliest = np.full((lanes, len(DIRECTIONS)), -1), np.zeros(lanes, np.int64)
    order = np.argsort(probability, kind="stable")  # the likeliest is written last
    origin = np.repeat(np.arange(lanes), options)[order]
    by_turn[origin, turn[order]] = order
    likeliest[origin] = order
    limit = limits(graph)
    return PathTable(
        lane=_padded(chains, -1, np.int64),
        start=_padded(begins, np.inf, np.float64),
        limit=_padded([limit[chain] for chain in chains], 0.0, np.float64),
        probability=probability,
        turn=turn,
        stop_x=_padded([[x for x, _ in some] for some in stops], np.inf, np.float64),
        stop_row=_padded([[row for _, row in some] for some in stops], 0, np.int64),
        first=first,
        options=options,
        groups=groups,
        yield_entry=np.array(yield_entry, dtype=np.bool_),
        foe_place=np.array([f[0] for f in foes], dtype=np.int64),
        foe_lane=np.array([f[1] for f in foes], dtype=np.int64),
        foe_s=np.array([f[2] for f in foes], dtype=np.float64),
        beside=beside,
        lane_spacing=(graph.width[None] + graph.width[np.maximum(beside, 0)]) / 2,
        by_turn=by_turn,
        likeliest=likeliest,
        lane_length=graph.length,
    )


def _padded(
    rows: Sequence[Sequence[float] | NDArray[Any]], fill: float, dtype: Any
) -> NDArray[Any]:
    """(Q, longest, at least 1) rows of different lengths, filled up at the end."""
    out = np.full((len(rows), max((len(row) for row in rows), default=0) or 1), fill, dtype)
    for q, row in enumerate(rows):
        out[q, : len(row)] = row
    return out


def _way(graph: LaneGraph, chain: list[int]) -> tuple[float, int]:
    """Probability of a path from its first lane, and the code of its first turn."""
    probability, turn = 1.0, 0
    for before, lane in itertools.pairwise(chain):
        options = graph.successors[before]
        weights = [PRIOR[graph.direction[w]] for w in options[options >= 0]]
        probability *= PRIOR[graph.direction[lane]] / sum(weights)
        turn = turn or int(graph.direction[lane])
    return probability, turn


def _stop_constraints(
    graph: LaneGraph, chain: list[int], begin: FloatArray, groups: int, yield_row: dict[int, int]
) -> list[tuple[float, int]]:
    """Distance along a path and row of each of its stop constraints, in order."""
    found: list[tuple[float, int]] = []
    for j, lane in enumerate(chain):
        if j > 0 and graph.signal[lane] >= 0:
            found.append((float(begin[j]), int(graph.signal[lane])))
        if j > 0 and lane in yield_row:
            found.append((float(begin[j]), yield_row[lane]))
        for z in np.flatnonzero(graph.cross_lane == lane):
            near = float(graph.cross_s[z])
            at_line = j > 0 and graph.internal[lane] and near <= STOP_LINE_REACH_M
            found.append((float(begin[j]) + (0.0 if at_line else near), groups + int(z)))
    return sorted(found)


def _yielding(
    road: Road, graph: LaneGraph
) -> tuple[list[int], list[bool], list[tuple[int, int, float]]]:
    """Lanes on which others have priority, whether each is a junction entry, and the conflicts.

    At signals turning vehicles yield; elsewhere the road says who does. A movement has priority
    over a yielding one if it does not yield itself, or turns right where the other turns left.
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
