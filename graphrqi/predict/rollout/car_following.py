"""The compiled rollout: every driver of a scene is simulated for some seconds.

All drivers of one rollout move together, step by step. A driver's next speed is the least of three.
The first is the speed that its acceleration allows. The second is its desired speed under the
limits here and ahead. From the third it could still stop behind its leader or before a stop
constraint. The safe speed is Krauss's, derived from Gipps: with reaction time T, deceleration b,
gap g and leader speed u, ``-b T + sqrt((b T)^2 + u^2 + 2 b g)``.

The residual acceleration, which is the present acceleration minus the model's, is added and decays.
No driver changes lanes.

References:
    Gipps (1981), "A behavioural car-following model for computer simulation", Transp. Res. B 15.
    Krauss (1998), "Microscopic modeling of traffic flow", DLR-FB 98-08.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors import driver_models
from graphrqi.predict.rollout.columns import (
    ACCEL,
    AHEAD,
    FIRST,
    HALF_LENGTH,
    LANE,
    LAST,
    LEADER,
    OFFSET,
    ON,
    ON_PATH,
    ORDER,
    PATH,
    RANK,
    RESIDUAL,
    RETURN_SPEED,
    SORTED,
    SPEED,
    START_ACCEL,
    START_S,
    START_SPEED,
    TRAVELLED,
    USED,
    WISH,
    S,
    V,
    X,
)  # fmt: skip
from graphrqi.predict.scene.paths import PathColumns
from graphrqi.predict.scene.stop_constraints import PREPARE_TO_STOP, PROCEED, STOP_IF_COMFORTABLE
from sim.compiled import in_place, inlined

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
CodeArray = NDArray[np.int8]

LOOK_AHEAD_M = 120.0
"""Distance beyond which drivers react to nothing ahead, m (5 s at 24 m/s)."""

HARD_DECEL = 8.0
"""Largest deceleration, m/s2 (dry asphalt)."""

SIGHT_M = 4.5
"""Distance to a junction from which drivers see the crossing road, m (SUMO's default at minor
links)."""

UNKNOWN_ACCELERATION = -2e3
"""A present acceleration that is not known: the driver has no residual."""


_braking_speed = inlined(driver_models.braking_speed)
_krauss = inlined(driver_models.krauss_safe_speed)


@in_place(inner=True, reordered=True)
def safe_speed(gap: float, leader_speed: float, headway: float, decel: float) -> float:
    """Krauss's safe speed, m/s; 0 once the gap at a standstill is used up."""
    return _krauss(gap, leader_speed, headway, decel) if gap > 0.0 else 0.0


def roll(
    present: FloatArray, path: IntArray, lateral: FloatArray, following: FloatArray,
    ignores: BoolArray, stop_state: CodeArray, paths: PathColumns,
    others: tuple[IntArray, FloatArray, FloatArray], order: IntArray,
    steps: tuple[int, float, float, float],
) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
    """Simulate n drivers in M variants.

    Args:
        present: (n, 5) the drivers now; see `columns.PRESENT`.
        path: (M, n) row of ``paths`` of each driver; -1 minus it for a driver that is present but
            not simulated. The next three may have a first axis of 1.
        lateral: (M, n, 2) distance left of the lane's centre, m, and speed of return, m/s.
        following: (M, n, 5) numbers in the order of `DRIVER_FIELDS`.
        ignores: (M, n, 2) whether each ignores red lights, and pedestrians at crossings.
        stop_state: (R, columns) states of the stop constraints.
        paths: the paths of the road.
        others: (n, steps) assumed lanes, distances, m, and speeds, m/s, of the others; (0, 0) each
            if all move together.
        order: the drivers on paths, best sorted by lane and position.
        steps: number, duration, s, columns of ``stop_state`` per step, and decay time of the
            residual acceleration, s.

    Returns:
        (M, n, steps) lanes. (4, M, n, steps) distances along them and to their left, m, speeds,
        m/s, and distances travelled, m. (M, n) accelerations of the law at present, m/s2.
    """
    (m, n), drivers = path.shape, order.size
    place, ranking = np.empty((n, 2)), np.full((n, 3), -1)
    place[:, S], place[:, V] = present[:, START_S], present[:, START_SPEED]
    ranking[:, RANK], ranking[:drivers, ORDER] = 0, order
    ends = np.zeros((2, paths.lane_length.size), np.int64)
    ends[LAST] = -1
    spare = np.zeros((drivers + 1, 2), np.int64)
    lane, columns = np.zeros((m, n, steps[0]), np.int64), np.zeros((4, m, n, steps[0]))
    asked = np.zeros((m, n))
    _roll(
        present, path, lateral, following, ignores, stop_state, paths, others, steps, (
            order, place, ranking, ends, spare, np.empty((n, 9)), np.empty((n, 3), np.int64),
            np.empty(drivers, np.int64), lane, columns, asked,
        ),
    )  # fmt: skip
    return lane, columns, asked


