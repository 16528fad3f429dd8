"""The road as arrays: which lane follows which, what guards each entry, where paths cross.

A `LaneGraph` holds what a `Road` holds, as arrays indexed like ``Road.lanes``, so that observables
and predictors work on many agents at once. It is built once per road (`LaneGraph.of`).
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sim.road import Connection, Lane, LanePosition, Road
from sim.road.cells import boxes_of, near_pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

DIRECTIONS: Final = ("straight", "right", "left", "turnaround")
"""Directions at the end of a lane, by preference where nothing else is known; their order is the
code order of ``LaneGraph.direction``."""

NEAR_M, CELL_M = 0.01, 30.0
"""Lines whose boxes are farther apart than this do not meet; width of the cells in which such boxes
are looked for, m (beyond rounding errors, and about the size of a junction)."""

_PROJECT_CHUNK: Final = 2048
"""Points projected at once, so that memory stays small however long a recording is."""


@dataclass(frozen=True, slots=True, eq=False)
class LaneGraph:
    """Lanes and their relations; every index is into ``Road.lanes``, -1 means none.

    Attributes:
        length: (L,) length of each lane, m.
        limit: (L,) speed limit, m/s; NaN where unknown, and where limits do not rule.
        width: (L,) m.
        internal: (L,) whether the lane crosses a junction.
        drivable: (L,) whether vehicles may use it.
        left: (L,) lane next to it on the left, of the same edge.
        right: (L,) lane next to it on the right, of the same edge.
        successors: (L, S) lanes that can follow, in the order of `DIRECTIONS`.
        ahead: (L,) the successor taken where nothing else is known: ``successors[:, 0]``.
        behind: (L,) the lane that most directly leads here.
        direction: (L,) code into `DIRECTIONS` of the lane's connection; 0 outside junctions.
        signal: (L,) signal group that guards entering the lane.
        must_yield: (L,) whether others have priority over those who enter the lane.
        must_stop: (L,) whether there is a stop sign before the lane.
        cross_lane: (Z,) lane of each place where a lane and a crossing meet.
        cross_first: (L + 1,) where those of each lane begin.
        cross_id: (Z,) the crossing, index into ``Road.crossings``.
        cross_s: (Z,) distance along the lane of the crossing's near edge, m.
        cross_exit_s: (Z,) distance along the lane of its far edge, m.
        cross_u: (Z,) distance along the crossing of the lane's centre line, m.
        segment_start: (G, 2) where each straight piece of centre line begins, m.
        segment_direction: (G, 2) unit vector of each piece.
        segment_heading: (G,) of each piece, rad.
        segment_at: (G,) distance along its lane at which each piece begins, m.
        segment_first: (L,) first piece of each lane.
        segment_last: (L,) last piece of each lane.
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
    must_yield: BoolArray
    must_stop: BoolArray
    cross_lane: IntArray
    cross_first: IntArray
    cross_id: IntArray
    cross_s: FloatArray
    cross_exit_s: FloatArray
    cross_u: FloatArray
    segment_start: FloatArray
    segment_direction: FloatArray
    segment_heading: FloatArray
    segment_at: FloatArray
    segment_first: IntArray
    segment_last: IntArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road) -> LaneGraph:
        """The lane graph of a road, built on first use and kept."""
        return _build(road)

    def position(
        self, lane: IntArray, s: FloatArray, offset: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Places given in lane coordinates; beyond either end a lane goes on straight.

        Args:
            lane: (n,) lane indices.
            s: (n,) distance along the lane, m.
            offset: (n,) signed distance to the left of the centre line, m; 0 if not given.

        Returns:
            (n, 2) positions, m, and (n,) headings of the lane there, rad.
        """
        from sim.road.lane_coordinates import place  # compiled: only who asks pays for loading it

        xy, piece = np.empty((lane.size, 2)), np.empty(lane.size, np.int64)
        place(
            lane, s, np.zeros(lane.size) if offset is None else offset, self.segment_first,
            self.segment_last, self.segment_at, self.segment_start, self.segment_direction, xy,
            piece,
        )  # fmt: skip
        return xy, self.segment_heading[piece]


def project(road: Road, xy: FloatArray, heading: FloatArray) -> LanePosition:
    """`Road.project` for any number of points, in chunks of bounded memory."""
    parts = [
        road.project(xy[i : i + _PROJECT_CHUNK], heading[i : i + _PROJECT_CHUNK])
        for i in range(0, len(xy), _PROJECT_CHUNK)
    ]
    if not parts:
        return LanePosition(np.empty(0, np.int64), np.empty(0), np.empty(0))
    return LanePosition(
        lane=np.concatenate([p.lane for p in parts]),
        s=np.concatenate([p.s for p in parts]),
        offset=np.concatenate([p.offset for p in parts]),
    )


def _build(road: Road) -> LaneGraph:
    lanes = road.lanes
    return LaneGraph(
        length=np.array([_steps_of(lane)[1].sum() for lane in lanes]),
        limit=np.array(
            [lane.speed_limit_mps if road.knows.limits_rule else np.nan for lane in lanes]
        ),
        width=np.array([lane.width_m for lane in lanes]),
        internal=np.array([lane.internal for lane in lanes]),
        drivable=np.array([not lane.walking for lane in lanes]),
        **_beside(road),
        **_following(road),
        **_crossed(road),
        **_segments(road),
    )


def _beside(road: Road) -> dict[str, Any]:
    """The lanes next to each lane."""
    n = len(road.lanes)
    left, right = np.full(n, -1), np.full(n, -1)
    by_place = {(lane.edge, lane.index): i for i, lane in enumerate(road.lanes) if not lane.walking}
    for i, lane in enumerate(road.lanes):
        if not lane.walking and not lane.internal:
            left[i] = by_place.get((lane.edge, lane.index + 1), -1)
            right[i] = by_place.get((lane.edge, lane.index - 1), -1)
    return {"left": left, "right": right}


def _following(road: Road) -> dict[str, Any]:
    """The lanes after and before each lane, and what guards its entry."""
    index, n = road.lane_index, len(road.lanes)
    following: list[list[tuple[int, int]]] = [[] for _ in range(n)]
    direction = np.zeros(n, dtype=np.int64)
    signal = np.full(n, -1)
    must_yield, must_stop = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    for connection in road.connections:
        if connection.from_lane not in index or connection.to_lane not in index:
            continue
        code = _direction_code(connection)
        chain = [index[i] for i in (connection.from_lane, *connection.via, connection.to_lane)]
        for one, then in itertools.pairwise(chain):
            if (code, then) not in following[one]:
                following[one].append((code, then))
        for via in chain[1:-1]:
            direction[via] = code
        entry = chain[1]
        if connection.via:
            signal[entry] = connection.signal
            must_yield[entry] = connection.must_yield
            must_stop[entry] = connection.must_stop

    most = max((len(f) for f in following), default=0) or 1
    successors = np.full((n, most), -1)
    behind, rank = np.full(n, -1), np.full(n, len(DIRECTIONS))
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
        "must_yield": must_yield,
        "must_stop": must_stop,
    }


def _crossed(road: Road) -> dict[str, Any]:
    """Where lanes meet crossings."""
    lanes = [i for i, lane in enumerate(road.lanes) if not lane.walking]
    lines = [crossing.centerline for crossing in road.crossings]
    near = near_pairs(
        boxes_of([road.lanes[i].centerline for i in lanes], NEAR_M), boxes_of(lines, NEAR_M), CELL_M
    )
    meets = [
        (i, c, *meet)
        for i, c in ((lanes[k], c) for k, c in near.tolist())
        if (meet := _meet(road.lanes[i].centerline, lines[c], road.crossings[c].width_m))
        is not None
    ]
    table = np.array(meets, dtype=np.float64).reshape(-1, 5)
    lane = table[:, 0].astype(np.int64)
    # kernels are compiled again for columns that do not lie together, as those of no row do
    near_s, exit_s, across_m = (np.ascontiguousarray(table[:, k]) for k in (2, 3, 4))
    return {
        "cross_lane": lane,
        "cross_first": np.searchsorted(lane, np.arange(len(road.lanes) + 1)),
        "cross_id": table[:, 1].astype(np.int64),
        "cross_s": near_s,
        "cross_exit_s": exit_s,
        "cross_u": across_m,
    }


def _steps_of(lane: Lane) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(P, 2) start, (P,) length and (P, 2) unit direction of each straight piece of a lane."""
    step = np.diff(lane.centerline, axis=0)
    size = np.hypot(step[:, 0], step[:, 1])
    keep = size > 1e-9
    if not keep.any():  # a lane of no length: a stub keeps the arrays whole
        step, size, keep = np.array([[1e-9, 0.0]]), np.array([1e-9]), np.array([True])
    step, size = step[keep], size[keep]
    return lane.centerline[: keep.size][keep], size, step / size[:, None]


def _segments(road: Road) -> dict[str, Any]:
    """The straight pieces of all centre lines."""
    pieces = [_steps_of(lane) for lane in road.lanes]
    directions = np.concatenate([direction for _, _, direction in pieces])
    end = np.cumsum([size.size for _, size, _ in pieces])
    return {
        "segment_start": np.concatenate([start for start, _, _ in pieces]),
        "segment_direction": directions,
        "segment_heading": np.arctan2(directions[:, 1], directions[:, 0]),
        "segment_at": np.concatenate([np.cumsum(size) - size for _, size, _ in pieces]),
        "segment_first": np.concatenate([[0], end[:-1]]).astype(np.int64),
        "segment_last": (end - 1).astype(np.int64),
    }


def _direction_code(connection: Connection) -> int:
    return DIRECTIONS.index(connection.direction)


def _meet(
    lane: FloatArray, crossing: FloatArray, width_m: float
) -> tuple[float, float, float] | None:
    """Where a lane meets a crossing: near edge and far edge along the lane, place across it, m."""
    step_a, step_b = np.diff(lane, axis=0), np.diff(crossing, axis=0)
    long_a, long_b = np.hypot(*step_a.T), np.hypot(*step_b.T)
    before_a, before_b = np.cumsum(long_a) - long_a, np.cumsum(long_b) - long_b
    for j in range(len(step_b)):
        for i in range(len(step_a)):
            det = step_a[i, 0] * step_b[j, 1] - step_a[i, 1] * step_b[j, 0]
            if abs(det) < 1e-9 * max(long_a[i] * long_b[j], 1e-9):
                continue
            gap = crossing[j] - lane[i]
            t = (gap[0] * step_b[j, 1] - gap[1] * step_b[j, 0]) / det
            u = (gap[0] * step_a[i, 1] - gap[1] * step_a[i, 0]) / det
            if 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0:
                sine = abs(det) / (long_a[i] * long_b[j])
                half = 0.5 * width_m / max(sine, 0.3)
                s = before_a[i] + t * long_a[i]
                return s - half, s + half, before_b[j] + u * long_b[j]
    return None
