"""The rollout itself: every driver of a scene driven on for some seconds, compiled.

All drivers of one rollout move together, step by step. A driver keeps to the least of: what its
acceleration allows, its desired speed under the limits here and ahead, and the speed from which it
could still stop behind its leader or before a closed gate (a red light, an occupied crossing).
The safe speed is Krauss's, derived from Gipps: with reaction time T, deceleration b, gap g and
leader speed u, ``-b T + sqrt((b T)^2 + u^2 + 2 b g)``.

What the driver did beyond the model at the present (its residual acceleration) lives on and decays.

References:
    Gipps (1981), "A behavioural car-following model for computer simulation", Transp. Res. B 15.
    Krauss (1998), "Microscopic modeling of traffic flow", DLR-FB 98-08, eq. 4.13.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LOOK_AHEAD_M = 120.0
"""Drivers react to nothing farther ahead (our choice: 5 s at 24 m/s)."""

SIGHT_M = 4.5
"""From here drivers see who comes (SUMO's default visibility distance at minor links)."""

HARD_DECEL = 8.0
"""Nobody brakes harder, m/s2 (dry asphalt)."""


@numba.njit(cache=True, fastmath=True, inline="always")
def _safe_speed(gap: float, leader_speed: float, headway: float, decel: float) -> float:
    if gap <= 0.0:
        return 0.0
    reach = decel * headway
    return max(
        0.0, -reach + math.sqrt(reach * reach + leader_speed * leader_speed + 2 * decel * gap)
    )


@numba.njit(cache=True, fastmath=True)
def roll(
    x: Any, v: Any, residual: Any, half_length: Any, driver: Any, moving: Any,
    path_lane: Any, path_start: Any, path_limit: Any, gate_x: Any, gate_row: Any, gate_run: Any,
    closed: Any, lanes: int, step_s: float, steps: int, decay_s: float, given_x: Any, given_v: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """Drive everyone on.

    Args:
        x: (n,) distance along each driver's path, m.
        v: (n,) speed, m/s.
        residual: (n,) observed minus modelled acceleration at present, m/s2.
        half_length: (n,) m.
        driver: (n, 5) speed factor, time headway s, standstill gap m, acceleration and
            deceleration m/s2.
        moving: (n,) whether the driver is on a path at all.
        path_lane: (n, P) lanes of each path in order, -1 after its end.
        path_start: (n, P) distance along the path at which each begins, m; +inf after its end.
        path_limit: (n, P) speed limit, m/s.
        gate_x: (n, G) places along the path where one may have to stop, m; +inf where none.
        gate_row: (n, G) rows of ``closed``.
        gate_run: (n, G) whether this driver ignores the gate.
        closed: (R, steps + 1) 0 open, 1 closing (stop if comfortable), 2 closed, 3 approach ready
            to stop until it can be seen that nobody comes.
        lanes: number of lanes of the road.
        step_s: s.
        steps: how many.
        decay_s: time in which the residual falls to 1/e, s.
        given_x: (n, steps) where the others are taken to be, or (0, 0): they move together.
        given_v: (n, steps) their speeds.

    Returns:
        (n, steps) distances along the paths, m, and (n, steps) speeds, m/s.
    """
    n = x.size
    out_x, out_v = np.empty((n, steps)), np.empty((n, steps))
    now_x, now_v = x.copy(), v.copy()
    other_x, other_v = x.copy(), v.copy()
    at, other_at = np.zeros(n, np.int64), np.zeros(n, np.int64)
    head, after = np.empty(lanes, np.int64), np.empty(n, np.int64)
    most, gates = path_lane.shape[1], gate_x.shape[1]
    alone = given_x.size > 0
    for h in range(steps):
        if alone and h > 0:
            for i in range(n):
                other_x[i], other_v[i] = given_x[i, h - 1], given_v[i, h - 1]
        elif not alone:
            other_x[:], other_v[:] = now_x, now_v
        head[:] = -1
        for i in range(n):
            if not moving[i]:
                continue
            k = other_at[i]
            while k + 1 < most and path_lane[i, k + 1] >= 0 and path_start[i, k + 1] <= other_x[i]:
                k += 1
            other_at[i] = k
            lane = path_lane[i, k]
            after[i] = head[lane]
            head[lane] = i
        fade = math.exp(-h * step_s / decay_s)
        for i in range(n):
            if not moving[i]:
                out_x[i, h], out_v[i, h] = now_x[i], now_v[i]
                continue
            factor, headway, standstill = driver[i, 0], driver[i, 1], driver[i, 2]
            accel, decel = driver[i, 3], driver[i, 4]
            here, speed = now_x[i], now_v[i]
            k = at[i]
            while k + 1 < most and path_lane[i, k + 1] >= 0 and path_start[i, k + 1] <= here:
                k += 1
            at[i] = k
            wish = factor * path_limit[i, k]
            best = 1e9
            leader = -1
            for j in range(k, most):
                lane = path_lane[i, j]
                if lane < 0:
                    break
                begin = path_start[i, j]
                if begin - here > LOOK_AHEAD_M:
                    break
                if j > k:
                    slower = factor * path_limit[i, j]
                    if slower < wish:
                        room = max(begin - here, 0.0)
                        wish = min(wish, math.sqrt(slower * slower + 2 * decel * room))
                if leader < 0:
                    other = head[lane]
                    while other >= 0:
                        if other != i:
                            place = begin + other_x[other] - path_start[other, other_at[other]]
                            ahead = place - here
                            if (ahead > 0.0 or (ahead == 0.0 and other < i)) and ahead < best:
                                best, leader = ahead, other
                        other = after[other]
            target = min(speed + accel * step_s, max(wish, speed - decel * step_s))
            if leader >= 0:
                gap = best - half_length[i] - half_length[leader] - standstill
                target = min(target, _safe_speed(gap, other_v[leader], headway, decel))
            front = here + half_length[i]
            for g in range(gates):
                room = gate_x[i, g] - front
                if room > LOOK_AHEAD_M:
                    break
                if room < -1.0 or gate_run[i, g]:
                    continue
                state = closed[gate_row[i, g], h]
                if state == 0 or (state == 3 and room < SIGHT_M):
                    continue
                need = speed * speed / (2.0 * max(room, 0.1))
                if need > (decel if state == 1 else HARD_DECEL) and speed > 1.0:
                    continue
                target = min(target, _safe_speed(room, 0.0, headway, decel))
            change = max((target - speed) / step_s, -HARD_DECEL) + residual[i] * fade
            faster = max(0.0, speed + change * step_s)
            now_x[i] = here + 0.5 * (speed + faster) * step_s
            now_v[i] = faster
            out_x[i, h], out_v[i, h] = now_x[i], faster
    return out_x, out_v


@numba.njit(cache=True, fastmath=True)
def place(
    x: Any, offset: Any, path_lane: Any, path_start: Any, segment_start: Any,
    segment_direction: Any, segment_at: Any, segment_first: Any, segment_last: Any,
) -> Any:  # fmt: skip
    """(n, H, 2) places of distances x (n, H) along paths, with (n, H) offsets to the left."""
    n, steps = x.shape
    out = np.empty((n, steps, 2))
    for i in range(n):
        k, g = 0, segment_first[path_lane[i, 0]]
        for h in range(steps):
            while (
                k + 1 < path_lane.shape[1]
                and path_lane[i, k + 1] >= 0
                and path_start[i, k + 1] <= x[i, h]
            ):
                k += 1
                g = segment_first[path_lane[i, k]]
            s = x[i, h] - path_start[i, k]
            while g < segment_last[path_lane[i, k]] and segment_at[g + 1] <= s:
                g += 1
            along = s - segment_at[g]
            side = offset[i, h]
            out[i, h, 0] = (
                segment_start[g, 0] + along * segment_direction[g, 0]
                - side * segment_direction[g, 1]
            )  # fmt: skip
            out[i, h, 1] = (
                segment_start[g, 1] + along * segment_direction[g, 1]
                + side * segment_direction[g, 0]
            )  # fmt: skip
    return out
