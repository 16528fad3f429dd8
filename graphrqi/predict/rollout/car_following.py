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
from typing import Any, NamedTuple

import numpy as np

from behaviors import driver_models
from graphrqi.arrays import BoolArray, CodeArray, FloatArray, IntArray
from graphrqi.predict.scene.stop_constraints import PREPARE_TO_STOP, PROCEED, STOP_IF_COMFORTABLE
from sim.compiled import in_place, inlined

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


class Present(NamedTuple):
    """The n drivers now.

    Attributes:
        s: (n,) distance along the lane, m.
        speed: (n,) m/s.
        accel: (n,) m/s2, or `UNKNOWN_ACCELERATION`.
        half_length: (n,) m.
        on_path: (n,) whether each drives along a path.
    """

    s: FloatArray
    speed: FloatArray
    accel: FloatArray
    half_length: FloatArray
    on_path: BoolArray


class Others(NamedTuple):
    """The assumed future of all drivers: (n, steps) lanes, distances along, m, and speeds, m/s."""

    lane: IntArray
    s: FloatArray
    speed: FloatArray


@in_place(inner=True, reordered=True)
def safe_speed(gap: float, leader_speed: float, headway: float, decel: float) -> float:
    """Krauss's safe speed, m/s; 0 once the gap at a standstill is used up."""
    return _krauss(gap, leader_speed, headway, decel) if gap > 0.0 else 0.0


@in_place(inner=True, reordered=True)
def _find_leader(i: Any, lane: Any, behind_m: float, seen_s: Any, first: Any, after: Any) -> Any:
    """The nearest driver on a lane that begins ``behind_m`` ahead of a driver, and how far."""
    distance, leader = 1e9, -1
    other = first[lane]
    while other >= 0:
        ahead = behind_m + seen_s[other]
        nearer = ahead < distance or (ahead == distance and other > leader)
        if nearer and other != i and (ahead > 0.0 or (ahead == 0.0 and other < i)):
            distance, leader = ahead, other
        other = after[other]
    return distance, leader


@in_place(inner=True, reordered=True)
def _limit_by_stops(
    target: float, front: float, speed: float, q: Any, driver: Any, passes: Any, stop_state: Any,
    column: Any, paths: Any,
) -> float:  # fmt: skip
    """The target speed from which a driver can still stop before its stop constraints, m/s."""
    headway, decel = driver[1], driver[4]
    for g in range(paths.stop_x.shape[1]):
        room, row = paths.stop_x[q, g] - front, paths.stop_row[q, g]
        if room > LOOK_AHEAD_M:
            break
        if room < -1.0 or (row < paths.kinds[1] and passes[1 if row >= paths.kinds[0] else 0]):
            continue
        state = stop_state[row, column]
        if state == PROCEED or (state == PREPARE_TO_STOP and room < SIGHT_M):
            continue
        need = speed * speed / (2.0 * max(room, 0.1))
        hardest = decel if state == STOP_IF_COMFORTABLE else HARD_DECEL
        if need <= hardest or speed <= 1.0:
            target = min(target, safe_speed(room, 0.0, headway, decel))
    return target


class Rollout(NamedTuple):
    """One future of every driver on a path, or M; rows of other agents are not valid.

    Attributes:
        lane: (..., n, H) lane at each step.
        s: (..., n, H) distance along it, m.
        offset: (..., n, H) distance to the left of its centre line, m.
        speed: (..., n, H) m/s.
        travelled: (..., n, H) distance since the present, m.
        asked: (..., n) the law's acceleration at present, m/s2.
        step_s: time between steps, s.
    """

    lane: IntArray
    s: FloatArray
    offset: FloatArray
    speed: FloatArray
    travelled: FloatArray
    asked: FloatArray
    step_s: float

    def of(self, variant: int) -> Rollout:
        """One of M futures."""
        lane, s, offset, speed, travelled, asked = (each[variant] for each in self[:6])
        return Rollout(lane, s, offset, speed, travelled, asked, self.step_s)


def simulate(
    present: Present, path: IntArray, lateral: FloatArray, following: FloatArray,
    ignores: BoolArray, stop_state: CodeArray, paths: Any, others: Others,
    steps: tuple[int, float, float, float],
) -> Rollout:  # fmt: skip
    """Simulate n drivers in M variants.

    Args:
        present: the drivers.
        path: (M, n) row of ``paths`` of each driver; -1 minus it for one that is not simulated. The
            next three may have a first axis of 1.
        lateral: (M, n, 2) distance left of the lane's centre, m, and speed of return, m/s.
        following: (M, n, 5) numbers in the order of `DRIVER_FIELDS`.
        ignores: (M, n, 2) whether each ignores red lights, and pedestrians at crossings.
        stop_state: (R, columns) states of the stop constraints.
        paths: `PathColumns` of the road.
        others: `Others`; with (0, 0) arrays if all move together.
        steps: number, duration, s, columns of ``stop_state`` per step, and decay time of the
            residual acceleration, s.
    """
    m, n = path.shape
    s, offset, speed, travelled = np.zeros((4, m, n, steps[0]))
    lane, asked = np.zeros((m, n, steps[0]), np.int64), np.zeros((m, n))
    out = Rollout(lane, s, offset, speed, travelled, asked, steps[1])
    _simulate(
        present, path, lateral, following, ignores, stop_state, paths, others, steps,
        np.flatnonzero(present.on_path), np.full(paths.lane_length.size, -1),
        np.zeros((3, n), np.int64), np.zeros((6, n)), out,
    )  # fmt: skip
    return out