@in_place(reordered=True)
def _roll(
    present: Any, path: Any, lateral: Any, following: Any, ignores: Any, stop_state: Any,
    paths: Any, others: Any, steps: Any, room: Any,
) -> None:  # fmt: skip
    """See `roll`; ``room`` holds the order, room to work in, and what receives the results."""
    order, place, ranking, ends, spare, motion, route, moving, lane, columns, asked = room
    others_lane, others_s, others_speed = others
    m, n = path.shape
    count, step_s, states, decay_s = steps
    path_lane, path_start, path_limit = paths.lane, paths.start, paths.limit
    for w in range(m):
        driven = 0
        for i in range(n):
            v = min(w, len(lateral) - 1)
            motion[i, X], motion[i, SPEED] = present[i, START_S], present[i, START_SPEED]
            motion[i, OFFSET], motion[i, RETURN_SPEED] = lateral[v, i, 0], lateral[v, i, 1]
            motion[i, TRAVELLED], motion[i, RESIDUAL] = 0.0, 0.0
            route[i, PATH], route[i, ON] = max(path[w, i], -1 - path[w, i]), 0
            if present[i, ON_PATH] > 0.0 and path[w, i] >= 0:
                moving[driven] = i
                driven += 1
        who = moving[:driven]
        drives = following[min(w, len(following) - 1)]
        passes = ignores[min(w, len(ignores) - 1)]
        _locate(order, motion, route, path_lane, path_start, place, ranking)
        for h in range(count):
            if others_s.size > 0 and h > 0:
                for j in range(order.size):
                    i = order[j]
                    ranking[i, LANE], place[i, S] = others_lane[i, h - 1], others_s[i, h - 1]
                    place[i, V] = others_speed[i, h - 1]
            _rank(place, ranking, ends, spare, order.size)
            _look_ahead(
                who, motion, route, drives, place, ranking, ends, path_lane, path_start, path_limit
            )
            column = int(h * states + 0.5)
            _choose_accelerations(
                who, motion, route, present, drives, place, passes, stop_state, column,
                paths, step_s,
            )  # fmt: skip
            if h == 0:
                for j in range(driven):
                    i = who[j]
                    speed = motion[i, SPEED]
                    asked[w, i] = (max(0.0, speed + motion[i, ACCEL] * step_s) - speed) / step_s
                    if decay_s > 0.0 and present[i, START_ACCEL] > UNKNOWN_ACCELERATION / 2:
                        motion[i, RESIDUAL] = present[i, START_ACCEL] - asked[w, i]
            fade = math.exp(-h * step_s / decay_s) if decay_s > 0.0 else 0.0
            _advance(who, motion, fade, step_s)
            _locate(who, motion, route, path_lane, path_start, place, ranking)
            for j in range(driven):
                i = who[j]
                lane[w, i, h] = ranking[i, LANE]
                columns[0, w, i, h], columns[1, w, i, h] = place[i, S], motion[i, OFFSET]
                columns[2, w, i, h], columns[3, w, i, h] = motion[i, SPEED], motion[i, TRAVELLED]


@in_place(inner=True, reordered=True)
def _locate(
    who: Any, motion: Any, route: Any, path_lane: Any, path_start: Any, place: Any, ranking: Any
) -> None:
    """Write the lane that each driver has reached, its distance along it and its speed."""
    _, most = path_lane.shape
    for j in range(who.size):
        i = who[j]
        q, k, x = route[i, PATH], route[i, ON], motion[i, X]
        while k + 1 < most and path_lane[q, k + 1] >= 0 and path_start[q, k + 1] <= x:
            k += 1
        route[i, ON] = k
        ranking[i, LANE], place[i, S] = path_lane[q, k], x - path_start[q, k]
        place[i, V] = motion[i, SPEED]


@in_place(inner=True, reordered=True)
def _rank(place: Any, ranking: Any, ends: Any, spare: Any, drivers: int) -> None:
    """Sort drivers by place within each lane; they are nearly in order since the last step."""
    for u in range(spare[drivers, USED]):
        lane = spare[u, USED]
        ends[FIRST, lane], ends[LAST, lane] = 0, -1
    used = 0
    for j in range(drivers):
        lane = ranking[ranking[j, ORDER], LANE]
        if ends[LAST, lane] < 0:
            spare[used, USED] = lane
            used += 1
        ends[LAST, lane] += 1
        spare[j, SORTED] = ranking[j, ORDER]
    spare[drivers, USED] = used
    begin = 0
    for u in range(used):
        lane = spare[u, USED]
        ends[FIRST, lane] = begin
        begin += ends[LAST, lane] + 1
        ends[LAST, lane] = ends[FIRST, lane] - 1
    for j in range(drivers):
        i = spare[j, SORTED]
        lane, s = ranking[i, LANE], place[i, S]
        g, first = ends[LAST, lane], ends[FIRST, lane]
        ends[LAST, lane] += 1
        while g >= first:
            o = ranking[g, ORDER]
            if place[o, S] < s or (place[o, S] == s and o > i):
                break
            ranking[g + 1, ORDER] = o
            g -= 1
        ranking[g + 1, ORDER] = i
    for j in range(drivers):
        ranking[ranking[j, ORDER], RANK] = j


