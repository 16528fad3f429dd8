"""Compiled parts: laws that drive recorded vehicles on, and distances between their outlines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from behaviors import driver_models
from sim.compiled import compiled, inner, shared

_free = shared(driver_models.idm_free_acceleration)
_desired_gap = shared(driver_models.idm_desired_gap)
_interaction = shared(driver_models.idm_interaction)
_safe_speed = shared(driver_models.krauss_safe_speed)

HARDEST_MPS2 = 9.0
"""Nobody brakes harder, m/s2 (SUMO's emergency braking of cars)."""

ROUNDED = 0.7
"""Outlines have corners rounded by this share of half their smaller side (as in the challenge)."""

MOST_TTC_S = 5.0
"""Longer times to collision count as this, s (as in the challenge)."""

WIDEST_ANGLE, NARROW_ANGLE = math.radians(75.0), math.radians(10.0)
"""Leaders head at most this far from the follower's heading; where they overlap its trail by less
than `NARROW_M`, this far, rad (as in the challenge)."""

NARROW_M = 0.5


@compiled
def drive_on(
    law: int, numbers: Any, residual: Any, dawdle: Any, x0: Any, v0: Any, half: Any, path: Any,
    path_lane: Any, path_start: Any, h: float,
) -> Any:  # fmt: skip
    """(2, n, S) distances along their paths, m, and speeds, m/s, of vehicles driven on together.

    Args:
        law: 0: IDM, 1: Krauss's.
        numbers: (n, 5) desired speed, time headway, minimum gap, largest acceleration, comfortable
            braking; in m and s.
        residual: (n, S) acceleration that is added, m/s2.
        dawdle: (n, S) share of a step's acceleration that is not used.
        x0: (n,) distance along the path at the start, m.
        v0: (n,) speed at the start, m/s.
        half: (n,) half the lengths, m.
        path: (n,) path of each; -1: the vehicle keeps its speed and is nobody's leader.
        path_lane: (Q, P) lanes of each path in order, -1 after the last.
        path_start: (Q, P) where on the path each begins, m.
        h: step, s.
    """
    n, steps = residual.shape
    out = np.empty((2, n, steps))
    x, v = x0.copy(), v0.copy()
    at = np.zeros(n, np.int64)
    lane, s, accel = np.empty(n, np.int64), np.empty(n), np.empty(n)
    for t in range(steps):
        for i in range(n):
            if path[i] < 0:
                continue
            q, k = path[i], at[i]
            while (
                k + 1 < path_lane.shape[1]
                and path_lane[q, k + 1] >= 0
                and path_start[q, k + 1] <= x[i]
            ):
                k += 1
            at[i], lane[i], s[i] = k, path_lane[q, k], x[i] - path_start[q, k]
        for i in range(n):
            if path[i] < 0:
                accel[i] = 0.0
                continue
            gap, u = math.inf, 0.0
            for j in range(n):
                if j == i or path[j] < 0:
                    continue
                for k in range(at[i], path_lane.shape[1]):
                    if path_lane[path[i], k] < 0:
                        break
                    if path_lane[path[i], k] == lane[j]:
                        ahead = path_start[path[i], k] + s[j] - x[i]
                        if ahead > 0.0 and ahead - half[i] - half[j] < gap:
                            gap, u = ahead - half[i] - half[j], v[j]
                        break
            wish, headway, least, a, b = numbers[i]
            if law == 0:
                desired = _desired_gap(v[i], u, least, headway, a, b)
                accel[i] = _free(v[i], wish, a) - a * _interaction(gap, desired)
            else:
                faster = min(v[i] + a * h, wish)
                if gap < math.inf:
                    faster = min(faster, _safe_speed(gap - least, u, headway, b))
                faster = max(faster - dawdle[i, t] * a * h, 0.0)
                accel[i] = (faster - v[i]) / h
            accel[i] = max(accel[i], -HARDEST_MPS2)
        for i in range(n):
            after = max(v[i] + h * (accel[i] + residual[i, t]), 0.0) if path[i] >= 0 else v[i]
            x[i] += 0.5 * h * (v[i] + after)
            v[i] = after
            out[0, i, t], out[1, i, t] = x[i], v[i]
    return out


@inner
def _between(dx: float, dy: float, c1: float, s1: float, l1: float, w1: float, c2: float,
             s2: float, l2: float, w2: float) -> float:  # fmt: skip
    """Signed distance between two rectangles, m: below 0 how deep they overlap.

    Args:
        dx: from the first centre to the second, m.
        dy: likewise.
        c1: cosine of the first's heading.
        s1: sine of it.
        l1: half its length, m.
        w1: half its width, m.
        c2: the same of the second.
        s2: likewise.
        l2: likewise.
        w2: likewise.
    """
    cos, sin = abs(c1 * c2 + s1 * s2), abs(c1 * s2 - s1 * c2)
    ax, ay = abs(dx * c1 + dy * s1), abs(dy * c1 - dx * s1)
    bx, by = abs(dx * c2 + dy * s2), abs(dy * c2 - dx * s2)
    apart = max(
        max(ax - l1 - l2 * cos - w2 * sin, ay - w1 - l2 * sin - w2 * cos),
        max(bx - l2 - l1 * cos - w1 * sin, by - w2 - l1 * sin - w1 * cos),
    )
    if apart <= 0.0:
        return apart
    best = math.inf
    for turn in range(2):  # corners of one, seen from the other's axes
        for p in range(-1, 2, 2):
            for q in range(-1, 2, 2):
                if turn == 0:
                    px = dx + p * l2 * c2 - q * w2 * s2
                    py = dy + p * l2 * s2 + q * w2 * c2
                    u, w, hl, hw = px * c1 + py * s1, py * c1 - px * s1, l1, w1
                else:
                    px = -dx + p * l1 * c1 - q * w1 * s1
                    py = -dy + p * l1 * s1 + q * w1 * c1
                    u, w, hl, hw = px * c2 + py * s2, py * c2 - px * s2, l2, w2
                best = min(best, math.hypot(max(abs(u) - hl, 0.0), max(abs(w) - hw, 0.0)))
    return best


@compiled
def neighbours(
    xy: Any, heading: Any, speed: Any, length: Any, width: Any, valid: Any
) -> tuple[Any, Any, Any]:
    """Distance to the nearest other, gap to the vehicle ahead, m, and time to collision, s.

    Args:
        xy: (n, T, 2) centres, m.
        heading: (n, T) rad.
        speed: (n, T) m/s; NaN where unknown.
        length: (n,) m.
        width: (n,) m.
        valid: (n, T) who is there.

    Returns:
        Three (n, T); +inf where there is none, but for the time to collision (`MOST_TTC_S`).
    """
    n, steps = heading.shape
    nearest = np.full((n, steps), np.inf)
    ahead, ttc = np.full((n, steps), np.inf), np.full((n, steps), MOST_TTC_S)
    cut = np.minimum(length, width) * 0.5 * ROUNDED
    reach = np.sqrt(length**2 + width**2) * 0.5
    for t in range(steps):
        for i in range(n):
            if not valid[i, t]:
                continue
            ci, si = math.cos(heading[i, t]), math.sin(heading[i, t])
            leader = -1
            for j in range(n):
                if j == i or not valid[j, t]:
                    continue
                dx, dy = xy[j, t, 0] - xy[i, t, 0], xy[j, t, 1] - xy[i, t, 1]
                cj, sj = math.cos(heading[j, t]), math.sin(heading[j, t])
                if math.hypot(dx, dy) - reach[i] - reach[j] < nearest[i, t]:
                    apart = _between(
                        dx, dy, ci, si, length[i] * 0.5 - cut[i], width[i] * 0.5 - cut[i],
                        cj, sj, length[j] * 0.5 - cut[j], width[j] * 0.5 - cut[j],
                    )  # fmt: skip
                    nearest[i, t] = min(nearest[i, t], apart - cut[i] - cut[j])
                cos, sin = ci * cj + si * sj, ci * sj - si * cj
                angle = abs(math.atan2(sin, cos))
                long = dx * ci + dy * si - 0.5 * length[i]
                long -= 0.5 * (length[j] * abs(cos) + width[j] * abs(sin))
                across = abs(dy * ci - dx * si) - 0.5 * width[i]
                across -= 0.5 * (length[j] * abs(sin) + width[j] * abs(cos))
                follows = long > 0.0 and angle <= WIDEST_ANGLE and across < 0.0
                follows = follows and (across < -NARROW_M or angle <= NARROW_ANGLE)
                if follows and long < ahead[i, t]:
                    ahead[i, t], leader = long, j
            if leader >= 0:
                closing = speed[i, t] - speed[leader, t]
                if closing > 0.0:
                    ttc[i, t] = min(ahead[i, t] / closing, MOST_TTC_S)
    return nearest, ahead, ttc
