"""Searches along lanes and lines, compiled: vehicles ahead and behind, stop lines, crossings.

`sim.geometry` has the counterparts for single lines in numpy; `sim.episode.observables` says what
each observable means.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sim.compiled import compiled, in_place
from sim.frames import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from sim.road.lane_graph import LaneGraph

LOOK_AHEAD_M = 200.0
"""Leaders, signals and crossings farther than this are not seen (14 s at 14 m/s)."""

MAX_LANES_AHEAD = 8
"""How many lanes onward are searched at most: junction paths are short."""

BESIDE_LANE_M = 0.5
"""A vehicle whose centre is this far outside a lane still drives on it."""

OFF_END_M = 5.0
"""A vehicle this far beyond a lane's end is not on the lane."""


class LaneView(NamedTuple):
    """Neighbours of m vehicles along their lanes; distances are +inf and indices -1 for none.

    Attributes:
        lane, segment: (m,) lane that the vehicle's centre is on, and the straight piece of centre
            line beside it.
        missed: (m,) how far the vehicle is from its lane coordinates, as beyond a lane's end, m.
        lane_heading: (m,) heading relative to the lane's, rad in (-pi, pi].
        leader, gap: (m,) row of the vehicle ahead, and bumper to bumper to it, m.
        follower: (m,) row of the nearest vehicle that has this one as its leader.
        stop_distance, signal_group: (m,) front bumper to the next junction entry, m, negative
            inside a junction, and the signal group that guards the entry.
        crossing, crossing_distance: (m,) the next crossing, and front bumper to its near edge, m.
    """

    lane: IntArray
    segment: IntArray
    missed: FloatArray
    lane_heading: FloatArray
    leader: IntArray
    gap: FloatArray
    follower: IntArray
    stop_distance: FloatArray
    signal_group: IntArray
    crossing: IntArray
    crossing_distance: FloatArray


def perceive(
    xy: FloatArray, heading: FloatArray, length: FloatArray, drives: BoolArray, lane: IntArray,
    s: FloatArray, offset: FloatArray, by_time: IntArray, begins: IntArray, graph: LaneGraph,
) -> LaneView:  # fmt: skip
    """Place vehicles on lanes; find their leaders and the stop lines and crossings ahead of them.

    The (m,) rows have (m, 2) centres, headings, lengths, whether they are vehicles, and lane
    coordinates as `LaneGraph.project` finds them. ``by_time`` are the rows in order of time,
    ``begins`` (T + 1,) where in it those of each time begin, and m.
    """
    there, segment = graph.placed(lane, s, offset)
    missed = np.hypot(*(xy - there).T)
    turned = np.pi - (np.pi - (heading - graph.segment_heading[segment])) % (2 * np.pi)
    on = drives & (np.abs(offset) <= graph.width[lane] / 2 + BESIDE_LANE_M) & (missed < OFF_END_M)
    on_lane = np.where(on, lane, -1)
    forward = np.where(np.abs(turned) < np.pi / 2, on_lane, -1)
    leaders, gaps = _search(by_time, begins, on_lane, s, length, forward[:, None], graph)
    leader, gap = leaders[:, 0], gaps[:, 0]
    follower, group, crossing = np.full((3, s.size), -1)
    stop, to_crossing = np.full((2, s.size), np.inf)
    _find_stops(
        forward, s + length / 2,
        (graph.internal, graph.signal, graph.length, graph.ahead),
        (graph.cross_first, graph.cross_id, graph.cross_s, graph.cross_exit_s),
        (stop, group, crossing, to_crossing),
    )  # fmt: skip
    behind = np.flatnonzero(leader >= 0)
    behind = behind[np.argsort(-gap[behind], kind="stable")]
    follower[leader[behind]] = behind  # the last one written, with the least gap, stays
    return LaneView(
        on_lane, segment, missed, turned, leader, gap, follower, stop, group, crossing, to_crossing
    )


def adjacent_vehicles(
    lane: IntArray, s: FloatArray, length: FloatArray, graph: LaneGraph
) -> tuple[IntArray, FloatArray]:
    """Find the vehicles ahead and behind on the lanes beside, at one instant.

    The (p,) vehicles have lanes, -1 for none, distances along them and lengths, m. The result are
    (p, 4) rows of those ahead and behind on the left, then on the right, or -1, and (p, 4) gaps
    bumper to bumper, m, or +inf.
    """
    left, right = (np.where(lane >= 0, side[lane], -1) for side in (graph.left, graph.right))
    begin = np.stack([left, left, right, right], axis=1)
    return _search(np.arange(lane.size), np.array([0, lane.size]), lane, s, length, begin, graph)


