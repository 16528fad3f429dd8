"""The rollout itself, compiled: every driver of a scene is driven on for some seconds.

All drivers of one rollout move together, step by step. A driver's next speed is the least of: the
speed that its acceleration allows, its wished speed under the limits here and ahead, and the speed
from which it could still stop behind its leader or before a stop constraint (a red light, an
occupied crossing). The safe speed is Krauss's, derived from Gipps: with reaction time T,
deceleration b, gap g and leader speed u, ``-b T + sqrt((b T)^2 + u^2 + 2 b g)``.

The residual acceleration, which is the present acceleration minus the model's, is added and decays.
Once a second a driver may change lanes (`graphrqi.predict.rollout.lane_changing`).

References:
    Gipps (1981), "A behavioural car-following model for computer simulation", Transp. Res. B 15.
    Krauss (1998), "Microscopic modeling of traffic flow", DLR-FB 98-08, eq. 4.13.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors import driver_models
from graphrqi.predict.rollout.lane_changing import (
    CHANGE_S,
    DECIDE_S,
    HARD_DECEL,
    LOOK_AHEAD_M,
    Drivers,
    Ranking,
    choose_lanes,
)
from graphrqi.predict.scene.stop_constraints import PREPARE_TO_STOP, PROCEED, STOP_IF_COMFORTABLE
from sim.compiled import inlined, reordered, shared

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SIGHT_M = 4.5
"""Distance to a junction from which drivers see who comes, m (SUMO's default visibility distance at
minor links)."""

UNKNOWN_ACCELERATION = -2e3
"""A present acceleration that is not known: the driver has no residual."""


class Start(NamedTuple):
    """n drivers at present.

    Attributes:
        s: (n,) distance along the first lane of their paths, m.
        speed: (n,) m/s.
        accel: (n,) m/s2; `UNKNOWN_ACCELERATION`: as modelled.
        half_length: (n,) m.
        on_path: (n,) whether the driver is on a path at all.
    """

    s: FloatArray
    speed: FloatArray
    accel: FloatArray
    half_length: FloatArray
    on_path: BoolArray


class Ways(NamedTuple):
    """M ways in which n drivers may drive.

    Attributes:
        path: (M, n) path of each driver, row of the `PathColumns`.
        offset: (M, n) distance to the left of the lane's centre, m.
        return_speed: (M, n) lateral speed at which each returns to it, m/s.
        following: (M, n, 5) speed factor, time headway s, standstill gap m, acceleration and
            deceleration m/s2.
        ignores: (M, n, R) whether each ignores each stop constraint.
    """

    path: IntArray
    offset: FloatArray
    return_speed: FloatArray
    following: FloatArray
    ignores: BoolArray


class LaneChanges(NamedTuple):
    """How n drivers change lanes; see `graphrqi.predict.rollout.driver_parameters`."""

    changing: FloatArray
    caution: FloatArray
    threat: FloatArray


class Others(NamedTuple):
    """Where other drivers are assumed to be; (0, 0) arrays: all move together.

    Attributes:
        lane: (n, steps) lanes.
        s: (n, steps) distance along them, m.
        speed: (n, steps) m/s.
    """

    lane: IntArray
    s: FloatArray
    speed: FloatArray


class Steps(NamedTuple):
    """How far to drive on.

    Attributes:
        number: how many steps.
        step_s: time between them, s.
        states: columns of the stop constraints' states per step.
        decay_s: time in which the residual acceleration falls to 1/e, s; 0: at once.
    """

    number: int
    step_s: float
    states: float
    decay_s: float


class _Motion(NamedTuple):
    """The n drivers at one step of one rollout; the arrays change from step to step.

    Attributes:
        path: (n,) path of each.
        on: (n,) which lane of it.
        x: (n,) distance along it, m.
        speed: (n,) m/s.
        offset: (n,) distance to the left of the lane's centre, m.
        return_speed: (n,) m/s.
        travelled: (n,) distance since the present, m.
        residual: (n,) residual acceleration at present, m/s2.
        ready: (n,) step from which each may change lanes.
        wish: (n,) wished speed under the limits here and ahead, m/s.
        leader: (n,) the leader, -1: none.
        ahead: (n,) distance to its centre, m.
        accel: (n,) acceleration that the law asks for, m/s2.
        side: (n,) to which side each changes lanes now; see `choose_lanes`.
    """

    path: IntArray
    on: IntArray
    x: FloatArray
    speed: FloatArray
    offset: FloatArray
    return_speed: FloatArray
    travelled: FloatArray
    residual: FloatArray
    ready: IntArray
    wish: FloatArray
    leader: IntArray
    ahead: FloatArray
    accel: FloatArray
    side: IntArray


_krauss = shared(driver_models.krauss_safe_speed, reordered=True)


@reordered
def safe_speed(gap: float, leader_speed: float, headway: float, decel: float) -> float:
    """Krauss's safe speed, m/s; nobody moves on once the gap at a standstill is used up."""
    return _krauss(gap, leader_speed, headway, decel) if gap > 0.0 else 0.0


