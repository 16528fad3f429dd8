"""Lane changes in a rollout, compiled: MOBIL with each driver's own numbers.

A driver changes to a lane beside that leads where its path does, if it gains more acceleration than
its threshold, its politeness times what others lose included, and imposes no more braking on the
new follower than it is willing to. Accelerations are IDM's.

References:
    Kesting, Treiber, Helbing (2007), "General lane-changing model MOBIL for car-following models",
    Transportation Research Record 1999.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors import driver_models
from sim.compiled import inlined, reordered, shared

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LOOK_AHEAD_M = 120.0
"""Drivers react to nothing farther ahead (our choice: 5 s at 24 m/s)."""

HARD_DECEL = 8.0
"""Nobody brakes harder, m/s2 (dry asphalt)."""

DECIDE_S = 1.0
"""Time between a driver's decisions about lane changes, s (SUMO's own is 1 s at the default
step)."""

CHANGE_S = 3.0
"""Duration of a lane change, s (our choice: 3 to 6 s are observed)."""

CHANGE_ROOM_M = 20.0
"""No lane change starts this close to a junction, m (our choice)."""

CAUTION_M = 30.0
"""Distance within which cautious drivers mind threatening neighbours, m (our choice: 2 s in
town)."""


class Drivers(NamedTuple):
    """How n drivers drive; see `graphrqi.predict.rollout.driver_parameters.DriverParameters`."""

    half_length: FloatArray
    following: FloatArray
    changing: FloatArray
    caution: FloatArray
    threat: FloatArray


class Ranking(NamedTuple):
    """The n drivers of one step, sorted.

    Attributes:
        lane: (n,) lane of each.
        s: (n,) distance along it, m.
        speed: (n,) m/s.
        order: (n,) drivers by lane, then by s.
        rank: (n,) place of each in ``order``.
        first: (L,) place in ``order`` of the first driver of each lane.
        last: (L,) of the last; -1 where there is none.
    """

    lane: IntArray
    s: FloatArray
    speed: FloatArray
    order: IntArray
    rank: IntArray
    first: IntArray
    last: IntArray


_free_acceleration = shared(driver_models.idm_free_acceleration, reordered=True)
_desired_gap = shared(driver_models.idm_desired_gap, reordered=True)
_interaction = shared(driver_models.idm_interaction, reordered=True)


@reordered
def _idm(speed: float, wish: float, gap: float, leader_speed: float, following: Any, i: Any) -> Any:
    """IDM's acceleration, m/s2, within what drivers see and how hard they brake."""
    accel = following[i, 3]
    free = _free_acceleration(speed, wish, accel)
    if gap >= LOOK_AHEAD_M:
        return free
    if gap <= driver_models.LEAST_GAP_M:
        return -HARD_DECEL
    wanted = _desired_gap(
        speed, leader_speed, following[i, 2], following[i, 1], accel, following[i, 4]
    )
    return max(free - accel * _interaction(gap, wanted), -HARD_DECEL)


@reordered
def _neighbors(
    i: Any, along: Any, begin: Any, end: Any, order: Any, s: Any
) -> tuple[Any, Any, Any, Any]:
    """Who is next ahead of and behind a place on a lane, or -1, and how far, m, else 1e9."""
    front, rear, front_far, rear_far = -1, -1, 1e9, 1e9
    for rank in range(begin, end):
        other = order[rank]
        if other == i:
            continue
        ahead = s[other] - along
        if ahead >= 0.0:
            front_far, front = ahead, other
            break
        rear_far, rear = -ahead, other
    return front, front_far, rear, rear_far


