"""The road as arrays: which lane follows which, what guards each entry, where paths cross.

A `LaneGraph` holds what a `Road` holds, as arrays indexed like ``Road.lanes``, so that observables
and predictors work on many agents at once. It is built once per road (`LaneGraph.of`).
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from sim.frames import BoolArray, FloatArray, IntArray
from sim.geometry import LEAST_PIECE_M, Pieces, meeting, pieces_of
from sim.road import LanePosition, Road
from sim.road.cells import Cells, boxes_of, cells_of, members, near_pairs

DIRECTIONS: Final = ("straight", "right", "left", "turnaround")
"""Directions at the end of a lane, by preference where nothing else is known."""

NEAR_M, CELL_M = 0.01, 30.0
"""Greatest distance between the boxes of lines that meet; width of the cells of the search, m
(about the size of a junction)."""

LEAST_SINE: Final = 0.3
"""Sine of the angle below which a crossing is not made longer along a lane (17 degrees)."""

TURN_COST_M, PATH_TURN_COST_M = 0.7, 4.0
"""Cost of facing across a lane in locating an agent, m, and the cost on a path inside a
junction."""


@dataclass(frozen=True, eq=False)
class LaneGraph:
    """Lanes and their relations; every index is into ``Road.lanes``, -1 means none.

    Attributes:
        length: (L,) length of each lane, m.
        limit: (L,) speed limit, m/s; NaN where unknown, and where limits do not rule.
        width: (L,) m.
        internal: (L,) whether the lane crosses a junction.
        drivable: (L,) whether vehicles may use it.
        left, right: (L,) lane next to it on either side, of the same edge.
        successors: (L, S) lanes that can follow, in the order of `DIRECTIONS`.
        ahead: (L,) the successor taken where nothing else is known: ``successors[:, 0]``.
        behind: (L,) the lane that most directly leads here.
        direction: (L,) code into `DIRECTIONS` of the lane's connection; 0 outside junctions.
        signal: (L,) signal group that guards entering the lane.
        cross_lane: (Z,) lane of each place where a lane and a crossing meet.
        cross_first: (L + 1,) where those of each lane begin.
        cross_id: (Z,) the crossing, index into ``Road.crossings``.
        cross_s, cross_exit_s: (Z,) distance along the lane of its near and far edge, m.
        cross_u: (Z,) distance along the crossing of the lane's centre line, m.
        segment_start, segment_direction: (G, 2) where each straight piece of centre line begins,
            m, and its unit vector.
        segment_heading, segment_length: (G,) of each piece, rad and m.
        segment_at: (G,) distance along its lane at which each piece begins, m.
        segment_first, segment_last: (L,) first and last piece of each lane.
    """

    length: FloatArray
    limit: FloatArray
    width: FloatArray
    internal: BoolArray
    drivable: BoolArray
    left: IntArray
    right: IntArray
    successors: IntArray
    ahead: IntArray
    behind: IntArray
    direction: IntArray
    signal: IntArray
    cross_lane: IntArray
    cross_first: IntArray
    cross_id: IntArray
    cross_s: FloatArray
    cross_exit_s: FloatArray
    cross_u: FloatArray
    segment_start: FloatArray
    segment_direction: FloatArray
    segment_heading: FloatArray
    segment_length: FloatArray
    segment_at: FloatArray
    segment_first: IntArray
    segment_last: IntArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road) -> LaneGraph:
        """The lane graph of a road, built on first use and kept."""
        lanes = road.lanes
        pieces = [_pieces(lane.centerline) for lane in lanes]
        end = np.cumsum([each.length.size for each in pieces])
        start, direction, length, at = (np.concatenate(part) for part in zip(*pieces, strict=True))
        left, right = (_beside(road, step) for step in (1, -1))
        rules = road.knows.limits_rule
        return LaneGraph(
            length=np.array([each.length.sum() for each in pieces]),
            limit=np.array([lane.speed_limit_mps if rules else np.nan for lane in lanes]),
            width=np.array([lane.width_m for lane in lanes]),
            internal=np.array([lane.internal for lane in lanes]),
            drivable=np.array([not lane.walking for lane in lanes]),
            left=left,
            right=right,
            segment_start=start,
            segment_direction=direction,
            segment_heading=np.arctan2(direction[:, 1], direction[:, 0]),
            segment_length=length,
            segment_at=at,
            segment_first=np.append(0, end[:-1]),
            segment_last=end - 1,
            **_following(road),
            **_crossed(road),
        )

    def position(
        self, lane: IntArray, s: FloatArray, offset: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 2) places given in lane coordinates, m, and (n,) headings of the lane there, rad.

        The (n,) distances along the lanes and to their left are in m; the latter are 0 if not
        given. Beyond either end a lane goes on straight.
        """
        xy, piece = self.placed(lane, s, np.zeros(lane.size) if offset is None else offset)
        return xy, self.segment_heading[piece]

    def placed(
        self, lane: IntArray, s: FloatArray, offset: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """(n, 2) positions as of `position`, m, and (n,) the piece of centre line beside each."""
        from sim.road.lane_coordinates import place  # compiled: only who asks pays for loading it

        xy, piece = np.empty((lane.size, 2)), np.empty(lane.size, np.int64)
        place(
            lane, s, offset, self.segment_first, self.segment_last, self.segment_at,
            self.segment_start, self.segment_direction, xy, piece,
        )  # fmt: skip
        return xy, piece

    @cached_property
    def _fitted(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, Cells, IntArray]:
        """Start, direction, length and turn cost of vehicles' pieces, cells, and their numbers."""
        from sim.road.lane_coordinates import FIT_CELL_M, FIT_MARGIN_M

        lane = np.repeat(np.arange(self.length.size), self.segment_last - self.segment_first + 1)
        piece = np.flatnonzero(self.drivable[lane] & (self.segment_length > LEAST_PIECE_M))
        if not piece.size:
            raise InputError("road: found no drivable lane, expected at least one")
        start, direction = self.segment_start[piece], self.segment_direction[piece]
        length = self.segment_length[piece]
        # long pieces are cut, as their boxes would cover many cells
        parts = np.maximum(np.ceil(length / FIT_CELL_M), 1.0).astype(np.int64)
        whole, number = members(np.zeros_like(parts), parts)
        step = (length / parts)[whole, None] * direction[whole]
        ends = start[whole, None] + step[:, None] * (number[:, None] + [0.0, 1.0])[..., None]
        low, high = ends.min(axis=1) - FIT_MARGIN_M, ends.max(axis=1) + FIT_MARGIN_M
        cells = cells_of(np.concatenate([low, high], axis=1), whole, FIT_CELL_M)
        cost_m = np.where(self.internal[lane[piece]], PATH_TURN_COST_M, TURN_COST_M)
        return start, direction, length, cost_m, cells, piece

    def project(self, xy: FloatArray, heading: FloatArray) -> LanePosition:
        """Lane coordinates of points, on the vehicles' lane that fits place and heading best.

        The fit is the distance to the centre line plus, in metres, a cost of the heading's
        deviation. The cost is small on ordinary lanes and large inside junctions, where only the
        heading separates overlapping paths. Points are (n, 2), m, and headings (n,), rad.

        Raises:
            InputError: if the road has no lane for vehicles.
        """
        from sim.road.lane_coordinates import fit  # compiled: only who asks pays for loading it

        start, direction, length, cost_m, cells, piece = self._fitted
        best, (along, across) = np.empty(len(xy), np.int64), np.empty((2, len(xy)))
        xy, heading = (np.ascontiguousarray(one, dtype=np.float64) for one in (xy, heading))
        fit(xy, heading, start, direction, length, cost_m, cells, best, along, across)
        best = piece[best]
        lane = np.searchsorted(self.segment_first, best, side="right") - 1
        return LanePosition(lane=lane, s=self.segment_at[best] + along, offset=across)


def _pieces(line: FloatArray) -> Pieces:
    """The straight pieces of a centre line; a stub for one of no length keeps the arrays whole."""
    found = pieces_of(line)
    if found.length.size:
        return found
    return Pieces(line[:1], np.array([[1.0, 0.0]]), np.array([1e-9]), np.zeros(1))


def _beside(road: Road, step: int) -> IntArray:
    """(L,) the lane next to each, some steps to the left; none inside junctions."""
    driven = {(lane.edge, lane.index): i for i, lane in enumerate(road.lanes) if not lane.walking}
    places = [(lane.edge, lane.index + step) for lane in road.lanes]
    alone = [lane.walking or lane.internal for lane in road.lanes]
    return np.where(alone, -1, [driven.get(place, -1) for place in places])


def _following(road: Road) -> dict[str, Any]:
    """The lanes after and before each lane, and what guards its entry."""
    index, n = road.lane_index, len(road.lanes)
    following: list[set[tuple[int, int]]] = [set() for _ in range(n)]
    direction, signal, behind = np.zeros(n, dtype=np.int64), np.full(n, -1), np.full(n, -1)
    for way in road.connections:
        code = DIRECTIONS.index(way.direction)
        chain = [index[i] for i in (way.from_lane, *way.via, way.to_lane)]
        for one, then in itertools.pairwise(chain):
            following[one].add((code, then))
        direction[chain[1:-1]] = code
        if way.via:
            signal[chain[1]] = way.signal
    successors = np.full((n, max(map(len, following), default=0) or 1), -1)
    rank = np.full(n, len(DIRECTIONS))
    for i, ways in enumerate(following):
        for j, (code, then) in enumerate(sorted(ways)):
            successors[i, j] = then
            if code < rank[then]:
                rank[then], behind[then] = code, i
    return {
        "successors": successors,
        "ahead": successors[:, 0].copy(),
        "behind": behind,
        "direction": direction,
        "signal": signal,
    }


def _crossed(road: Road) -> dict[str, Any]:
    """Where lanes meet crossings."""
    lanes = [i for i, lane in enumerate(road.lanes) if not lane.walking]
    lines = [road.lanes[i].centerline for i in lanes]
    across = [crossing.centerline for crossing in road.crossings]
    meets = []
    for k, c in near_pairs(boxes_of(lines, NEAR_M), boxes_of(across, NEAR_M), CELL_M).tolist():
        found = meeting(lines[k], across[c])
        if found is not None:
            half_m = 0.5 * road.crossings[c].width_m / max(found.sine, LEAST_SINE)
            near_m, far_m = found.along - half_m, found.along + half_m
            meets.append((lanes[k], c, near_m, far_m, found.along_other))
    # kernels are compiled again for columns that do not lie together
    table = np.ascontiguousarray(np.array(meets, dtype=np.float64).reshape(-1, 5).T)
    lane, crossing = table[:2].astype(np.int64)
    return {
        "cross_lane": lane,
        "cross_first": np.searchsorted(lane, np.arange(len(road.lanes) + 1)),
        "cross_id": crossing,
        "cross_s": table[2],
        "cross_exit_s": table[3],
        "cross_u": table[4],
    }