@reordered
def roll(
    start: Any, ways: Any, changes: Any, stop_state: Any, paths: Any, lane_length: Any,
    others: Any, steps: Any,
) -> Any:  # fmt: skip
    """Drive n drivers on in M ways.

    Args:
        start: the `Start`.
        ways: the `Ways`.
        changes: the `LaneChanges`; (0, 4) numbers: nobody changes lanes.
        stop_state: (R, columns) states of the stop constraints.
        paths: the `graphrqi.predict.scene.paths.PathColumns`.
        lane_length: (L,) m.
        others: the `Others`.
        steps: the `Steps`.

    Returns:
        (M, n, steps) each: lanes, distances along them and to the left of their centres, m, speeds,
        m/s, and distances travelled since the present, m; and (M, n) accelerations that the law
        asks for at present, m/s2.
    """
    m, n = ways.path.shape
    count, step_s = steps.number, steps.step_s
    lane = np.zeros((m, n, count), np.int64)
    s, offset = np.zeros((m, n, count)), np.zeros((m, n, count))
    speed, travelled = np.zeros((m, n, count)), np.zeros((m, n, count))
    asked = np.zeros((m, n))
    lanes = lane_length.size
    ranking = Ranking(
        np.full(n, -1), start.s.copy(), start.speed.copy(), np.empty(n, np.int64),
        np.zeros(n, np.int64), np.empty(lanes, np.int64), np.empty(lanes, np.int64),
    )  # fmt: skip
    drivers = 0
    for i in range(n):
        if start.on_path[i]:
            ranking.order[drivers] = i
            drivers += 1
    who = ranking.order[:drivers].copy()
    may_change = changes.changing.shape[0] == n and count > 1
    every = max(1, round(DECIDE_S / step_s))
    for w in range(m):
        motion = _Motion(
            ways.path[w].copy(), np.zeros(n, np.int64), start.s.copy(), start.speed.copy(),
            ways.offset[w].copy(), ways.return_speed[w].copy(), np.zeros(n), np.zeros(n),
            np.zeros(n, np.int64), np.empty(n), np.empty(n, np.int64), np.empty(n), np.empty(n),
            np.empty(n, np.int64),
        )  # fmt: skip
        following, ignores = ways.following[w], ways.ignores[w]
        for i in range(n):
            if abs(motion.offset[i]) > 0.5:
                motion.ready[i] = int(CHANGE_S / step_s)
        for h in range(count):
            _locate(who, motion, paths, ranking)
            if others.s.size > 0 and h > 0:
                _place_others(who, h - 1, others, ranking)
            _rank(ranking, drivers)
            _look_ahead(who, motion, following, ranking, paths)
            if may_change and h % every == 0:
                traits = Drivers(
                    start.half_length, following, changes.changing, changes.caution, changes.threat
                )
                choose_lanes(who, h, motion, traits, ranking, paths, lane_length)
                _change_lanes(who, h, motion, paths, steps)
            column = int(h * steps.states + 0.5)
            _choose_accelerations(
                who, motion, start.half_length, following, changes, ranking.speed, ignores,
                stop_state, column, paths, step_s,
            )  # fmt: skip
            if h == 0:
                _set_residuals(who, motion, start.accel, steps, asked[w])
            fade = math.exp(-h * step_s / steps.decay_s) if steps.decay_s > 0.0 else 0.0
            _advance(who, motion, fade, step_s)
            _locate(who, motion, paths, ranking)
            _record(who, w, h, motion, ranking, (lane, s, offset, speed, travelled))
    return lane, s, offset, speed, travelled, asked


