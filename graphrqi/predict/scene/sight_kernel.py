"""The compiled pass behind `graphrqi.predict.scene.sight`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim.compiled import compiled
from sim.episode.observables import LOOK_AHEAD_M, MAX_LANES_AHEAD
from sim.road import lane_search

RECENT_S = 0.5
"""Over which a driver's present motion is taken, s (our choice: shorter is noise)."""

NEAR_LANE_M = 1.0
"""So far outside a lane one still drives along it (our choice)."""

BEYOND_M = 2.0
"""So far beyond a lane's end likewise (our choice)."""

CHANGING_MPS = 0.25
"""Faster sideways than this one is changing lanes (our choice; a change of 3.2 m takes 3 to 6 s,
and keeping a lane drifts at less than 0.2 m/s)."""

CHANGING_FROM_M = 0.3
"""... unless still this far on the other side of the lane's centre (our choice)."""

FREE_HEADWAY_S, FREE_GAP_M, STEADY_MPS2 = 4.0, 40.0, 0.4
"""Driving freely: this far behind the leader in time and from anything ahead in space, and with
so little acceleration (our choice; HCM calls a headway over 3 to 4 s free)."""


@compiled
def _in_order(key: Any, s: Any, keys: int) -> Any:
    """Those of key 0 and up, by key, then by s, then as they come: few share a key."""
    begin = np.zeros(keys + 1, np.int64)
    for j in range(key.size):
        if key[j] >= 0:
            begin[key[j] + 1] += 1
    for k in range(keys):
        begin[k + 1] += begin[k]
    order, filled = np.empty(begin[keys], np.int64), begin[:keys].copy()
    for j in range(key.size):
        if key[j] < 0:
            continue
        k = filled[key[j]]
        filled[key[j]] += 1
        while k > begin[key[j]] and s[order[k - 1]] > s[j]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = j
    return order