def _search(
    by_time: IntArray, begins: IntArray, lane: IntArray, s: FloatArray, length: FloatArray,
    begin: IntArray, graph: LaneGraph,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """(m, K) next vehicle on each of K lanes, ahead and behind in turn, and the gaps, m."""
    who, gap = np.full(begin.shape, -1), np.full(begin.shape, np.inf)
    lanes, at = lane[by_time], s[by_time]
    if begins.size > 2:
        lanes += np.repeat(np.arange(begins.size - 1) * (graph.length.size + 1), np.diff(begins))
    order = np.lexsort((at, lanes))
    rows = by_time[order]
    _find_neighbors(
        rows, lane[rows], at[order], begins, s, length, begin,
        (graph.length, graph.ahead, graph.behind), who, gap,
    )  # fmt: skip
    return who, gap


@in_place()
def next_vehicle(
    lanes: Any, at: Any, first: int, last: int, lane: Any, s: Any, forward: bool, lane_length: Any,
    onward: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """The first vehicle strictly ahead of (or behind) a place, along the lane and beyond.

    Vehicles are given by (m,) lanes and distances along them, in that order; those from ``first``
    to before ``last`` are looked at. The result is the place in that order or -1, and the distance
    between the centres, m, or +inf.
    """
    now, travelled, place = lane, 0.0, s
    for _ in range(MAX_LANES_AHEAD):
        if now < 0 or travelled > LOOK_AHEAD_M:
            break
        low, high = first, last
        while low < high:
            middle = (low + high) // 2
            before = lanes[middle] < now or (
                lanes[middle] == now and (at[middle] < place or (forward and at[middle] == place))
            )
            if before:
                low = middle + 1
            else:
                high = middle
        j = low if forward else low - 1
        if first <= j < last and lanes[j] == now:
            far = travelled + abs(at[j] - max(place, 0.0))
            if far <= LOOK_AHEAD_M:
                return j, far
            break
        if forward:
            travelled += lane_length[now] - max(place, 0.0)
            now, place = onward[now], -1e-9  # a vehicle that stands at the very start counts
        else:
            travelled += place
            now = onward[now]
            place = lane_length[now] if now >= 0 else 0.0
    return -1, np.inf


@in_place()
def _find_neighbors(
    rows: Any, lanes: Any, at: Any, begins: Any, s: Any, length: Any, begin: Any, road: Any,
    who: Any, gap: Any,
) -> None:  # fmt: skip
    """Find the next vehicles along K paths, among rows in order of time, lane and position."""
    lane_length, ahead, behind = road
    _, ways = begin.shape
    for t in range(begins.size - 1):
        for q in range(begins[t], begins[t + 1]):
            i = rows[q]
            for k in range(ways):
                forward = k % 2 == 0
                onward = ahead if forward else behind
                j, far = next_vehicle(
                    lanes, at, begins[t], begins[t + 1], begin[i, k], s[i], forward, lane_length,
                    onward,
                )  # fmt: skip
                if j >= 0:
                    who[i, k], gap[i, k] = rows[j], far - (length[i] + length[rows[j]]) / 2


@in_place()
def _find_stops(lane: Any, front: Any, lanes: Any, crossings: Any, out: Any) -> None:
    """Find the next junction entry and the next crossing; fills the four (m,) arrays of ``out``."""
    internal, signal, length, onward = lanes
    cross_first, cross_id, cross_s, cross_exit_s = crossings
    stop, group, crossing, to_crossing = out
    for i in range(lane.size):
        now, travelled = lane[i], -front[i]
        for hop in range(MAX_LANES_AHEAD):
            if now < 0 or travelled > LOOK_AHEAD_M:
                break
            if internal[now] and stop[i] == np.inf:
                stop[i] = travelled
                if hop > 0:
                    group[i] = signal[now]
            for z in range(cross_first[now], cross_first[now + 1]):
                if travelled + cross_exit_s[z] <= 0.0:
                    continue
                to = travelled + cross_s[z]
                if to < to_crossing[i]:
                    crossing[i], to_crossing[i] = cross_id[z], to
            travelled += length[now]
            now = onward[now]


@compiled
def along(line: Any, xy: Any) -> tuple[Any, Any, Any]:
    """Places (n, 2) in the coordinates of a line (P, 2) that goes on straight at both ends, m.

    Returns (n,) distances along it (negative before it, above its length after it), (n,) distances
    to its left, and its length.

    Examples:
        >>> u, left, total = along(np.array([[0.0, 0.0], [0.0, 8.0]]), np.array([[1.0, 9.0]]))
        >>> u.tolist(), left.tolist(), total
        ([9.0], [-1.0], 8.0)
    """
    n, begin = len(xy), 0.0
    u, left, nearest = np.zeros(n), np.zeros(n), np.full(n, np.inf)
    pieces = len(line) - 1
    for k in range(pieces):
        east, north = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
        size = np.hypot(east, north)
        east, north = east / size, north / size
        for i in range(n):
            dx, dy = xy[i, 0] - line[k, 0], xy[i, 1] - line[k, 1]
            forward, aside = dx * east + dy * north, east * dy - north * dx
            clipped = forward
            if k > 0:
                clipped = max(clipped, 0.0)
            if k < pieces - 1:
                clipped = min(clipped, size)
            away = np.hypot(aside, forward - clipped)
            if away < nearest[i]:
                nearest[i], u[i], left[i] = away, begin + clipped, aside
        begin += size
    return u, left, begin