@inlined
def choose_lanes(
    who: Any, h: int, motion: Any, drivers: Any, ranking: Any, paths: Any, lane_length: Any
) -> None:
    """Write to which side each driver changes lanes: 0: left, 1: right, -1: not at all.

    Args:
        who: the drivers on paths.
        h: the step.
        motion: where they are; a driver that changes gets its new leader, too.
        drivers: the `Drivers`.
        ranking: the `Ranking`.
        paths: the `graphrqi.predict.scene.paths.PathColumns`.
        lane_length: (L,) m.
    """
    path, on, x, now = motion.path, motion.on, motion.x, motion.speed
    ready, leaders, distances, sides = motion.ready, motion.leader, motion.ahead, motion.side
    half, following, changing = drivers.half_length, drivers.following, drivers.changing
    caution, threat = drivers.caution, drivers.threat
    speeds, s, order = ranking.speed, ranking.s, ranking.order
    first, last = ranking.first, ranking.last
    path_lane, path_start, path_limit = paths.lane, paths.start, paths.limit
    beside, by_turn, path_turn = paths.beside, paths.by_turn, paths.turn
    for j in range(who.size):
        i = who[j]
        sides[i], speed = -1, now[i]
        if h < ready[i] or not speed > 1.0:
            continue
        q, k = path[i], on[i]
        lane, limit, along = path_lane[q, k], path_limit[q, k], x[i] - path_start[q, k]
        onward = path_lane[q, min(k + 1, path_lane.shape[1] - 1)]
        if lane_length[lane] - along < CHANGE_ROOM_M and onward >= 0:
            continue
        wish, decel = following[i, 0] * limit, following[i, 4]
        leader, leader_far = leaders[i], distances[i]
        gap, leader_v = 1e9, speed
        if leader >= 0:
            gap = leader_far - half[i] - half[leader]
            leader_v = speeds[leader]
        most_gain = changing[i, 1]
        for side in range(2):
            target = beside[side, lane]
            if target < 0 or by_turn[target, path_turn[q]] < 0:
                continue
            front, front_far, rear, rear_far = _neighbors(
                i, along, first[target], last[target] + 1, order, s
            )
            front_gap, rear_gap = front_far, rear_far
            if front >= 0:
                front_gap -= half[i] + half[front]
            if rear >= 0:
                rear_gap -= half[i] + half[rear]
            if front_gap < changing[i, 3] or rear_gap < changing[i, 3]:
                continue
            front_v = speeds[front] if front >= 0 else speed
            there = _idm(speed, wish, front_gap, front_v, following, i)
            if there < -decel:
                continue
            gain = there - _idm(speed, wish, gap, leader_v, following, i)
            if rear >= 0:
                rear_v, rear_wish = speeds[rear], following[rear, 0] * limit
                after = _idm(rear_v, rear_wish, rear_gap, speed, following, rear)
                if after < -changing[i, 2]:
                    continue
                whole = 1e9
                if front >= 0:
                    whole = rear_far + front_far - half[rear] - half[front]
                before = _idm(rear_v, rear_wish, whole, front_v, following, rear)
                gain += changing[i, 0] * (after - before)
                if rear_gap < CAUTION_M:
                    gain -= caution[i] * threat[rear]
            _, _, follower, follower_far = _neighbors(
                i, along, first[lane], last[lane] + 1, order, s
            )
            if follower >= 0:
                its_v, its_wish = speeds[follower], following[follower, 0] * limit
                its_gap = follower_far - half[i] - half[follower]
                whole = 1e9
                if leader >= 0:
                    whole = follower_far + leader_far - half[follower] - half[leader]
                gain += changing[i, 0] * (
                    _idm(its_v, its_wish, whole, leader_v, following, follower)
                    - _idm(its_v, its_wish, its_gap, speed, following, follower)
                )
                if its_gap < CAUTION_M:
                    gain += caution[i] * threat[follower]
            if front >= 0 and front_gap < CAUTION_M:
                gain -= caution[i] * threat[front]
            if leader >= 0 and gap < CAUTION_M:
                gain += caution[i] * threat[leader]
            if gain > most_gain:
                most_gain, sides[i] = gain, side
                leaders[i], distances[i] = front, front_far
        if h == 0:  # the leader is that of the present until the driver starts
            leaders[i], distances[i] = leader, leader_far