@in_place(inner=True, reordered=True)
def _look_ahead(
    who: Any, motion: Any, route: Any, following: Any, place: Any, ranking: Any, ends: Any,
    path_lane: Any, path_start: Any, path_limit: Any,
) -> None:  # fmt: skip
    """Write each driver's desired speed under the limits here and ahead, and its leader."""
    _, most = path_lane.shape
    for j in range(who.size):
        i = who[j]
        q, k, here = route[i, PATH], route[i, ON], motion[i, X]
        factor, decel = following[i, 0], following[i, 4]
        wish = factor * path_limit[q, k]
        distance, leader = 1e9, -1
        for a in range(k, most):
            lane = path_lane[q, a]
            if lane < 0:
                break
            begin = path_start[q, a]
            if begin - here > LOOK_AHEAD_M:
                break
            if a > k:
                slower = factor * path_limit[q, a]
                if slower < wish:
                    wish = min(wish, _braking_speed(max(begin - here, 0.0), slower, decel))
            if leader >= 0:
                continue
            g = ends[FIRST, lane]
            if lane == ranking[i, LANE]:  # vehicles far behind do not count
                g = ranking[i, RANK]
                while g > ends[FIRST, lane] and (begin + place[ranking[g - 1, ORDER], S] >= here):
                    g -= 1
            for rank in range(g, ends[LAST, lane] + 1):
                other = ranking[rank, ORDER]
                ahead = begin + place[other, S] - here
                if other != i and (ahead > 0.0 or (ahead == 0.0 and other < i)):
                    distance, leader = ahead, other
                    break
        motion[i, WISH], motion[i, AHEAD], route[i, LEADER] = wish, distance, leader


@inlined
def _choose_accelerations(
    who: Any, motion: Any, route: Any, present: Any, following: Any, place: Any, ignores: Any,
    stop_state: Any, column: Any, paths: Any, step_s: float,
) -> None:  # fmt: skip
    """Write the acceleration that each driver chooses, m/s2, before its residual."""
    stop_x, stop_row, kinds = paths.stop_x, paths.stop_row, paths.kinds
    _, stops = stop_x.shape
    for j in range(who.size):
        i = who[j]
        headway, standstill = following[i, 1], following[i, 2]
        accel, decel = following[i, 3], following[i, 4]
        speed, q, leader = motion[i, SPEED], route[i, PATH], route[i, LEADER]
        half = present[i, HALF_LENGTH]
        target = min(speed + accel * step_s, max(motion[i, WISH], speed - decel * step_s))
        if leader >= 0:
            gap = motion[i, AHEAD] - half - present[leader, HALF_LENGTH] - standstill
            target = min(target, safe_speed(gap, place[leader, V], headway, decel))
        front = motion[i, X] + half
        for g in range(stops):
            room = stop_x[q, g] - front
            if room > LOOK_AHEAD_M:
                break
            row = stop_row[q, g]
            if room < -1.0 or (row < kinds[1] and ignores[i, 1 if row >= kinds[0] else 0]):
                continue
            state = stop_state[row, column]
            if state == PROCEED or (state == PREPARE_TO_STOP and room < SIGHT_M):
                continue
            need = speed * speed / (2.0 * max(room, 0.1))
            hardest = decel if state == STOP_IF_COMFORTABLE else HARD_DECEL
            if need > hardest and speed > 1.0:
                continue
            target = min(target, safe_speed(room, 0.0, headway, decel))
        motion[i, ACCEL] = max((target - speed) / step_s, -HARD_DECEL)


@in_place(inner=True, reordered=True)
def _advance(who: Any, motion: Any, fade: float, step_s: float) -> None:
    """Move everyone one step on; residual accelerations are added with a weight ``fade``."""
    for j in range(who.size):
        i = who[j]
        speed, offset = motion[i, SPEED], motion[i, OFFSET]
        change = motion[i, ACCEL] + motion[i, RESIDUAL] * fade
        faster = max(0.0, speed + change * step_s)
        step = 0.5 * (speed + faster) * step_s
        motion[i, X] += step
        motion[i, TRAVELLED] += step
        motion[i, SPEED] = faster
        left = max(abs(offset) - motion[i, RETURN_SPEED] * step_s, 0.0)
        motion[i, OFFSET] = math.copysign(left, offset)