@in_place(reordered=True)
def _simulate(
    present: Any, path: Any, lateral: Any, following: Any, ignores: Any, stop_state: Any,
    paths: Any, others: Any, steps: Any, drives: Any, first: Any, ints: Any, floats: Any, out: Any,
) -> None:  # fmt: skip
    """See `simulate`; ``first``, ``ints`` and ``floats`` are room to work in."""
    m, n = path.shape
    count, step_s, states, decay_s = steps
    on, seen_lane, after = ints[0], ints[1], ints[2]
    x, v, accel, residual = floats[0], floats[1], floats[2], floats[3]
    seen_s, seen_v = floats[4], floats[5]
    for w in range(m):
        drivers = following[min(w, len(following) - 1)]
        passes = ignores[min(w, len(ignores) - 1)]
        aside = lateral[min(w, len(lateral) - 1)]
        for i in range(n):
            x[i], v[i], residual[i], on[i] = present.s[i], present.speed[i], 0.0, 0
        for h in range(count):
            for i in drives:  # the drivers of each lane make a list: first[lane], after[first] ...
                first[seen_lane[i]] = -1
            for i in drives:
                if others.s.size > 0 and h > 0:
                    seen_lane[i], seen_s[i] = others.lane[i, h - 1], others.s[i, h - 1]
                    seen_v[i] = others.speed[i, h - 1]
                else:
                    q = max(path[w, i], -1 - path[w, i])
                    seen_lane[i] = paths.lane[q, on[i]]
                    seen_s[i], seen_v[i] = x[i] - paths.start[q, on[i]], v[i]
                after[i] = first[seen_lane[i]]
                first[seen_lane[i]] = i
            for i in drives:
                q, half = path[w, i], present.half_length[i]
                if q < 0:
                    continue
                factor, headway, standstill = drivers[i, 0], drivers[i, 1], drivers[i, 2]
                most, decel = drivers[i, 3], drivers[i, 4]
                wish, distance, leader = factor * paths.limit[q, on[i]], 1e9, -1
                for k in range(on[i], paths.lane.shape[1]):
                    begin = paths.start[q, k] - x[i]
                    if paths.lane[q, k] < 0 or begin > LOOK_AHEAD_M:
                        break
                    slower = factor * paths.limit[q, k]
                    if k > on[i] and slower < wish:
                        wish = min(wish, _braking_speed(max(begin, 0.0), slower, decel))
                    if leader < 0:
                        distance, leader = _find_leader(
                            i, paths.lane[q, k], begin, seen_s, first, after
                        )
                target = min(v[i] + most * step_s, max(wish, v[i] - decel * step_s))
                if leader >= 0:
                    gap = distance - half - present.half_length[leader] - standstill
                    target = min(target, safe_speed(gap, seen_v[leader], headway, decel))
                target = _limit_by_stops(
                    target, x[i] + half, v[i], q, drivers[i], passes[i], stop_state,
                    int(h * states + 0.5), paths,
                )  # fmt: skip
                accel[i] = max((target - v[i]) / step_s, -HARD_DECEL)
            fade = math.exp(-h * step_s / decay_s) if decay_s > 0.0 else 0.0
            for i in drives:
                q = path[w, i]
                if q < 0:
                    continue
                if h == 0:
                    out.asked[w, i] = (max(0.0, v[i] + accel[i] * step_s) - v[i]) / step_s
                    if decay_s > 0.0 and present.accel[i] > UNKNOWN_ACCELERATION / 2:
                        residual[i] = present.accel[i] - out.asked[w, i]
                faster = max(0.0, v[i] + (accel[i] + residual[i] * fade) * step_s)
                x[i] += 0.5 * (v[i] + faster) * step_s
                v[i] = faster
                k = on[i]
                while k + 1 < paths.lane.shape[1] and paths.start[q, k + 1] <= x[i]:
                    k += 1
                on[i] = k
                out.lane[w, i, h], out.s[w, i, h] = paths.lane[q, k], x[i] - paths.start[q, k]
                left = max(abs(aside[i, 0]) - aside[i, 1] * step_s * (h + 1), 0.0)
                out.offset[w, i, h] = math.copysign(left, aside[i, 0])
                out.speed[w, i, h], out.travelled[w, i, h] = v[i], x[i] - present.s[i]
