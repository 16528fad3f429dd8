"""Lane changes in a rollout, compiled: MOBIL with each driver's own numbers.

A driver changes to a lane beside that leads where its path does, if it gains more acceleration than
its threshold, its politeness times what others lose included, and imposes no more braking on the
new follower than it is willing to. Accelerations are IDM's.

References:
    Kesting, Treiber, Helbing (2007), "General lane-changing model MOBIL for car-following models",
    Transportation Research Record 1999.
"""

from __future__ import annotations

from typing import Any

from behaviors import driver_models
from graphrqi.predict.rollout.columns import (
    AHEAD,
    FIRST,
    HALF_LENGTH,
    LAST,
    LEADER,
    ON,
    ORDER,
    PATH,
    READY,
    SIDE,
    SPEED,
    S,
    V,
    X,
)  # fmt: skip
from sim.compiled import in_place, inlined

LOOK_AHEAD_M = 120.0
"""Distance beyond which drivers react to nothing ahead, m (5 s at 24 m/s)."""

HARD_DECEL = 8.0
"""Largest deceleration, m/s2 (dry asphalt)."""

DECIDE_S = 1.0
"""Time between a driver's decisions about lane changes, s (SUMO's own is 1 s at the default
step)."""

CHANGE_S = 3.0
"""Duration of a lane change, s (3 to 6 s are observed)."""

CHANGE_ROOM_M = 20.0
"""No lane change starts this close to a junction, m."""

CAUTION_M = 30.0
"""Distance within which cautious drivers mind threatening neighbours, m (2 s in town)."""


_free_acceleration = inlined(driver_models.idm_free_acceleration)
_desired_gap = inlined(driver_models.idm_desired_gap)
_interaction = inlined(driver_models.idm_interaction)
_mobil_incentive = inlined(driver_models.mobil_incentive)
_mobil_safe = inlined(driver_models.mobil_safe)


@in_place(inner=True, reordered=True)
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


@in_place(inner=True, reordered=True)
def _neighbors(
    i: Any, along: Any, begin: Any, end: Any, place: Any, ranking: Any
) -> tuple[Any, Any, Any, Any]:
    """Who is next ahead of and behind a place on a lane, or -1, and how far, m, else 1e9."""
    front, rear, front_far, rear_far = -1, -1, 1e9, 1e9
    low, high = begin, end
    while low < high:
        middle = (low + high) // 2
        if place[ranking[middle, ORDER], S] < along:
            low = middle + 1
        else:
            high = middle
    ahead, behind = low, low - 1
    if ahead < end and ranking[ahead, ORDER] == i:
        ahead += 1
    if behind >= begin and ranking[behind, ORDER] == i:
        behind -= 1
    if ahead < end:
        front = ranking[ahead, ORDER]
        front_far = place[front, S] - along
    if behind >= begin:
        rear = ranking[behind, ORDER]
        rear_far = along - place[rear, S]
    return front, front_far, rear, rear_far


