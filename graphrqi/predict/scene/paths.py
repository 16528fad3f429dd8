"""Paths that lead on from lanes, with the stop constraints along them."""

from __future__ import annotations

import functools
import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.scene.priority import priority_of
from sim.road import Road
from sim.road.lane_graph import DIRECTIONS, LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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
    Lanes and stop constraints are padded at the end, and so are the rows. A row never changes once
    it is there; arrays are replaced by larger ones.

    Args:
        road: whose paths they are.
        reach_m: how far they continue beyond their first lane, m.

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
        kinds: (2,) number of signal groups, and of these and the places where lanes and crossings
            meet: where each kind of stop constraint ends among the rows.
        priority: the yielding places; drivers slow down at those where a junction is entered until
            they can see.
        plans_near: (L, W) signal plans that somebody on each lane may come to, -1 after the last.
        beside: (2, L) lanes to the left and to the right of each, -1: none.
        lane_spacing: (2, L) distance between the two centre lines, m.
        by_turn: (L, D) likeliest path from each lane that turns each way, -1: none.
        likeliest: (L,) likeliest path from each lane, 0 where there is none.
        lane_length: (L,) m.
    """

    def __init__(self, road: Road, reach_m: float = REACH_M) -> None:
        graph = LaneGraph.of(road)
        lanes = graph.length.size
        self._lanes = _LaneLists.of(road, graph)
        self._reach_m = reach_m
        self.groups = len(road.signal_groups)
        self.kinds = np.array([self.groups, self.groups + graph.cross_lane.size])
        self.priority = priority_of(road, graph)
        self._yield_row = {
            lane: int(self.kinds[1]) + y for y, lane in enumerate(self.priority.lane.tolist())
        }
        self._count = 0
        self._covered_m = np.full(lanes + 1, -np.inf)
        self._covered_m[-1] = np.inf  # no lane
        self.first, self.options = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
        self.lane, self.start = np.full((1, 1), -1), np.full((1, 1), np.inf)
        self.limit, self.probability = np.zeros((1, 1)), np.ones(1)
        self.turn = np.zeros(1, np.int64)
        self.stop_x, self.stop_row = np.full((1, 1), np.inf), np.zeros((1, 1), np.int64)
        self.plans_near = np.full((lanes, 1), -1)
        self.beside = np.stack([graph.left, graph.right])
        self.lane_spacing = (graph.width[None] + graph.width[np.maximum(self.beside, 0)]) / 2
        self.by_turn = np.full((lanes, len(DIRECTIONS)), -1)
        self.likeliest = np.zeros(lanes, np.int64)
        self.lane_length = graph.length
        self._columns: PathColumns | None = None

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road, reach_m: float = REACH_M) -> PathTable:
        """The paths of a road, kept with what has been worked out of them."""
        return PathTable(road, reach_m)

    @property
    def columns(self) -> PathColumns:
        """The columns that compiled functions read."""
        if self._columns is None:
            self._columns = PathColumns(*(getattr(self, name) for name in PathColumns._fields))
        return self._columns

    def cover(self, lane: IntArray, reach_m: float) -> None:
        """Work out the paths of every lane that somebody may come to, where they are missing.

        Args:
            lane: (n,) lanes that drivers are on, -1: none.
            reach_m: how far they may go beyond the end of these lanes, changing lanes or not, m.
        """
        missing = lane[self._covered_m[lane] < reach_m]
        if not missing.size:
            return
        missing = np.unique(missing)
        fresh: list[int] = []
        near: list[list[int]] = []
        for origin in missing.tolist():
            reached = self._lanes.within(origin, reach_m)
            fresh += [i for i in reached if self.options[i] == 0 and self._lanes.drivable[i]]
            near.append(sorted({p for i in reached for p in self._lanes.plans[i]}))
        self._add(list(dict.fromkeys(fresh)))
        self._covered_m[missing] = reach_m
        plans = _padded(near, -1, np.int64)
        self.plans_near = _room(self.plans_near, (len(self.plans_near), plans.shape[1]), -1)
        self.plans_near[missing, : plans.shape[1]] = plans

    def _add(self, lanes: list[int]) -> None:
        """Append the paths of some lanes."""
        lists, chains = self._lanes, []
        for lane in lanes:
            chains += (found := lists.chains(lane, self._reach_m))
            self.first[lane], self.options[lane] = (
                self._count + len(chains) - len(found),
                len(found),
            )
        begins = [lists.begins(chain) for chain in chains]
        stops = [
            self._stop_constraints(chain, begin)
            for chain, begin in zip(chains, begins, strict=True)
        ]
        ways = [lists.way(chain) for chain in chains]
        rows: dict[str, tuple[NDArray[Any], float]] = {
            "lane": (_padded(chains, -1, np.int64), -1),
            "start": (_padded(begins, np.inf, np.float64), np.inf),
            "limit": (_padded([[lists.limit[i] for i in c] for c in chains], 0.0, float), 0.0),
            "probability": (np.array([p for p, _ in ways], dtype=np.float64), 1.0),
            "turn": (np.array([t for _, t in ways], dtype=np.int64), 0),
            "stop_x": (_padded([[x for x, _ in some] for some in stops], np.inf, float), np.inf),
            "stop_row": (_padded([[row for _, row in some] for some in stops], 0, np.int64), 0),
        }
        end = self._count + len(chains)
        for name, (values, fill) in rows.items():
            old = getattr(self, name)
            grown = _room(old, (end, *values.shape[1:]), fill)
            grown[(slice(self._count, end), *(slice(n) for n in values.shape[1:]))] = values
            setattr(self, name, grown)
        for lane in lanes:
            begin, best = int(self.first[lane]), -1.0
            best_of_turn = [-1.0] * len(DIRECTIONS)
            for q in range(begin, begin + int(self.options[lane])):  # of equals the last counts
                probability, turn = ways[q - self._count]
                if probability >= best:
                    best, self.likeliest[lane] = probability, q
                if probability >= best_of_turn[turn]:
                    best_of_turn[turn], self.by_turn[lane, turn] = probability, q
        self._count, self._columns = end, None

    def _stop_constraints(self, chain: list[int], begin: list[float]) -> list[tuple[float, int]]:
        """Distance along a path and row of each of its stop constraints, in order."""
        lists = self._lanes
        found: list[tuple[float, int]] = []
        for j, lane in enumerate(chain):
            if j > 0 and lists.signal[lane] >= 0:
                found.append((begin[j], lists.signal[lane]))
            if j > 0 and lane in self._yield_row:
                found.append((begin[j], self._yield_row[lane]))
            for z in range(lists.cross_first[lane], lists.cross_first[lane + 1]):
                near = lists.cross_s[z]
                at_line = j > 0 and lists.internal[lane] and near <= STOP_LINE_REACH_M
                found.append((begin[j] + (0.0 if at_line else near), self.groups + z))
        return sorted(found)


@dataclass(frozen=True, slots=True, eq=False)
class _LaneLists:
    """Columns of a `LaneGraph` as lists, which plain Python reads faster than arrays.

    Attributes:
        onward: lanes that can follow each.
        beside: the lanes to the left and right of each.
        plans: signal plans that guard entering each.
        weight: `PRIOR` of each lane's direction, and of all that can follow each, together.
    """

    onward: list[list[int]]
    beside: list[list[int]]
    plans: list[tuple[int, ...]]
    weight: tuple[list[float], list[float]]
    length: list[float]
    limit: list[float]
    direction: list[int]
    signal: list[int]
    internal: list[bool]
    drivable: list[bool]
    cross_first: list[int]
    cross_s: list[float]

    @staticmethod
    def of(road: Road, graph: LaneGraph) -> _LaneLists:
        """The lists of a road."""
        onward = [[i for i in row if i >= 0] for row in graph.successors.tolist()]
        direction, signal = graph.direction.tolist(), graph.signal.tolist()
        own = [PRIOR[code] for code in direction]
        controls: dict[int, list[int]] = {}
        for number, plan in enumerate(road.signal_plans):
            for group in plan.groups:
                controls.setdefault(group, []).append(number)
        return _LaneLists(
            onward=onward,
            beside=[
                [i for i in pair if i >= 0]
                for pair in zip(graph.left.tolist(), graph.right.tolist(), strict=True)
            ],
            plans=[tuple(controls.get(group, ())) for group in signal],
            weight=(own, [sum([own[i] for i in ways]) for ways in onward]),
            length=graph.length.tolist(),
            limit=limits(graph).tolist(),
            direction=direction,
            signal=signal,
            internal=graph.internal.tolist(),
            drivable=graph.drivable.tolist(),
            cross_first=graph.cross_first.tolist(),
            cross_s=graph.cross_s.tolist(),
        )

    def chains(self, lane: int, reach_m: float) -> list[list[int]]:
        """The paths from a lane, each a list of lanes: depth first, `MOST_PATHS` at most."""
        most = math.ceil(MOST_LANES * reach_m / REACH_M)
        found: list[list[int]] = []
        open_: list[tuple[list[int], float]] = [([lane], 0.0)]
        while open_ and len(found) < MOST_PATHS:
            chain, beyond_m = open_.pop()
            ways = self.onward[chain[-1]]
            if not ways or len(chain) >= most or beyond_m >= reach_m:
                found.append(chain)
                continue
            open_ += [([*chain, way], beyond_m + self.length[way]) for way in reversed(ways)]
        return found

    def begins(self, chain: list[int]) -> list[float]:
        """Distance along a path at which each of its lanes begins, m."""
        return [0.0, *itertools.accumulate(self.length[lane] for lane in chain[:-1])]

    def way(self, chain: list[int]) -> tuple[float, int]:
        """Probability of a path from its first lane, and the code of its first turn."""
        probability, turn = 1.0, 0
        own, together = self.weight
        for before, lane in itertools.pairwise(chain):
            probability *= own[lane] / together[before]
            turn = turn or self.direction[lane]
        return probability, turn

    def within(self, lane: int, reach_m: float) -> list[int]:
        """Lanes that a driver may come to, on its way or by changing lanes (Dijkstra's search)."""
        gone = {lane: 0.0}  # to the end of each lane
        waiting = [(0.0, lane)]
        while waiting:
            so_far, at = heapq.heappop(waiting)
            if so_far > gone[at]:
                continue
            for other in self.beside[at]:
                if so_far < gone.get(other, math.inf):
                    gone[other] = so_far
                    heapq.heappush(waiting, (so_far, other))
            if so_far > reach_m:
                continue
            for way in self.onward[at]:
                end = so_far + self.length[way]
                if end < gone.get(way, math.inf):
                    gone[way] = end
                    heapq.heappush(waiting, (end, way))
        return list(gone)


def _room(array: NDArray[Any], shape: tuple[int, ...], fill: float) -> NDArray[Any]:
    """An array with at least this shape, its rows doubled where they do not suffice."""
    if all(have >= want for have, want in zip(array.shape, shape, strict=True)):
        return array
    sizes = [max(have, want) for have, want in zip(array.shape, shape, strict=True)]
    if shape[0] > len(array):
        sizes[0] = max(shape[0], 2 * len(array))
    grown = np.full(sizes, fill, dtype=array.dtype)
    grown[tuple(slice(n) for n in array.shape)] = array
    return grown


def _padded(
    rows: Sequence[Sequence[float] | NDArray[Any]], fill: float, dtype: Any
) -> NDArray[Any]:
    """(Q, longest, at least 1) rows of different lengths, filled up at the end."""
    out = np.full((len(rows), max((len(row) for row in rows), default=0) or 1), fill, dtype)
    for q, row in enumerate(rows):
        out[q, : len(row)] = row
    return out
