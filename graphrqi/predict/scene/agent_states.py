"""What a history says about each agent at present: its place, its motion, its neighbours.

Lanes, leaders and stop lines are found by the search that `sim.episode.observables` uses
(`sim.road.lane_search.perceive`), at the present and at a few moments of the past, from which the
speed that each driver wishes to drive is estimated.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.scene.paths import limits
from sim.compiled import compiled, inner
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph, project
from sim.road.lane_search import LaneArrays, adjacent_vehicles, perceive

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

PAST_EVERY_S: Final = 1.0
"""Time between the moments of the past from which wished speeds are estimated, s (our choice)."""

RECENT_S = 0.5
"""Time over which the present acceleration and lateral speed are measured, s (our choice: shorter
is noise)."""

NEAR_LANE_M = 1.0
"""A vehicle this far outside a lane still drives along it (our choice)."""

BEYOND_M = 2.0
"""A vehicle this far beyond a lane's end still drives along it (our choice)."""

CHANGING_MPS = 0.25
"""A vehicle with a higher lateral speed is changing lanes (our choice; a change of 3.2 m takes 3 to
6 s, and drivers who keep their lane drift at less than 0.2 m/s)."""

CHANGING_FROM_M = 0.3
"""A vehicle this far on the other side of its lane's centre is returning to the centre instead (our
choice)."""

FREE_HEADWAY_S, FREE_GAP_M, STEADY_MPS2 = 4.0, 40.0, 0.4
"""A driver drives freely with this headway, this distance to anything ahead and at most this
acceleration (our choice; HCM calls a headway over 3 to 4 s free)."""


class AgentStates(NamedTuple):
    """The agents of a history at its last moment; pedestrians are on no lane and have no leader.

    Attributes:
        lane: (n,) lane that each drives along or is changing to, -1 off the road.
        s: (n,) distance along it, m.
        offset: (n,) distance to the left of its centre line, m.
        lateral_speed: (n,) speed to the left over the last half second, m/s.
        accel: (n,) acceleration over the last half second, m/s2; 0 where unknown.
        free_factor: (n,) mean speed over limit while driving steadily with nothing ahead; NaN if
            that was never seen.
        least_factor: (n,) largest speed over limit seen: the driver wishes at least this.
        on_lane: (n,) lane that each is on, -1 off the road.
        limit: (n,) its speed limit, m/s; NaN off the road.
        leader: (n,) row of the vehicle ahead, -1 if none.
        gap: (n,) bumper to bumper to it, m; +inf if none.
        follower: (n,) row of the nearest vehicle that has this one as its leader, -1 if none.
        adjacent: (n, 4) rows of those ahead and behind on the lane to the left, and to the right.
        adjacent_gap: (n, 4) bumper to bumper to them, m.
    """

    lane: IntArray
    s: FloatArray
    offset: FloatArray
    lateral_speed: FloatArray
    accel: FloatArray
    free_factor: FloatArray
    least_factor: FloatArray
    on_lane: IntArray
    limit: FloatArray
    leader: IntArray
    gap: FloatArray
    follower: IntArray
    adjacent: IntArray
    adjacent_gap: FloatArray


def agent_states(history: Tracks, road: Road) -> AgentStates:
    """The states of a history's agents; agents not seen in its last column are on no lane."""
    graph = LaneGraph.of(road)
    ago = np.arange(0.0, np.ptp(history.time_s) + 1e-6, PAST_EVERY_S)[::-1]
    columns = np.searchsorted(history.time_s, history.time_s[-1] - ago - 1e-6)
    drives = history.kind != PEDESTRIAN
    # copies and contiguous arrays: kernels are compiled again for strided or read-only ones
    valid, xy = np.ascontiguousarray(history.valid), np.ascontiguousarray(history.xy)
    heading, speed = np.ascontiguousarray(history.heading), np.ascontiguousarray(history.speed)
    instant, agent = (x.copy() for x in np.nonzero((valid[:, columns] & drives[:, None]).T))
    column = columns[instant]
    found = project(road, xy[agent, column], heading[agent, column])
    return AgentStates(
        *_states(
            history.time_s, valid, xy, heading, speed, history.length.copy(), columns, instant,
            agent, (found.lane, found.s, found.offset, np.arange(agent.size),
            np.ones(agent.size, np.bool_)), limits(graph), LaneArrays.of(graph),
        )
    )  # fmt: skip


@inner
def _recent_motion(time_s: Any, valid: Any, speed: Any, i: int) -> tuple[float, int, float]:
    """Acceleration, m/s2, over the last `RECENT_S`, its first column and its duration, s."""
    first = time_s.size - 1
    while first > 0 and time_s[-1] - time_s[first - 1] <= RECENT_S + 1e-6:
        first -= 1
    while not valid[i, first]:
        first += 1
    span = time_s[-1] - time_s[first]
    change = (speed[i, -1] - speed[i, first]) / span if span > 1e-6 else 0.0
    return change, first, span


