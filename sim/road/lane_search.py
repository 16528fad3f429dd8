"""Searches along lanes, compiled: who is ahead or behind, which stop lines and crossings come.

`sim.episode.observables` says what each observable means; here they are loops over plain arrays.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled, inner

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LOOK_AHEAD_M = 200.0
"""Leaders, signals and crossings farther than this are not seen (our choice: 14 s at 14 m/s)."""

MAX_LANES_AHEAD = 8
"""How many lanes onward are searched at most: junction paths are short (our choice)."""

BESIDE_LANE_M = 0.5
"""A vehicle whose centre is this far outside a lane still drives on it (our choice)."""

OFF_END_M = 5.0
"""A vehicle this far beyond a lane's end is not on the lane (our choice)."""


class LaneArrays(NamedTuple):
    """The columns of a `sim.road.lane_graph.LaneGraph` that the searches read; see there."""

    length: FloatArray
    width: FloatArray
    internal: BoolArray
    signal: IntArray
    ahead: IntArray
    behind: IntArray
    left: IntArray
    right: IntArray
    cross_first: IntArray
    cross_id: IntArray
    cross_s: FloatArray
    cross_exit_s: FloatArray
    segment_start: FloatArray
    segment_direction: FloatArray
    segment_heading: FloatArray
    segment_at: FloatArray
    segment_first: IntArray
    segment_last: IntArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(graph: Any) -> LaneArrays:
        """The columns of a `sim.road.lane_graph.LaneGraph`, gathered once."""
        return LaneArrays(*(getattr(graph, name) for name in LaneArrays._fields))