@in_place(inner=True, reordered=True)
def choose_lanes(
    who: Any, h: int, motion: Any, route: Any, present: Any, following: Any, changing: Any,
    caution: Any, place: Any, ranking: Any, ends: Any, paths: Any,
) -> None:  # fmt: skip
    """Write to which side each driver changes lanes; one that changes gets its new leader, too.

    Args:
        who: the drivers on paths.
        h: the step.
        motion: (n, 9) and the others likewise: columns as `graphrqi.predict.rollout.columns` says.
        route: (n, 5).
        present: (n, 5).
        following: (n, 5) car-following parameters.
        changing: (n, 4) lane-changing parameters.
        caution: (n, 2) caution and threat of each.
        place: (n, 2).
        ranking: (n, 3).
        ends: (2, L).
        paths: the `graphrqi.predict.scene.paths.PathColumns`.
    """
    path_lane, path_turn = paths.lane, paths.turn
    beside, by_turn = paths.beside, paths.by_turn
    _, most = path_lane.shape
    for j in range(who.size):
        i = who[j]
        route[i, SIDE], speed = -1, motion[i, SPEED]
        if h < route[i, READY] or not speed > 1.0:
            continue
        q, k = route[i, PATH], route[i, ON]
        lane, limit, along = path_lane[q, k], paths.limit[q, k], motion[i, X] - paths.start[q, k]
        onward = path_lane[q, min(k + 1, most - 1)]
        if paths.lane_length[lane] - along < CHANGE_ROOM_M and onward >= 0:
            continue
        wish, decel, half = following[i, 0] * limit, following[i, 4], present[i, HALF_LENGTH]
        leader, leader_far = route[i, LEADER], motion[i, AHEAD]
        gap, leader_v = 1e9, speed
        if leader >= 0:
            gap = leader_far - half - present[leader, HALF_LENGTH]
            leader_v = place[leader, V]
        most_gain = changing[i, 1]
        for side in range(2):
            target = beside[side, lane]
            if target < 0 or by_turn[target, path_turn[q]] < 0:
                continue
            front, front_far, rear, rear_far = _neighbors(
                i, along, ends[FIRST, target], ends[LAST, target] + 1, place, ranking
            )
            front_gap, rear_gap = front_far, rear_far
            if front >= 0:
                front_gap -= half + present[front, HALF_LENGTH]
            if rear >= 0:
                rear_gap -= half + present[rear, HALF_LENGTH]
            if front_gap < changing[i, 3] or rear_gap < changing[i, 3]:
                continue
            front_v = place[front, V] if front >= 0 else speed
            there = _idm(speed, wish, front_gap, front_v, following, i)
            if there < -decel:
                continue
            own_gain = there - _idm(speed, wish, gap, leader_v, following, i)
            rear_gain, follower_gain, kept_clear = 0.0, 0.0, 0.0
            if rear >= 0:
                rear_v, rear_wish = place[rear, V], following[rear, 0] * limit
                after = _idm(rear_v, rear_wish, rear_gap, speed, following, rear)
                if not _mobil_safe(after, changing[i, 2]):
                    continue
                whole = 1e9
                if front >= 0:
                    whole = (
                        rear_far
                        + front_far
                        - present[rear, HALF_LENGTH]
                        - present[front, HALF_LENGTH]
                    )
                rear_gain = after - _idm(rear_v, rear_wish, whole, front_v, following, rear)
                if rear_gap < CAUTION_M:
                    kept_clear -= caution[rear, 1]
            _, _, follower, follower_far = _neighbors(
                i, along, ends[FIRST, lane], ends[LAST, lane] + 1, place, ranking
            )
            if follower >= 0:
                its_v, its_wish = place[follower, V], following[follower, 0] * limit
                its_gap = follower_far - half - present[follower, HALF_LENGTH]
                whole = 1e9
                if leader >= 0:
                    whole = (
                        follower_far
                        + leader_far
                        - present[follower, HALF_LENGTH]
                        - present[leader, HALF_LENGTH]
                    )
                after = _idm(its_v, its_wish, whole, leader_v, following, follower)
                follower_gain = after - _idm(its_v, its_wish, its_gap, speed, following, follower)
                if its_gap < CAUTION_M:
                    kept_clear += caution[follower, 1]
            if front >= 0 and front_gap < CAUTION_M:
                kept_clear -= caution[front, 1]
            if leader >= 0 and gap < CAUTION_M:
                kept_clear += caution[leader, 1]
            gain = _mobil_incentive(own_gain, rear_gain, follower_gain, changing[i, 0])
            gain += caution[i, 0] * kept_clear
            if gain > most_gain:
                most_gain, route[i, SIDE] = gain, side
                route[i, LEADER], motion[i, AHEAD] = front, front_far
        if h == 0:  # the leader is that of the present until the driver starts
            route[i, LEADER], motion[i, AHEAD] = leader, leader_far
