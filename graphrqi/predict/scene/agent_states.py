"""The state of each agent at the end of a history: its position, its motion, its neighbours.

Lanes, leaders and stop lines are found by `sim.road.lane_search.perceive`, at the present and at
several moments of the past. The past ones give an estimate of each driver's desired speed.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray, IntArray
from graphrqi.predict.scene.paths import limits
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.road.lane_search import LaneView, adjacent_vehicles, perceive

PAST_EVERY_S: Final = 1.0
"""Time between the moments of the past from which wished speeds are estimated, s."""

RECENT_S = 0.5
"""Time over which the present acceleration and lateral speed are measured, s (shorter is noise)."""

NEAR_LANE_M = 1.0
"""A vehicle this far outside a lane still drives along it."""

BEYOND_M = 2.0
"""A vehicle this far beyond a lane's end still drives along it."""

CHANGING_MPS = 0.25
"""A vehicle with a higher lateral speed is changing lanes."""

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
    # copies: kernels are compiled again for strided or read-only arrays
    instant, agent = (x.copy() for x in np.nonzero((history.valid[:, columns] & drives[:, None]).T))
    begins = np.searchsorted(instant, np.arange(columns.size + 1))
    column = columns[instant]
    past_xy, past_heading = history.xy[agent, column], history.heading[agent, column]
    past_length = history.length[agent]
    found = graph.project(past_xy, past_heading)
    view = perceive(
        past_xy, past_heading, past_length, np.ones(agent.size, np.bool_), found.lane, found.s,
        found.offset, np.arange(agent.size), begins, graph,
    )  # fmt: skip
    n, limit = len(history.valid), limits(graph)
    free, least = _wished_speeds(history, columns, instant, agent, limit[found.lane], view)
    rows = np.arange(begins[-2], begins[-1])
    i, on, offset = agent[rows], found.lane[rows], found.offset[rows].copy()
    first = _recent(history)
    span = history.time_s[-1] - history.time_s[first[i]]
    along = graph.segment_direction[view.segment[rows]]
    moved = past_xy[rows] - history.xy[i, first[i]]
    sideways = moved[:, 1] * along[:, 0] - moved[:, 0] * along[:, 1]
    sideways = np.divide(sideways, span, out=np.zeros_like(span), where=span > 1e-6)
    outside = np.abs(offset) > graph.width[on] / 2 + NEAR_LANE_M
    outside |= (view.missed[rows] >= BEYOND_M) | (np.cos(view.lane_heading[rows]) <= 0.5)
    drives_on, aside = np.where(outside, -1, on), offset.copy()
    for beside, sign in ((graph.left[on], 1.0), (graph.right[on], -1.0)):
        going = ~outside & (beside >= 0) & (sign * sideways > CHANGING_MPS)
        going &= sign * aside > -CHANGING_FROM_M
        drives_on = np.where(going, beside, drives_on)
        shift = sign * (graph.width[on] + graph.width[beside]) / 2
        offset = np.where(going, aside - shift, offset)
    adjacent, adjacent_gap = adjacent_vehicles(
        view.lane[rows], found.s[rows], past_length[rows], graph
    )
    seen = view.lane[rows] >= 0

    def of_all(values: NDArray[Any], nothing: float, where: Any = None) -> NDArray[Any]:
        """The present rows' values as those of all agents."""
        out = np.full((n, *values.shape[1:]), nothing, dtype=values.dtype)
        out[i] = values if where is None else np.where(where, values, nothing)
        return out

    def row_of(other: IntArray) -> IntArray:
        """The agents that rows name, -1 for none."""
        return np.where(other >= 0, agent[other], -1)

    leader, follower = view.leader[rows], view.follower[rows]
    beside_row = np.where(adjacent >= 0, i[adjacent], -1) if i.size else adjacent
    return AgentStates(
        lane=of_all(drives_on, -1),
        s=of_all(found.s[rows], 0.0),
        offset=of_all(offset, 0.0),
        lateral_speed=of_all(sideways, 0.0),
        accel=present_acceleration(history),
        free_factor=free,
        least_factor=least,
        on_lane=of_all(on, -1, seen),
        limit=of_all(limit[on], np.nan, seen),
        leader=of_all(row_of(leader), -1),
        gap=of_all(view.gap[rows], np.inf, leader >= 0),
        follower=of_all(row_of(follower), -1),
        adjacent=of_all(beside_row, -1),
        adjacent_gap=of_all(adjacent_gap, np.inf, adjacent >= 0),
    )


def _recent(history: Tracks) -> IntArray:
    """(n,) the first column of the last `RECENT_S` in which each was seen."""
    begin = int(np.searchsorted(history.time_s, history.time_s[-1] - RECENT_S - 1e-6))
    return np.asarray(begin + history.valid[:, begin:].argmax(axis=1))


def present_acceleration(history: Tracks) -> FloatArray:
    """(n,) accelerations over the last `RECENT_S` of a history, m/s2; 0 where unknown."""
    first, row = _recent(history), np.arange(history.ids.size)
    span = history.time_s[-1] - history.time_s[first]
    gained = history.speed[:, -1] - history.speed[row, first]
    known = history.valid[:, -1] & (span > 1e-6)
    return np.asarray(np.divide(gained, span, out=np.zeros(row.size), where=known))


def _wished_speeds(
    history: Tracks, columns: IntArray, instant: IntArray, agent: IntArray, limit: FloatArray,
    view: LaneView,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """(n,) mean speed over limit while driving freely, NaN if never seen, and (n,) the largest."""
    n, column, on = history.ids.size, columns[instant], view.lane >= 0
    before = columns[np.maximum(instant - 1, 0)]
    speed = history.speed[agent, column]
    ratio = speed / limit
    least = np.zeros(n)
    np.maximum.at(least, agent[on], ratio[on])
    seen = on & (instant > 0) & history.valid[agent, before]
    span = np.where(seen, history.time_s[column] - history.time_s[before], 1.0)
    change = (speed - history.speed[agent, before]) / span
    clear = np.maximum(FREE_HEADWAY_S * speed, FREE_GAP_M)
    room = np.minimum(view.gap / clear * FREE_GAP_M, view.stop_distance)
    room = np.minimum(room, view.crossing_distance)
    freely = seen & (room > FREE_GAP_M) & (np.abs(change) < STEADY_MPS2)
    total = np.bincount(agent[freely], ratio[freely], minlength=n)
    count = np.bincount(agent[freely], minlength=n)
    return np.divide(total, count, out=np.full(n, np.nan), where=count > 0), least