class LaneView(NamedTuple):
    """What m rows of vehicles see along their lanes; distances are +inf and indices -1 for none.

    Attributes:
        lane: (m,) lane that the vehicle's centre is on.
        segment: (m,) straight piece of centre line beside it.
        missed: (m,) how far the vehicle is from its lane coordinates, as beyond a lane's end, m.
        lane_heading: (m,) heading relative to the lane's, rad in (-pi, pi].
        leader: (m,) row of the vehicle ahead.
        gap: (m,) bumper to bumper to the leader, m.
        follower: (m,) row of the nearest vehicle that has this one as its leader.
        stop_distance: (m,) front bumper to the next junction entry, m; negative inside a junction.
        signal_group: (m,) signal group that guards the entry.
        crossing: (m,) the next crossing.
        crossing_distance: (m,) front bumper to its near edge, m.
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


@compiled
def along_at(line: Any, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """`along` of one place (x, y)."""
    begin, nearest, found, left = 0.0, np.inf, 0.0, 0.0
    pieces = len(line) - 1
    for k in range(pieces):
        east, north = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
        size = np.hypot(east, north)
        east, north = east / size, north / size
        dx, dy = x - line[k, 0], y - line[k, 1]
        forward, aside = dx * east + dy * north, east * dy - north * dx
        clipped = forward
        if k > 0:
            clipped = max(clipped, 0.0)
        if k < pieces - 1:
            clipped = min(clipped, size)
        away = np.hypot(aside, forward - clipped)
        if away < nearest:
            nearest, found, left = away, begin + clipped, aside
        begin += size
    return found, left, begin


@compiled
def along(line: Any, xy: Any) -> tuple[Any, Any, Any]:
    """Places in the coordinates of a line that goes on straight at both ends.

    Args:
        line: (P, 2) points, m.
        xy: (n, 2) places, m.

    Returns:
        (n,) distance along it, m (negative before it, above its length after it), (n,) distance to
        its left, m, and its length, m.

    Examples:
        >>> u, left, total = along(np.array([[0.0, 0.0], [0.0, 8.0]]), np.array([[1.0, 9.0]]))
        >>> u.tolist(), left.tolist(), total
        ([9.0], [-1.0], 8.0)
    """
    n, total = len(xy), 0.0
    u, left = np.empty(n), np.empty(n)
    for i in range(n):
        u[i], left[i], total = along_at(line, xy[i, 0], xy[i, 1])
    if n == 0:
        _, _, total = along_at(line, 0.0, 0.0)
    return u, left, total


@inner
def _before(lane: Any, s: Any, one: Any, other: Any) -> Any:
    """Whether a vehicle comes before another: by lane, then by place along it."""
    return lane[one] < lane[other] or (lane[one] == lane[other] and s[one] < s[other])


@inner
def _in_order(rows: Any, spare: Any, count: int, lane: Any, s: Any) -> None:
    """Sort the first ``count`` of ``rows`` by lane, then place; equals stay as they are.

    Runs of sixteen are sorted by insertion and then merged (von Neumann's merge sort).

    Args:
        rows: (n,) rows of vehicles, sorted in place.
        spare: (n,) room to work in.
        count: how many of them count.
        lane: (m,) lane of each row.
        s: (m,) distance along it, m.
    """
    run = 16
    for begin in range(0, count, run):
        for k in range(begin + 1, min(begin + run, count)):
            row, g = rows[k], k
            while g > begin and _before(lane, s, row, rows[g - 1]):
                rows[g] = rows[g - 1]
                g -= 1
            rows[g] = row
    while run < count:
        for begin in range(0, count, 2 * run):
            middle, end = min(begin + run, count), min(begin + 2 * run, count)
            one, two = begin, middle
            for k in range(begin, end):
                second = one >= middle or (two < end and _before(lane, s, rows[two], rows[one]))
                if second:
                    spare[k] = rows[two]
                    two += 1
                else:
                    spare[k] = rows[one]
                    one += 1
        for k in range(count):
            rows[k] = spare[k]
        run *= 2


@compiled
def next_vehicle(
    lanes: Any, at: Any, count: int, lane: Any, s: Any, forward: bool, lane_length: Any,
    onward: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """The first vehicle strictly ahead of (or behind) a place, along the lane and beyond.

    Args:
        lanes: (m,) lane of each vehicle, in order of lane, then of place.
        at: (m,) distance along it, m.
        count: how many of them there are.
        lane: where the search begins, -1: nowhere.
        s: distance along the lane, m.
        forward: whether to look ahead.
        lane_length: (L,) m.
        onward: (L,) the lane after (or before) each, -1: none.

    Returns:
        Its place in the order or -1, and the distance between the centres, m, or +inf.
    """
    now, travelled, place = lane, 0.0, s
    for _ in range(MAX_LANES_AHEAD):
        if now < 0 or travelled > LOOK_AHEAD_M:
            break
        low, high = 0, count
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
        if 0 <= j < count and lanes[j] == now:
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


@inner
def _leaders(
    by_time: Any, begins: Any, lane: Any, forward: Any, s: Any, road: Any
) -> tuple[Any, Any]:
    """(m,) rows of the vehicles ahead or -1, and (m,) distances between centres, m, or +inf."""
    m = by_time.size
    found, distance = np.empty(m, np.int64), np.empty(m)
    for i in range(m):
        found[i], distance[i] = -1, np.inf
    most = 0
    for t in range(begins.size - 1):
        most = max(most, begins[t + 1] - begins[t])
    rows, lanes, at = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    spare = np.empty(most, np.int64)
    length, onward = road.length, road.ahead
    ahead = m >= 0  # not the literal True: searches would be compiled once more for literals
    for t in range(begins.size - 1):
        count = 0 * m  # not the literal 0
        for j in range(begins[t], begins[t + 1]):
            i = by_time[j]
            if lane[i] >= 0:
                rows[count] = i
                count += 1
        _in_order(rows, spare, count, lane, s)
        for j in range(count):
            lanes[j], at[j] = lane[rows[j]], s[rows[j]]
        for q in range(begins[t], begins[t + 1]):
            i = by_time[q]
            j, far = next_vehicle(lanes, at, count, forward[i], s[i], ahead, length, onward)
            if j >= 0:
                found[i], distance[i] = rows[j], far
    return found, distance


@inner
def _followers(leader: Any, gap: Any) -> Any:
    """(m,) who is nearest behind each, or -1; of several at the same distance the last."""
    follower = np.empty(leader.size, np.int64)
    for i in range(leader.size):
        follower[i] = -1
    for i in range(leader.size):
        ahead = leader[i]
        if ahead >= 0 and (follower[ahead] < 0 or gap[i] <= gap[follower[ahead]]):
            follower[ahead] = i
    return follower


@inner
def _stops_ahead(lane: Any, front: Any, road: Any) -> tuple[Any, Any, Any, Any]:
    """The next junction entry and the next crossing of vehicles.

    Args:
        lane: (m,) lane along which each drives, -1: none.
        front: (m,) distance of the front bumper along it, m.
        road: the `LaneArrays`.

    Returns:
        (m,) each: distance to the junction entry, m, negative inside one, +inf if none; its signal
        group or -1; the crossing or -1; distance to its near edge, m, or +inf.
    """
    internal, signal, length, onward = road.internal, road.signal, road.length, road.ahead
    cross_first, cross_id = road.cross_first, road.cross_id
    cross_s, cross_exit_s = road.cross_s, road.cross_exit_s
    m = lane.size
    stop, to_crossing = np.empty(m), np.empty(m)
    group, crossing = np.empty(m, np.int64), np.empty(m, np.int64)
    for i in range(m):
        stop[i], to_crossing[i] = np.inf, np.inf
        group[i], crossing[i] = -1, -1
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
    return stop, group, crossing, to_crossing


@compiled
def perceive(
    xy: Any, heading: Any, length: Any, drives: Any, lane: Any, s: Any, offset: Any, by_time: Any,
    begins: Any, road: Any,
) -> LaneView:  # fmt: skip
    """Place vehicles on lanes; find their leaders and the stop lines and crossings ahead of them.

    Args:
        xy: (m, 2) centres, m.
        heading: (m,) rad.
        length: (m,) m.
        drives: (m,) whether the row is a vehicle's; the others are on no lane.
        lane: (m,) lane that fits best, as `Road.project` finds it.
        s: (m,) distance along it, m.
        offset: (m,) distance to its left, m.
        by_time: (m,) the rows in order of time.
        begins: (T + 1,) where in ``by_time`` those of each time begin, and m.
        road: the `LaneArrays`.

    Returns:
        What each row sees.
    """
    first, last, at = road.segment_first, road.segment_last, road.segment_at
    start, direction = road.segment_start, road.segment_direction
    segment_heading, width = road.segment_heading, road.width
    m = s.size
    on_lane, forward = np.empty(m, np.int64), np.empty(m, np.int64)
    segment, missed = np.empty(m, np.int64), np.empty(m)
    lane_heading, front = np.empty(m), np.empty(m)
    for i in range(m):
        on_lane[i], forward[i] = -1, -1
        on = lane[i]
        g = first[on]
        while g < last[on] and at[g + 1] <= s[i]:
            g += 1
        ux, uy = direction[g, 0], direction[g, 1]
        along = s[i] - at[g]
        east = xy[i, 0] - (start[g, 0] + ux * along + offset[i] * -uy)
        north = xy[i, 1] - (start[g, 1] + uy * along + offset[i] * ux)
        turned = heading[i] - segment_heading[g]
        segment[i], missed[i] = g, np.hypot(east, north)
        lane_heading[i] = np.pi - (np.pi - turned) % (2 * np.pi)
        front[i] = s[i] + length[i] / 2
        beside = abs(offset[i]) <= width[on] / 2 + BESIDE_LANE_M
        if drives[i] and beside and missed[i] < OFF_END_M:
            on_lane[i] = on
            if abs(lane_heading[i]) < np.pi / 2:
                forward[i] = on
    leader, distance = _leaders(by_time, begins, on_lane, forward, s, road)
    gap = np.empty(m)
    for i in range(m):
        gap[i] = np.inf
        if leader[i] >= 0:
            gap[i] = distance[i] - (length[i] + length[leader[i]]) / 2
    stop, group, crossing, to_crossing = _stops_ahead(forward, front, road)
    return LaneView(
        on_lane, segment, missed, lane_heading, leader, gap, _followers(leader, gap), stop, group,
        crossing, to_crossing,
    )  # fmt: skip


@compiled
def adjacent_vehicles(lane: Any, s: Any, length: Any, road: Any) -> tuple[Any, Any]:
    """Who is ahead and behind on the lanes beside, at one instant.

    Args:
        lane: (p,) lane that each vehicle is on, -1: none.
        s: (p,) distance along it, m.
        length: (p,) m.
        road: the `LaneArrays`.

    Returns:
        (p, 4) rows of those ahead and behind on the left, then on the right, or -1, and (p, 4) gaps
        bumper to bumper, m, or +inf.
    """
    p = lane.size
    count = 0 * p  # not the literal 0, for which the search would be compiled once more
    who, gap = np.empty((p, 4), np.int64), np.empty((p, 4))
    rows, lanes, at = np.empty(p, np.int64), np.empty(p, np.int64), np.empty(p)
    spare = np.empty(p, np.int64)
    left, right, ahead, behind = road.left, road.right, road.ahead, road.behind
    for i in range(p):
        if lane[i] >= 0:
            rows[count] = i
            count += 1
    _in_order(rows, spare, count, lane, s)
    for j in range(count):
        lanes[j], at[j] = lane[rows[j]], s[rows[j]]
    for i in range(p):
        for k in range(4):
            who[i, k], gap[i, k] = -1, np.inf
        if lane[i] < 0:
            continue
        for k in range(4):
            beside = left[lane[i]] if k < 2 else right[lane[i]]
            forward = k % 2 == 0
            onward = ahead if forward else behind
            j, far = next_vehicle(lanes, at, count, beside, s[i], forward, road.length, onward)
            if j >= 0:
                who[i, k], gap[i, k] = rows[j], far - (length[i] + length[rows[j]]) / 2
    return who, gap
