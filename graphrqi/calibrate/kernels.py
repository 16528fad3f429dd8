"""Compiled: a drive by a law behind a recorded leader, and the smoothing of measured motion."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from behaviors.driver_models import (
    idm_desired_gap,
    idm_free_acceleration,
    idm_interaction,
    krauss_safe_speed,
)
from sim.compiled import compiled, inner, shared

HARDEST_MPS2: Final = 10.0
"""No law brakes harder, m/s2 (tyres on a dry road)."""

LEAST_GAP_M: Final = 0.2
"""Gaps count as no smaller, m (our choice: measured ones may be negative)."""

PRESSES_MPS2: Final = 1.0
"""Who brakes harder by its law does not press forward beside it, m/s2 (our choice: hardly any
foretold gap differs by it, but one of I-80's training pairs would collide under Krauss's law)."""

FREE: Final = shared(idm_free_acceleration)
DESIRED_GAP: Final = shared(idm_desired_gap)
INTERACTION: Final = shared(idm_interaction)
SAFE_SPEED: Final = shared(krauss_safe_speed)


@inner
def accelerate(law: Any, n: Any, v: Any, u: Any, gap: Any, h: Any) -> Any:
    """A law's acceleration, m/s2.

    Args:
        law: code of the law.
        n: (D,) the driver's numbers.
        v: speed, m/s.
        u: the leader's speed, m/s.
        gap: bumper to bumper, m; infinite without a leader.
        h: step, s.
    """
    v0, headway, s0, a, b = n[0], n[1], n[2], n[3], n[4]
    if law == 0:
        accel = FREE(v, v0, a)
        if gap < 1e6:
            accel -= a * INTERACTION(max(gap, LEAST_GAP_M), DESIRED_GAP(v, u, s0, headway, a, b))
    else:
        target = v0
        if gap < 1e6:
            target = min(SAFE_SPEED(gap - s0, u, headway, b), v0)
        accel = min((target - v) / math.sqrt(h * h + n[7] * n[7]), a)
    return max(accel, -HARDEST_MPS2)


@compiled
def drive_on(law: Any, n: Any, drive: Any, h: Any, residual: Any, kept: Any) -> Any:
    """Drive behind a recorded leader by a law, from where the driver was first seen.

    Args:
        law: code of the law.
        n: (D,) the driver's numbers.
        drive: (5, T) as in `filter.tell`: one stretch.
        h: time between rows, s.
        residual: acceleration beside the law's at first, m/s2.
        kept: which share of it is left after one row.

    Returns:
        (T,) places, m.
    """
    out = np.zeros(drive.shape[1])
    x, v = drive[0, 0], drive[2, 0]
    out[0] = x
    for i in range(1, out.size):
        u = drive[4, i - 1]
        if law == 1 and i > 1:
            u = 0.5 * (u + drive[4, i - 2])
        accel = accelerate(law, n, v, u, drive[3, i - 1] - x, h)
        if residual <= 0.0 or accel > -PRESSES_MPS2:
            accel += residual
        residual *= kept
        faster = max(v + h * accel, 0.0)
        x += 0.5 * h * (v + faster) if law == 0 else h * faster
        v = faster
        out[i] = x
    return out


@compiled
def mean_residual(law: Any, n: Any, drive: Any, places: Any, h: Any) -> Any:
    """By how much more than a law says somebody accelerates, on average.

    Args:
        law: code of the law.
        n: (D,) the driver's numbers.
        drive: (5, T) as in `filter.tell`: one stretch.
        places: (T,) of the driver, m.
        h: time between rows, s.

    Returns:
        The mean over the rows, m/s2.
    """
    count = places.size - 1
    total = (drive[2, count] - drive[2, 0]) / h
    for i in range(count):
        total -= accelerate(law, n, drive[2, i], drive[4, i], drive[3, i] - places[i], h)
    return total / count


@compiled
def local_parabolas(time_s: Any, values: Any, at_s: Any, half_s: Any, out: Any) -> None:
    """Fit a parabola to the values around each of some times, by least squares.

    Args:
        time_s: (n,) increasing, s.
        values: (n,) measured then.
        at_s: (k,) increasing, s.
        half_s: values no farther than this from a time count, s; the nearest three do in any case.
        out: (4, k) takes value, slope and second derivative at these times, and the standard
            deviation of that value over that of the measurements.
    """
    n = time_s.size
    first = 0
    for k in range(at_s.size):
        while first < n and time_s[first] < at_s[k] - half_s - 1e-9:
            first += 1
        begin, end = first, first
        while end < n and time_s[end] <= at_s[k] + half_s + 1e-9:
            end += 1
        while end - begin < 3 and (begin > 0 or end < n):
            before = at_s[k] - time_s[begin - 1] if begin > 0 else 1e9
            after = time_s[end] - at_s[k] if end < n else 1e9
            if before <= after:
                begin -= 1
            else:
                end += 1
        moments, sums = np.zeros((3, 3)), np.zeros(3)
        base = values[begin]
        for i in range(begin, end):
            t = time_s[i] - at_s[k]
            powers = (1.0, t, t * t)
            for r in range(3):
                sums[r] += powers[r] * (values[i] - base)
                for c in range(3):
                    moments[r, c] += powers[r] * powers[c]
        if end - begin < 3:
            out[0, k], out[1, k], out[2, k], out[3, k] = base, 0.0, 0.0, 1.0
            if end - begin == 2:
                slope = (values[end - 1] - base) / (time_s[end - 1] - time_s[begin])
                out[0, k], out[1, k] = base + slope * (at_s[k] - time_s[begin]), slope
            continue
        inverse = np.linalg.inv(moments)
        solved = inverse @ sums
        out[0, k], out[1, k], out[2, k] = base + solved[0], solved[1], 2.0 * solved[2]
        out[3, k] = math.sqrt(inverse[0, 0])