@inlined
def _record(who: Any, w: int, h: int, motion: Any, ranking: Any, out: Any) -> None:
    """Copy one step into the rollout's columns."""
    out_lane, out_s, out_offset, out_speed, out_travelled = out
    lane, s = ranking.lane, ranking.s
    offset, speed, travelled = motion.offset, motion.speed, motion.travelled
    for j in range(who.size):
        i = who[j]
        out_lane[w, i, h], out_s[w, i, h], out_offset[w, i, h] = lane[i], s[i], offset[i]
        out_speed[w, i, h], out_travelled[w, i, h] = speed[i], travelled[i]


@inlined
def _locate(who: Any, motion: Any, paths: Any, ranking: Any) -> None:
    """Write the lane that each driver has reached, its distance along it and its speed."""
    path, on, x, speed = motion.path, motion.on, motion.x, motion.speed
    path_lane, path_start = paths.lane, paths.start
    lane, s, its_speed = ranking.lane, ranking.s, ranking.speed
    for j in range(who.size):
        i = who[j]
        q, k = path[i], on[i]
        while (
            k + 1 < path_lane.shape[1] and path_lane[q, k + 1] >= 0 and path_start[q, k + 1] <= x[i]
        ):
            k += 1
        on[i] = k
        lane[i], s[i], its_speed[i] = path_lane[q, k], x[i] - path_start[q, k], speed[i]


@inlined
def _place_others(who: Any, h: int, others: Any, ranking: Any) -> None:
    """Write where the others are assumed to be at a step."""
    lane, s, speed = ranking.lane, ranking.s, ranking.speed
    others_lane, others_s, others_speed = others.lane, others.s, others.speed
    for j in range(who.size):
        i = who[j]
        lane[i], s[i], speed[i] = others_lane[i, h], others_s[i, h], others_speed[i, h]


@inlined
def _rank(ranking: Any, drivers: int) -> None:
    """Sort drivers by lane, then by place; they are nearly in order since the last step."""
    lane, s, order = ranking.lane, ranking.s, ranking.order
    rank, first, last = ranking.rank, ranking.first, ranking.last
    for j in range(1, drivers):
        i = order[j]
        g = j - 1
        while g >= 0:
            o = order[g]
            if lane[o] < lane[i] or (
                lane[o] == lane[i] and (s[o] < s[i] or (s[o] == s[i] and o > i))
            ):
                break
            order[g + 1] = o
            g -= 1
        order[g + 1] = i
    for on in range(first.size):
        first[on], last[on] = 0, -1
    for j in range(drivers):
        on = lane[order[j]]
        if last[on] < 0:
            first[on] = j
        last[on] = j
        rank[order[j]] = j


@inlined
def _look_ahead(who: Any, motion: Any, following: Any, ranking: Any, paths: Any) -> None:
    """Write each driver's wished speed under the limits here and ahead, and its leader."""
    path, on, x = motion.path, motion.on, motion.x
    wishes, leaders, distances = motion.wish, motion.leader, motion.ahead
    path_lane, path_start, path_limit = paths.lane, paths.start, paths.limit
    its_lane, its_s, order = ranking.lane, ranking.s, ranking.order
    rank, first, last = ranking.rank, ranking.first, ranking.last
    for j in range(who.size):
        i = who[j]
        q, k, here = path[i], on[i], x[i]
        factor, decel = following[i, 0], following[i, 4]
        wish = factor * path_limit[q, k]
        distance, leader = 1e9, -1
        for a in range(k, path_lane.shape[1]):
            lane = path_lane[q, a]
            if lane < 0:
                break
            begin = path_start[q, a]
            if begin - here > LOOK_AHEAD_M:
                break
            if a > k:
                slower = factor * path_limit[q, a]
                if slower < wish:
                    room = max(begin - here, 0.0)
                    wish = min(wish, math.sqrt(slower * slower + 2 * decel * room))
            if leader >= 0:
                continue
            g = first[lane]
            if lane == its_lane[i]:  # nobody far behind oneself is ahead
                g = rank[i]
                while g > first[lane] and begin + its_s[order[g - 1]] >= here:
                    g -= 1
            for place in range(g, last[lane] + 1):
                other = order[place]
                ahead = begin + its_s[other] - here
                if other != i and (ahead > 0.0 or (ahead == 0.0 and other < i)):
                    distance, leader = ahead, other
                    break
        wishes[i], leaders[i], distances[i] = wish, leader, distance