@inner
def _wished_speeds(
    time_s: Any, valid: Any, speed: Any, columns: Any, moment: Any, agent: Any, lane: Any,
    view: Any, limit: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """(n,) mean speed over limit while driving freely, or NaN, and (n,) the largest seen."""
    on_lane, gap, stop, crossing = (
        view.lane, view.gap, view.stop_distance, view.crossing_distance
    )  # fmt: skip
    n = len(valid)
    total, count = np.empty(n), np.empty(n)
    free, least = np.empty(n), np.empty(n)
    for i in range(n):
        total[i], count[i], free[i], least[i] = 0.0, 0.0, np.nan, 0.0
    for j in range(agent.size):
        if on_lane[j] < 0:
            continue
        i, now = agent[j], moment[j]
        t = columns[now]
        ratio = speed[i, t] / limit[lane[j]]
        least[i] = max(least[i], ratio)
        if now == 0 or not valid[i, columns[now - 1]]:
            continue
        before = columns[now - 1]
        change = (speed[i, t] - speed[i, before]) / (time_s[t] - time_s[before])
        clear = max(FREE_HEADWAY_S * speed[i, t], FREE_GAP_M)
        room = min(gap[j] / clear * FREE_GAP_M, stop[j], crossing[j])
        if room > FREE_GAP_M and abs(change) < STEADY_MPS2:
            total[i] += ratio
            count[i] += 1.0
    for i in range(n):
        if count[i] > 0:
            free[i] = total[i] / count[i]
    return free, least


@compiled
def _states(
    time_s: Any, valid: Any, past_xy: Any, past_heading: Any, speed: Any, its_length: Any,
    columns: Any, instant: Any, agent: Any, found: Any, limit: Any, road: Any,
) -> Any:  # fmt: skip
    """The columns of `AgentStates`.

    Args:
        time_s: (T,) and the next five: the history, as in `sim.frames.Tracks`.
        valid: (n, T).
        past_xy: (n, T, 2).
        past_heading: (n, T).
        speed: (n, T).
        its_length: (n,).
        columns: (C,) the moments that are looked at, ascending; the last is the present.
        instant: (m,) moment of each vehicle seen, ascending.
        agent: (m,) its row in the history.
        found: (m,) the lane that fits it best, the distance along it and to its left, m; 0 to
            m - 1; and true, for each drives.
        limit: (L,) speed limits, m/s.
        road: the `LaneArrays`.
    """
    row_lane, row_s, row_offset, by_time, drives = found
    width, left, right = road.width, road.left, road.right
    direction = road.segment_direction
    n, m = its_length.size, agent.size
    begins = np.empty(columns.size + 1, np.int64)
    for c in range(begins.size):  # no np.zeros or np.full: each takes long to compile
        begins[c] = 0
    for j in range(m):
        begins[instant[j] + 1] = j + 1
    for c in range(columns.size):  # a moment at which nobody was seen has no rows
        begins[c + 1] = max(begins[c + 1], begins[c])
    xy, heading, length = np.empty((m, 2)), np.empty(m), np.empty(m)
    for j in range(m):
        i, t = agent[j], columns[instant[j]]
        xy[j, 0], xy[j, 1] = past_xy[i, t, 0], past_xy[i, t, 1]
        heading[j], length[j] = past_heading[i, t], its_length[i]
    view = perceive(
        xy, heading, length, drives, row_lane, row_s, row_offset, by_time, begins, road,
    )  # fmt: skip

    seen_lane, seen_leader, seen_gap = view.lane, view.leader, view.gap
    seen_follower, segment, missed, turned = (
        view.follower, view.segment, view.missed, view.lane_heading
    )  # fmt: skip
    lane, s, offset = np.empty(n, np.int64), np.empty(n), np.empty(n)
    lateral_speed, accel = np.empty(n), np.empty(n)
    on_lane, lane_limit = np.empty(n, np.int64), np.empty(n)
    leader, gap, follower = np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64)
    adjacent, adjacent_gap = np.empty((n, 4), np.int64), np.empty((n, 4))
    for i in range(n):
        lane[i], on_lane[i], leader[i], follower[i] = -1, -1, -1, -1
        s[i], offset[i], lateral_speed[i], accel[i] = 0.0, 0.0, 0.0, 0.0
        lane_limit[i], gap[i] = np.nan, np.inf
        for k in range(4):
            adjacent[i, k], adjacent_gap[i, k] = -1, np.inf
        if valid[i, -1]:  # pedestrians too have an acceleration
            accel[i] = _recent_motion(time_s, valid, speed, i)[0]
    present = begins[-2]
    beside, beside_gap = adjacent_vehicles(
        seen_lane[present:], row_s[present:], length[present:], road
    )
    for j in range(present, m):
        i, on = agent[j], row_lane[j]
        s[i], offset[i] = row_s[j], row_offset[j]
        if seen_lane[j] >= 0:
            on_lane[i], lane_limit[i] = on, limit[on]
        if seen_leader[j] >= 0:
            leader[i], gap[i] = agent[seen_leader[j]], seen_gap[j]
        if seen_follower[j] >= 0:
            follower[i] = agent[seen_follower[j]]
        for k in range(4):
            if beside[j - present, k] >= 0:
                adjacent[i, k] = agent[present + beside[j - present, k]]
                adjacent_gap[i, k] = beside_gap[j - present, k]
        _, first, span = _recent_motion(time_s, valid, speed, i)
        if span > 1e-6:
            ux, uy = direction[segment[j], 0], direction[segment[j], 1]
            east, north = xy[j, 0] - past_xy[i, first, 0], xy[j, 1] - past_xy[i, first, 1]
            lateral_speed[i] = (north * ux - east * uy) / span
        outside = abs(offset[i]) > width[on] / 2 + NEAR_LANE_M
        if outside or missed[j] >= BEYOND_M or math.cos(turned[j]) <= 0.5:
            continue
        lane[i] = on
        for sign in (1.0, -1.0):
            to = left[on] if sign > 0 else right[on]
            going = sign * lateral_speed[i] > CHANGING_MPS
            if to >= 0 and going and sign * row_offset[j] > -CHANGING_FROM_M:
                lane[i] = to
                offset[i] = row_offset[j] - sign * (width[on] + width[to]) / 2
    free, least = _wished_speeds(
        time_s, valid, speed, columns, instant, agent, row_lane, view, limit
    )
    return (
        lane, s, offset, lateral_speed, accel, free, least, on_lane, lane_limit, leader, gap,
        follower, adjacent, adjacent_gap,
    )  # fmt: skip