@compiled
def look(
    time_s: Any, valid: Any, xy: Any, heading: Any, speed: Any, length: Any, drives: Any,
    columns: Any, agent: Any, instant: Any, lane: Any, s: Any, offset: Any, lane_length: Any,
    lane_width: Any, lane_limit: Any, internal: Any, signal: Any, onward: Any, backward: Any,
    left: Any, right: Any, cross_lane: Any, cross_id: Any, cross_s: Any, cross_exit_s: Any,
    piece_start: Any, piece_direction: Any, piece_at: Any, piece_first: Any, piece_last: Any,
) -> Any:  # fmt: skip
    """Everything that `graphrqi.predict.scene.sight.Sight` lists, in its order.

    Args:
        time_s: (T,) s.
        valid: (n, T) whether each is seen.
        xy: (n, T, 2) m.
        heading: (n, T) rad.
        speed: (n, T) m/s.
        length: (n,) m.
        drives: (n,) whether each drives.
        columns: (C,) moments looked at, ascending, the last is the present.
        agent: (m,) row of each driver seen at each of them, ascending.
        instant: (m,) which of the columns.
        lane: (m,) lane that fits best.
        s: (m,) distance along it, m.
        offset: (m,) distance to its left, m.
        lane_length: (L,) m; what follows is as in `sim.road.lane_graph.LaneGraph`.
        lane_width: (L,) m.
        lane_limit: (L,) m/s.
        internal: (L,).
        signal: (L,).
        onward: (L,) lane after each.
        backward: (L,) lane before each.
        left: (L,) lane beside each.
        right: (L,) lane beside each.
        cross_lane: (Z,).
        cross_id: (Z,).
        cross_s: (Z,) m.
        cross_exit_s: (Z,) m.
        piece_start: (G, 2) m.
        piece_direction: (G, 2).
        piece_at: (G,) m.
        piece_first: (L,).
        piece_last: (L,).
    """
    n, m, lanes, now = drives.size, agent.size, lane_length.size, columns.size - 1
    on_lane, on_s, on_offset = np.full(n, -1), np.zeros(n), np.zeros(n)
    sideways, accel = np.zeros(n), np.zeros(n)
    place, limit, place_s = np.full(n, -1), np.full(n, np.nan), np.zeros(n)
    key, ahead_lane, front = np.full(m, -1), np.full(m, -1), np.empty(m)
    since, span = np.empty(n, np.int64), np.zeros(n)
    for i in range(n):  # pedestrians too have an acceleration
        if not valid[i, -1]:
            continue
        first = time_s.size - 1
        while first > 0 and time_s[-1] - time_s[first - 1] <= RECENT_S + 1e-6:
            first -= 1
        while not valid[i, first]:
            first += 1
        since[i], span[i] = first, time_s[-1] - time_s[first]
        if span[i] > 1e-6:
            accel[i] = (speed[i, -1] - speed[i, first]) / span[i]
    for j in range(m):
        i, t, on = agent[j], columns[instant[j]], lane[j]
        g = piece_first[on]
        while g < piece_last[on] and piece_at[g + 1] <= s[j]:
            g += 1
        ux, uy = piece_direction[g, 0], piece_direction[g, 1]
        along = s[j] - piece_at[g]
        east = xy[i, t, 0] - (piece_start[g, 0] + along * ux - offset[j] * uy)
        north = xy[i, t, 1] - (piece_start[g, 1] + along * uy + offset[j] * ux)
        missed = math.hypot(east, north)
        facing = math.cos(heading[i, t]) * ux + math.sin(heading[i, t]) * uy
        half = lane_width[on] / 2
        front[j] = s[j] + length[i] / 2
        if abs(offset[j]) <= half + 0.5 and missed < 5.0:  # as `sim.episode.observables` has it
            key[j] = instant[j] * lanes + on
            if facing > 0.0:
                ahead_lane[j] = on
            if instant[j] == now:
                place[i], limit[i], place_s[i] = on, lane_limit[on], s[j]
        if instant[j] != now:
            continue
        if span[i] > 1e-6:
            was = since[i]
            sideways[i] = (
                (xy[i, t, 1] - xy[i, was, 1]) * ux - (xy[i, t, 0] - xy[i, was, 0]) * uy
            ) / span[i]
        on_s[i], on_offset[i] = s[j], offset[j]
        if abs(offset[j]) > half + NEAR_LANE_M or missed >= BEYOND_M or facing <= 0.5:
            continue
        on_lane[i] = on
        for sign in (1.0, -1.0):
            to = left[on] if sign > 0 else right[on]
            going = sign * sideways[i] > CHANGING_MPS and sign * offset[j] > -CHANGING_FROM_M
            if to >= 0 and going:
                on_lane[i] = to
                on_offset[i] = offset[j] - sign * (lane_width[on] + lane_width[to]) / 2

    known = _in_order(key, s, lanes * columns.size)
    sorted_key, sorted_s = np.empty(known.size, np.int64), np.empty(known.size)
    for k in range(known.size):
        sorted_key[k], sorted_s[k] = key[known[k]], s[known[k]]
    forward = m >= 0  # not the literal True, for which the search would be compiled once more
    leader_of, distance = lane_search.nearest(
        sorted_key, sorted_s, known, lane_length, onward, instant, ahead_lane, s, forward,
        MAX_LANES_AHEAD, LOOK_AHEAD_M,
    )  # fmt: skip
    stop, _, _, to_crossing = lane_search.stops_ahead(
        ahead_lane, front, lane_length, onward, internal, signal, cross_lane, cross_id, cross_s,
        cross_exit_s, MAX_LANES_AHEAD, LOOK_AHEAD_M,
    )  # fmt: skip

    leader, gap, follower = np.full(n, -1), np.full(n, np.inf), np.full(n, -1)
    total, count, least = np.zeros(n), np.zeros(n), np.zeros(n)
    for j in range(m):
        i, t = agent[j], columns[instant[j]]
        room = np.inf
        if leader_of[j] >= 0:
            room = distance[j] - (length[i] + length[agent[leader_of[j]]]) / 2
            if instant[j] == now:
                leader[i], gap[i] = agent[leader_of[j]], room
        if key[j] < 0:
            continue
        ratio = speed[i, t] / lane_limit[lane[j]]
        least[i] = max(least[i], ratio)
        if instant[j] == 0 or not valid[i, columns[instant[j] - 1]]:
            continue
        before = columns[instant[j] - 1]
        change = (speed[i, t] - speed[i, before]) / (time_s[t] - time_s[before])
        clear = max(FREE_HEADWAY_S * speed[i, t], FREE_GAP_M)
        room = min(room / clear * FREE_GAP_M, stop[j], to_crossing[j])
        if room > FREE_GAP_M and abs(change) < STEADY_MPS2:
            total[i] += ratio
            count[i] += 1.0
    for i in range(n):
        if leader[i] >= 0:
            now_behind = follower[leader[i]]
            if now_behind < 0 or gap[i] <= gap[now_behind]:
                follower[leader[i]] = i
    wished = np.full(n, np.nan)
    for i in range(n):
        if count[i] > 0:
            wished[i] = total[i] / count[i]

    beside, beside_gap = np.full((n, 4), -1), np.full((n, 4), np.inf)
    last = np.full(n, now)
    asked = np.empty(n, np.int64)
    for side in range(2):
        for i in range(n):
            asked[i] = -1
            if place[i] >= 0:
                asked[i] = left[place[i]] if side == 0 else right[place[i]]
        for back in range(2):
            who, far = lane_search.nearest(
                sorted_key, sorted_s, known, lane_length, backward if back else onward, last,
                asked, place_s, back == 0, MAX_LANES_AHEAD, LOOK_AHEAD_M,
            )  # fmt: skip
            for i in range(n):
                if who[i] >= 0:
                    other = agent[who[i]]
                    beside[i, 2 * side + back] = other
                    beside_gap[i, 2 * side + back] = far[i] - (length[i] + length[other]) / 2
    return (
        on_lane, on_s, on_offset, sideways, accel, wished, least, place, limit, leader, gap,
        follower, beside, beside_gap,
    )  # fmt: skip
