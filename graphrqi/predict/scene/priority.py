"""Priority at junctions, and the points where movements cross.

Movements are compared only where their lanes come near each other, so the cost grows with the
number of lanes and not with its square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    Args:
        road: the road.
        graph: its lanes.
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
    ways: dict[int, tuple[int, int, int, bool]] = {}
    entries: set[int] = set()
    for connection in road.connections:
        via = [index[v] for v in connection.via if v in index]
        if not via or connection.from_lane not in index or connection.to_lane not in index:
            continue
        entries.add(via[0])
        signalled = connection.signal >= 0
        yields = connection.direction != "straight" if signalled else connection.must_yield
        for lane in via:
            ways[lane] = (
                index[connection.from_lane],
                index[connection.to_lane],
                DIRECTIONS.index(connection.direction),
                yields,
            )
    table = np.array(list(ways.values()), dtype=np.int64).reshape(-1, 4)
    return _Movements(
        lane=np.array(list(ways), dtype=np.int64),
        origin=table[:, 0],
        target=table[:, 1],
        direction=table[:, 2],
        yields=table[:, 3].astype(np.bool_),
        entry=np.array([lane in entries for lane in ways], dtype=np.bool_),
    )


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
