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
from sim.compiled import in_place
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph, project
from sim.road.lane_search import adjacent_vehicles, perceive

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

PAST_EVERY_S: Final = 1.0
"""Time between the moments of the past from which wished speeds are estimated, s."""

RECENT_S = 0.5
"""Time over which the present acceleration and lateral speed are measured, s (shorter is noise)."""

NEAR_LANE_M = 1.0
"""A vehicle this far outside a lane still drives along it."""

BEYOND_M = 2.0
"""A vehicle this far beyond a lane's end still drives along it."""

CHANGING_MPS = 0.25
"""A vehicle with a higher lateral speed is changing lanes (a change of 3.2 m takes 3 to 6 s, and
drivers who keep their lane drift at less than 0.2 m/s)."""

CHANGING_FROM_M = 0.3
"""A vehicle this far on the other side of its lane's centre is returning to the centre instead."""

FREE_HEADWAY_S, FREE_GAP_M, STEADY_MPS2 = 4.0, 40.0, 0.4
"""A driver drives freely with this headway, this distance to anything ahead and at most this
acceleration (HCM calls a headway over 3 to 4 s free)."""


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
    begins = np.searchsorted(instant, np.arange(columns.size + 1))
    column = columns[instant]
    past_xy, past_heading = xy[agent, column], heading[agent, column]
    past_length = history.length[agent]
    found = project(road, past_xy, past_heading)
    view = perceive(
        past_xy, past_heading, past_length, np.ones(agent.size, np.bool_), found.lane, found.s,
        found.offset, np.arange(agent.size), begins, graph,
    )  # fmt: skip
    n, limit = len(valid), limits(graph)
    free, least = np.full(n, np.nan), np.zeros(n)
    _find_wished_speeds(
        history.time_s, valid, speed, columns, (instant, agent, found.lane),
        (view.lane, view.gap, view.stop_distance, view.crossing_distance), limit, np.zeros((2, n)),
        free, least,
    )  # fmt: skip
    now = begins[-2]
    adjacent, adjacent_gap = adjacent_vehicles(
        view.lane[now:], found.s[now:], past_length[now:], graph
    )
    states = AgentStates(
        lane=np.full(n, -1), s=np.zeros(n), offset=np.zeros(n), lateral_speed=np.zeros(n),
        accel=np.zeros(n), free_factor=free, least_factor=least, on_lane=np.full(n, -1),
        limit=np.full(n, np.nan), leader=np.full(n, -1), gap=np.full(n, np.inf),
        follower=np.full(n, -1), adjacent=np.full((n, 4), -1), adjacent_gap=np.full((n, 4), np.inf),
    )  # fmt: skip
    since = np.zeros(n, np.int64)
    _measure_accelerations(history.time_s, valid, speed, since, states.accel)
    _describe_present(
        now, (agent, found.lane, found.s, found.offset, past_xy),
        (
            view.lane, view.segment, view.missed, view.lane_heading, view.leader, view.gap,
            view.follower,
        ),
        (adjacent, adjacent_gap), (history.time_s, since, xy),
        (graph.width, graph.left, graph.right, graph.segment_direction, limit),
        (states.lane, states.s, states.offset, states.lateral_speed),
        (
            states.on_lane, states.limit, states.leader, states.gap, states.follower,
            states.adjacent, states.adjacent_gap,
        ),
    )  # fmt: skip
    return states


def present_acceleration(history: Tracks) -> FloatArray:
    """(n,) accelerations over the last `RECENT_S` of a history, m/s2; 0 where unknown."""
    n = history.ids.size
    valid, speed = np.ascontiguousarray(history.valid), np.ascontiguousarray(history.speed)
    accel = np.zeros(n)
    _measure_accelerations(history.time_s, valid, speed, np.zeros(n, np.int64), accel)
    return accel


@in_place()
def _measure_accelerations(time_s: Any, valid: Any, speed: Any, since: Any, accel: Any) -> None:
    """Measure the present accelerations over the last `RECENT_S`."""
    last = time_s.size - 1
    begin = last
    while begin > 0 and time_s[last] - time_s[begin - 1] <= RECENT_S + 1e-6:
        begin -= 1
    for i in range(len(valid)):
        if not valid[i, last]:
            continue
        first = begin
        while not valid[i, first]:
            first += 1
        since[i], span = first, time_s[last] - time_s[first]
        if span > 1e-6:
            accel[i] = (speed[i, last] - speed[i, first]) / span


@in_place()
def _find_wished_speeds(
    time_s: Any, valid: Any, speed: Any, columns: Any, rows: Any, view: Any, limit: Any, sums: Any,
    free: Any, least: Any,
) -> None:  # fmt: skip
    """Find how fast drivers were seen driving."""
    moment, agent, lane = rows
    on_lane, gap, stop, crossing = view
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
        room = min(min(gap[j] / clear * FREE_GAP_M, stop[j]), crossing[j])
        if room > FREE_GAP_M and abs(change) < STEADY_MPS2:
            sums[0, i] += ratio
            sums[1, i] += 1.0
    for i in range(free.size):
        if sums[1, i] > 0.0:
            free[i] = sums[0, i] / sums[1, i]


@in_place()
def _describe_present(
    now: int, found: Any, view: Any, beside: Any, history: Any, road: Any, place: Any, around: Any
) -> None:
    """Write what was found of the vehicles that are seen at present."""
    agent, row_lane, row_s, row_offset, row_xy = found
    seen_lane, segment, missed, turned, seen_leader, seen_gap, seen_follower = view
    beside_row, beside_gap = beside
    time_s, since, xy = history
    width, left, right, direction, limit = road
    lane, s, offset, lateral_speed = place
    on_lane, lane_limit, leader, gap, follower, adjacent, adjacent_gap = around
    for j in range(now, agent.size):
        i, on = agent[j], row_lane[j]
        s[i], offset[i] = row_s[j], row_offset[j]
        if seen_lane[j] >= 0:
            on_lane[i], lane_limit[i] = on, limit[on]
        if seen_leader[j] >= 0:
            leader[i], gap[i] = agent[seen_leader[j]], seen_gap[j]
        if seen_follower[j] >= 0:
            follower[i] = agent[seen_follower[j]]
        for k in range(4):
            if beside_row[j - now, k] >= 0:
                adjacent[i, k] = agent[now + beside_row[j - now, k]]
                adjacent_gap[i, k] = beside_gap[j - now, k]
        first = since[i]
        span, sideways = time_s[time_s.size - 1] - time_s[first], 0.0
        if span > 1e-6:
            g = segment[j]
            ux, uy = direction[g, 0], direction[g, 1]
            east, north = row_xy[j, 0] - xy[i, first, 0], row_xy[j, 1] - xy[i, first, 1]
            sideways = (north * ux - east * uy) / span
            lateral_speed[i] = sideways
        outside = abs(offset[i]) > width[on] / 2 + NEAR_LANE_M
        if outside or missed[j] >= BEYOND_M or math.cos(turned[j]) <= 0.5:
            continue
        lane[i] = on
        for side in range(2):
            to, sign = left[on], 1.0
            if side == 1:
                to, sign = right[on], -1.0
            going = to >= 0 and sign * sideways > CHANGING_MPS
            if going and sign * row_offset[j] > -CHANGING_FROM_M:
                lane[i] = to
                offset[i] = row_offset[j] - sign * (width[on] + width[to]) / 2