@inlined
def _change_lanes(who: Any, h: int, motion: Any, paths: Any, steps: Any) -> None:
    """Put drivers on the lane that they have chosen.

    A driver that has had an incentive since the first step and has not started is assumed not to
    change lanes.
    """
    path, on, x, offset = motion.path, motion.on, motion.x, motion.offset
    ready, sides, return_speed = motion.ready, motion.side, motion.return_speed
    for j in range(who.size):
        i = who[j]
        side = sides[i]
        if side >= 0 and h == 0:
            ready[i] = steps.number
        elif side >= 0:
            q, k = path[i], on[i]
            lane = paths.lane[q, k]
            wide = paths.lane_spacing[side, lane]
            x[i], on[i] = x[i] - paths.start[q, k], 0
            path[i] = paths.by_turn[paths.beside[side, lane], paths.turn[q]]
            offset[i] -= (1.0 - 2.0 * side) * wide
            return_speed[i] = max(wide / CHANGE_S, abs(offset[i]) / CHANGE_S)
            ready[i] = h + int(CHANGE_S / steps.step_s)


@inlined
def _choose_accelerations(
    who: Any, motion: Any, half_length: Any, following: Any, changes: Any, speeds: Any,
    ignores: Any, stop_state: Any, column: Any, paths: Any, step_s: float,
) -> None:  # fmt: skip
    """Write the acceleration that each driver chooses, m/s2, before its residual."""
    path, x, now, wish = motion.path, motion.x, motion.speed, motion.wish
    leaders, distances, accels = motion.leader, motion.ahead, motion.accel
    caution, threat = changes.caution, changes.threat
    stop_x, stop_row = paths.stop_x, paths.stop_row
    for j in range(who.size):
        i = who[j]
        headway, standstill = following[i, 1], following[i, 2]
        accel, decel = following[i, 3], following[i, 4]
        speed, q, leader = now[i], path[i], leaders[i]
        target = min(speed + accel * step_s, max(wish[i], speed - decel * step_s))
        if leader >= 0:
            gap = distances[i] - half_length[i] - half_length[leader] - standstill
            more = 1.0 + caution[i] * threat[leader]
            target = min(target, safe_speed(gap, speeds[leader], headway * more, decel))
        front = x[i] + half_length[i]
        for g in range(stop_x.shape[1]):
            room = stop_x[q, g] - front
            if room > LOOK_AHEAD_M:
                break
            row = stop_row[q, g]
            if room < -1.0 or ignores[i, row]:
                continue
            state = stop_state[row, column]
            if state == PROCEED or (state == PREPARE_TO_STOP and room < SIGHT_M):
                continue
            need = speed * speed / (2.0 * max(room, 0.1))
            hardest = decel if state == STOP_IF_COMFORTABLE else HARD_DECEL
            if need > hardest and speed > 1.0:
                continue
            target = min(target, safe_speed(room, 0.0, headway, decel))
        accels[i] = max((target - speed) / step_s, -HARD_DECEL)


@inlined
def _set_residuals(who: Any, motion: Any, accel: Any, steps: Any, asked: Any) -> None:
    """Write the acceleration that the law asks for now, and how far the seen one differs."""
    speed, chosen, residual = motion.speed, motion.accel, motion.residual
    for j in range(who.size):
        i = who[j]
        asked[i] = (max(0.0, speed[i] + chosen[i] * steps.step_s) - speed[i]) / steps.step_s
        if steps.decay_s > 0.0 and accel[i] > UNKNOWN_ACCELERATION / 2:
            residual[i] = accel[i] - asked[i]


@inlined
def _advance(who: Any, motion: Any, fade: float, step_s: float) -> None:
    """Move everyone one step on; residual accelerations are added with a weight ``fade``."""
    x, speed, travelled, offset = motion.x, motion.speed, motion.travelled, motion.offset
    accel, residual, return_speed = motion.accel, motion.residual, motion.return_speed
    for j in range(who.size):
        i = who[j]
        change = accel[i] + residual[i] * fade
        faster = max(0.0, speed[i] + change * step_s)
        step = 0.5 * (speed[i] + faster) * step_s
        x[i] += step
        travelled[i] += step
        speed[i] = faster
        offset[i] = math.copysign(max(abs(offset[i]) - return_speed[i] * step_s, 0.0), offset[i])
