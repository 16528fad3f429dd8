"""Searches along lanes, compiled: who is ahead or behind, which stop lines and crossings come.

`sim.episode.observables` says what each observable means; here they are loops over plain arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled, in_place

if TYPE_CHECKING:
    from sim.road.lane_graph import LaneGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LOOK_AHEAD_M = 200.0
"""Leaders, signals and crossings farther than this are not seen (14 s at 14 m/s)."""

MAX_LANES_AHEAD = 8
"""How many lanes onward are searched at most: junction paths are short."""

BESIDE_LANE_M = 0.5
"""A vehicle whose centre is this far outside a lane still drives on it."""

OFF_END_M = 5.0
"""A vehicle this far beyond a lane's end is not on the lane."""


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


@in_place()
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


def perceive(
    xy: FloatArray, heading: FloatArray, length: FloatArray, drives: BoolArray, lane: IntArray,
    s: FloatArray, offset: FloatArray, by_time: IntArray, begins: IntArray, graph: LaneGraph,
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
        graph: the road.

    Returns:
        What each row sees.
    """
    m = s.size
    on_lane, forward, segment = np.full(m, -1), np.full(m, -1), np.empty(m, np.int64)
    missed, turned, front = np.empty(m), np.empty(m), np.empty(m)
    _place(
        xy, heading, length, drives, lane, s, offset,
        (
            graph.segment_first, graph.segment_last, graph.segment_at, graph.segment_start,
            graph.segment_direction, graph.segment_heading, graph.width,
        ),
        (on_lane, forward, segment, missed, turned, front),
    )  # fmt: skip
    leader, gap = _search(by_time, begins, on_lane, s, length, forward[:, None], graph)
    follower = np.full(m, -1)
    _find_followers(leader, gap, follower)
    group, crossing = np.full(m, -1), np.full(m, -1)
    stop, to_crossing = np.full(m, np.inf), np.full(m, np.inf)
    _find_stops(
        forward, front, graph.internal, graph.signal, graph.length, graph.ahead, graph.cross_first,
        graph.cross_id, graph.cross_s, graph.cross_exit_s, (stop, group, crossing, to_crossing),
    )  # fmt: skip
    return LaneView(
        on_lane,
        segment,
        missed,
        turned,
        leader[:, 0],
        gap[:, 0],
        follower,
        stop,
        group,
        crossing,
        to_crossing,
    )


def adjacent_vehicles(
    lane: IntArray, s: FloatArray, length: FloatArray, graph: LaneGraph
) -> tuple[IntArray, FloatArray]:
    """Who is ahead and behind on the lanes beside, at one instant.

    Args:
        lane: (p,) lane that each vehicle is on, -1: none.
        s: (p,) distance along it, m.
        length: (p,) m.
        graph: the road.

    Returns:
        (p, 4) rows of those ahead and behind on the left, then on the right, or -1, and (p, 4) gaps
        bumper to bumper, m, or +inf.
    """
    p = lane.size
    on_road = lane >= 0
    left, right = np.where(on_road, graph.left[lane], -1), np.where(on_road, graph.right[lane], -1)
    begin = np.stack([left, left, right, right], axis=1)
    return _search(np.arange(p), np.array([0, p]), lane, s, length, begin, graph)


def _search(
    by_time: IntArray, begins: IntArray, lane: IntArray, s: FloatArray, length: FloatArray,
    begin: IntArray, graph: LaneGraph,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Who is next along K ways from each vehicle, ahead on the first and third, else behind.

    Args:
        by_time: (m,) and the next as of `perceive`.
        begins: (T + 1,).
        lane: (m,) lane that each is on, -1: none.
        s: (m,) distance along it, m.
        length: (m,) m.
        begin: (m, K) lane on which each search begins beside the vehicle, -1: none.
        graph: the road.

    Returns:
        (m, K) rows or -1, and (m, K) gaps bumper to bumper, m, or +inf.
    """
    who, gap = np.full(begin.shape, -1), np.full(begin.shape, np.inf)
    most = int(np.diff(begins).max(initial=0))
    _find_neighbors(
        by_time, begins, lane, s, length, begin, (graph.length, graph.ahead, graph.behind),
        np.empty((3, most), np.int64), np.empty(most), who, gap,
    )  # fmt: skip
    return who, gap


@in_place()
def _place(
    xy: Any, heading: Any, length: Any, drives: Any, lane: Any, s: Any, offset: Any, segments: Any,
    out: Any,
) -> None:  # fmt: skip
    """Place vehicles on the straight pieces of their lanes.

    Args:
        xy: (m, 2) and the next six as of `perceive`.
        heading: (m,).
        length: (m,).
        drives: (m,).
        lane: (m,).
        s: (m,).
        offset: (m,).
        segments: the columns of a `sim.road.lane_graph.LaneGraph` that say where they are, and its
            lanes' widths.
        out: receives the (m,) lane, the lane if the vehicle drives along it, both -1 before, the
            piece, the distance from the lane coordinates, m, the heading relative to the lane's,
            rad, and the distance of the front bumper along it, m.
    """
    first, last, at, start, direction, segment_heading, width = segments
    on_lane, forward, segment, missed, turned, front = out
    for i in range(s.size):
        on = lane[i]
        g = first[on]
        while g < last[on] and at[g + 1] <= s[i]:
            g += 1
        ux, uy = direction[g, 0], direction[g, 1]
        along = s[i] - at[g]
        east = xy[i, 0] - (start[g, 0] + ux * along + offset[i] * -uy)
        north = xy[i, 1] - (start[g, 1] + uy * along + offset[i] * ux)
        relative = heading[i] - segment_heading[g]
        segment[i], missed[i] = g, np.hypot(east, north)
        turned[i] = np.pi - (np.pi - relative) % (2 * np.pi)
        front[i] = s[i] + length[i] / 2
        beside = abs(offset[i]) <= width[on] / 2 + BESIDE_LANE_M
        if drives[i] and beside and missed[i] < OFF_END_M:
            on_lane[i] = on
            if abs(turned[i]) < np.pi / 2:
                forward[i] = on


@in_place(inner=True)
def _sort(rows: Any, spare: Any, count: int, lane: Any, s: Any) -> None:
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
            while g > begin:
                before = rows[g - 1]
                earlier = lane[row] == lane[before] and s[row] < s[before]
                if not (lane[row] < lane[before] or earlier):
                    break
                rows[g] = before
                g -= 1
            rows[g] = row
    while run < count:
        for begin in range(0, count, 2 * run):
            middle, end = min(begin + run, count), min(begin + 2 * run, count)
            one, two = begin, middle
            for k in range(begin, end):
                second = one >= middle
                if one < middle and two < end:
                    i, j = rows[one], rows[two]
                    second = lane[j] < lane[i] or (lane[j] == lane[i] and s[j] < s[i])
                if second:
                    spare[k] = rows[two]
                    two += 1
                else:
                    spare[k] = rows[one]
                    one += 1
        for k in range(count):
            rows[k] = spare[k]
        run *= 2


@in_place()
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


@in_place()
def _find_neighbors(
    by_time: Any, begins: Any, lane: Any, s: Any, length: Any, begin: Any, road: Any, room: Any,
    at: Any, who: Any, gap: Any,
) -> None:  # fmt: skip
    """Find who is next along K ways.

    Args:
        by_time: (m,) and the next five as of `_search`.
        begins: (T + 1,).
        lane: (m,).
        s: (m,).
        length: (m,).
        begin: (m, K).
        road: (L,) lengths of the lanes, m, and the lanes ahead and behind, -1: none.
        room: (3, p) room to work in, for as many as there are at one time.
        at: (p,) likewise.
        who: (m, K) receives the rows; must be -1 before.
        gap: (m, K) receives the gaps, m; must be +inf before.
    """
    lane_length, ahead, behind = road
    rows, spare, lanes = room[0], room[1], room[2]
    _, ways = begin.shape
    for t in range(begins.size - 1):
        count = 0 * begins.size  # not the literal 0: searches would be compiled once more for it
        for j in range(begins[t], begins[t + 1]):
            i = by_time[j]
            if lane[i] >= 0:
                rows[count] = i
                count += 1
        _sort(rows, spare, count, lane, s)
        for j in range(count):
            lanes[j], at[j] = lane[rows[j]], s[rows[j]]
        for q in range(begins[t], begins[t + 1]):
            i = by_time[q]
            for k in range(ways):
                forward = k % 2 == 0
                onward = ahead if forward else behind
                j, far = next_vehicle(
                    lanes, at, count, begin[i, k], s[i], forward, lane_length, onward
                )
                if j >= 0:
                    who[i, k], gap[i, k] = rows[j], far - (length[i] + length[rows[j]]) / 2


@in_place()
def _find_followers(leader: Any, gap: Any, follower: Any) -> None:
    """Find who is nearest behind each; of several at the same distance the last.

    Args:
        leader: (m, 1) the vehicle ahead of each, or -1.
        gap: (m, 1) the gap to it, m.
        follower: (m,) receives them; must be -1 before.
    """
    for i in range(follower.size):
        ahead = leader[i, 0]
        if ahead >= 0 and (follower[ahead] < 0 or gap[i, 0] <= gap[follower[ahead], 0]):
            follower[ahead] = i


@in_place()
def _find_stops(
    lane: Any, front: Any, internal: Any, signal: Any, length: Any, onward: Any, cross_first: Any,
    cross_id: Any, cross_s: Any, cross_exit_s: Any, out: Any,
) -> None:  # fmt: skip
    """Find the next junction entry and the next crossing of vehicles.

    Args:
        lane: (m,) lane along which each drives, -1: none.
        front: (m,) distance of the front bumper along it, m.
        internal: (L,) and the next seven: columns of the `sim.road.lane_graph.LaneGraph`.
        signal: (L,).
        length: (L,).
        onward: (L,) its ``ahead``.
        cross_first: (L + 1,).
        cross_id: (Z,).
        cross_s: (Z,).
        cross_exit_s: (Z,).
        out: receives the (m,) distance to the junction entry, m, negative inside one, +inf before;
            its signal group and the crossing, -1 before; and the distance to its near edge, m,
            +inf before.
    """
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
