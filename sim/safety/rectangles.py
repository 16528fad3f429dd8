"""Rectangles that move on straight lines: when they meet, how far apart they are (compiled).

Two rectangles overlap where their projections onto each of their four axes overlap (the separating
axis theorem). Without turning, a projection's place is a polynomial of time, so every question
about meeting is one about four intervals of time.

Axes are numbered: along the first body, to its left, along the second body, to its left.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from sim.compiled import in_place
from sim.frames import FloatArray

SLABS: Final = 6
"""Bounds on two times: one for each axis, and one for the range of each time."""

MOST_JUMPS: Final = 32
"""Bound on the jumps of a phase: four axes, of which each separates at most three times."""

EXACT: Final = 1e-9
"""Relative error of places that counts as rounding."""


@in_place(inner=True)
def on_axes(x: Any, y: Any, ahead: Any, ahead_2: Any) -> Any:
    """The four components of a vector along the axes of two bodies."""
    c, s = ahead
    c_2, s_2 = ahead_2
    return x * c + y * s, y * c - x * s, x * c_2 + y * s_2, y * c_2 - x * s_2


@in_place(inner=True)
def reaches(ahead: Any, half: Any, ahead_2: Any, half_2: Any) -> Any:
    """How near the centres of two bodies come to each other on the four axes, m."""
    cosine = abs(ahead[0] * ahead_2[0] + ahead[1] * ahead_2[1])
    sine = abs(ahead[0] * ahead_2[1] - ahead[1] * ahead_2[0])
    return (
        half[0] + half_2[0] * cosine + half_2[1] * sine,
        half[1] + half_2[0] * sine + half_2[1] * cosine,
        half_2[0] + half[0] * cosine + half[1] * sine,
        half_2[1] + half[0] * sine + half[1] * cosine,
    )


@in_place(inner=True)
def to_corners(u: Any, v: Any, half: Any, cosine: Any, sine: Any, half_2: Any) -> Any:
    """Shortest way, along and to the left, from a body to a corner of one at (u, v), turned."""
    best, along, aside = np.inf, 0.0, 0.0
    for k in range(4):
        long = half_2[0] if k & 1 else -half_2[0]
        wide = half_2[1] if k & 2 else -half_2[1]
        x, y = u + long * cosine - wide * sine, v + long * sine + wide * cosine
        x -= min(max(x, -half[0]), half[0])
        y -= min(max(y, -half[1]), half[1])
        if x * x + y * y < best:
            best, along, aside = x * x + y * y, x, y
    return best, along, aside


@in_place(inner=True)
def nearest(place: Any, ahead: Any, half: Any, ahead_2: Any, half_2: Any) -> Any:
    """Shortest way from the first to the second of two bodies apart, in x and y, m."""
    c, s = ahead
    c_2, s_2 = ahead_2
    cosine, sine = c * c_2 + s * s_2, c * s_2 - s * c_2
    best, u, v = to_corners(place[0], place[1], half, cosine, sine, half_2)
    best_2, u_2, v_2 = to_corners(-place[2], -place[3], half_2, cosine, -sine, half)
    if best <= best_2:
        return u * c - v * s, u * s + v * c
    return v_2 * s_2 - u_2 * c_2, -u_2 * s_2 - v_2 * c_2


@in_place(inner=True)
def meeting(place: Any, rate: Any, reach: Any) -> Any:
    """First time from now at which bodies of constant velocity touch, s; inf for never."""
    enter, leave = 0.0, np.inf
    for k in range(4):
        p, q, r = place[k], rate[k], reach[k]
        if q < 0.0:
            p, q = -p, -q
        if q > 0.0:
            enter = max(enter, (-r - p) / q)
            leave = min(leave, (r - p) / q)
        elif abs(p) > r:
            return np.inf
    return enter if enter <= leave else np.inf


@in_place(inner=True)
def braking_time(speed: Any, acceleration: Any) -> Any:
    """Time until a body stands, s: inf if it never does; 0 if it stands and is braked."""
    if speed * acceleration < 0.0:
        return -speed / acceleration
    return np.inf if acceleration > 0.0 or speed != 0.0 else 0.0


@in_place(inner=True)
def way(speed: Any, acceleration: Any, stands_s: Any, begin: Any) -> Any:
    """Coefficients of a body's way in a phase that begins at a time: m, m/s, m/s2 over two."""
    if begin >= stands_s:
        return 0.5 * speed * stands_s if stands_s > 0.0 else 0.0, 0.0, 0.0
    return 0.0, speed, 0.5 * acceleration


@in_place(inner=True)
def meeting_accelerated(
    place: Any, unit: Any, unit_2: Any, reach: Any, motion: Any, motion_2: Any
) -> Any:
    """`meeting` of bodies whose accelerations stay until they stand; ``motion``: speed and it.

    Both ways are quadratic between the times at which one of them comes to stand. Within such a
    phase, the time jumps to the next one at which the projections on a separating axis meet, until
    no axis separates.
    """
    stands, stands_2 = braking_time(*motion), braking_time(*motion_2)
    begin = 0.0
    for end in (min(stands, stands_2), max(stands, stands_2), np.inf):
        if end <= begin:
            continue
        a, b, c = way(motion[0], motion[1], stands, begin)
        a_2, b_2, c_2 = way(motion_2[0], motion_2[1], stands_2, begin)
        t, jumped = begin, True
        for _ in range(MOST_JUMPS):
            if not jumped or t >= end:
                break
            jumped = False
            for k in range(4):
                p = place[k] + unit_2[k] * a_2 - unit[k] * a
                q = unit_2[k] * b_2 - unit[k] * b
                w = unit_2[k] * c_2 - unit[k] * c
                f = p + t * (q + t * w)
                rounding = EXACT * (abs(p) + t * (abs(q) + t * abs(w)) + reach[k])
                if abs(f) - reach[k] <= rounding:
                    continue
                side = 1.0 if f > 0.0 else -1.0
                t += falls(abs(f) - reach[k], side * (q + 2.0 * w * t), side * w)
                jumped = True
                if t >= end:
                    break
        if not jumped:
            return t
        begin = end
    return np.inf


@in_place(inner=True)
def falls(height: Any, rate: Any, half_change: Any) -> Any:
    """First time at which a positive height + rate t + half_change t^2 is 0; inf for never."""
    inside = rate * rate - 4.0 * height * half_change
    if inside < 0.0:
        return np.inf
    root = math.sqrt(inside)
    if rate > 0.0:
        return (rate + root) / (-2.0 * half_change) if half_change < 0.0 else np.inf
    return 2.0 * height / (root - rate) if root > rate else np.inf


@in_place(inner=True)
def least_shift(
    place: Any, rate: Any, rate_2: Any, reach: Any, until: Any, until_2: Any, slab: Any
) -> Any:
    """The least time by which the second body must be later than the first where both have been.

    The first is at a place at a time t in [0, until], the second at the same place at t + shift in
    [0, until_2]. Each axis bounds t between two parallel lines over the shift; so does each range.
    The shifts at which every lower line is below every upper one are an interval.

    ``rate`` and ``rate_2`` are the velocities along the axes; ``slab`` is scratch for each bound's
    slope and intercepts. Returns the least and the greatest shift and a time t at the least one;
    the least is above the greatest where the bodies share no place.
    """
    low, high, n = -np.inf, np.inf, 0
    for k in range(4):
        w = rate_2[k] - rate[k]
        if abs(w) > EXACT * (abs(rate[k]) + abs(rate_2[k])):
            slab[n, 0] = -rate_2[k] / w
            slab[n, 1] = (-place[k] - math.copysign(reach[k], w)) / w
            slab[n, 2] = (-place[k] + math.copysign(reach[k], w)) / w
            n += 1
        elif abs(rate_2[k]) > 0.0:
            far = math.copysign(reach[k], rate_2[k])
            low = max(low, (-place[k] - far) / rate_2[k])
            high = min(high, (-place[k] + far) / rate_2[k])
        elif abs(place[k]) > reach[k]:
            return np.inf, -np.inf, 0.0
    slab[n, 0], slab[n, 1], slab[n, 2] = 0.0, 0.0, until
    slab[n + 1, 0], slab[n + 1, 1], slab[n + 1, 2] = -1.0, 0.0, until_2
    for i in range(n + 1, 0, -1):
        for k in range(i):
            steeper = slab[i, 0] - slab[k, 0]
            above, below = slab[k, 2] - slab[i, 1], slab[i, 2] - slab[k, 1]
            if steeper > 0.0:
                high, low = min(high, above / steeper), max(low, -below / steeper)
            elif steeper < 0.0:
                high, low = min(high, -below / steeper), max(low, above / steeper)
            elif above < 0.0 or below < 0.0:
                return np.inf, -np.inf, 0.0
        if low > high:
            return low, high, 0.0
    t = 0.0
    if low > -np.inf:
        for i in range(n + 2):
            t = max(t, slab[i, 1] + slab[i, 0] * low)
    return low, high, t


@in_place()
def measure(first: FloatArray, second: FloatArray, found: FloatArray, slab: FloatArray) -> None:
    """Everything that `sim.safety.measures.PairMeasures` lists.

    Rows of the bodies: x, y, heading, speed, acceleration, length, width; ``slab`` is scratch.
    """
    for i in range(first.shape[1]):
        dx, dy = second[0, i] - first[0, i], second[1, i] - first[1, i]
        ahead = math.cos(first[2, i]), math.sin(first[2, i])
        ahead_2 = math.cos(second[2, i]), math.sin(second[2, i])
        v, v_2 = first[3, i], second[3, i]
        half = 0.5 * first[5, i], 0.5 * first[6, i]
        half_2 = 0.5 * second[5, i], 0.5 * second[6, i]
        known = dx + dy + ahead[0] + ahead_2[0] + v + v_2
        if not math.isfinite(known + half[0] + half[1] + half_2[0] + half_2[1]):
            found[:, i] = np.nan
            continue
        place = on_axes(dx, dy, ahead, ahead_2)
        reach = reaches(ahead, half, ahead_2, half_2)
        unit = on_axes(ahead[0], ahead[1], ahead, ahead_2)
        unit_2 = on_axes(ahead_2[0], ahead_2[1], ahead, ahead_2)
        rate = v * unit[0], 0.0, v * unit[2], v * unit[3]
        rate_2 = v_2 * unit_2[0], v_2 * unit_2[1], v_2 * unit_2[2], 0.0
        vx, vy = v_2 * ahead_2[0] - v * ahead[0], v_2 * ahead_2[1] - v * ahead[1]
        between = on_axes(vx, vy, ahead, ahead_2)
        ttc = meeting(place, between, reach)
        gap, closing, drac = 0.0, 0.0, np.inf
        if ttc > 0.0:
            x, y = nearest(place, ahead, half, ahead_2, half_2)
            gap = math.sqrt(x * x + y * y)
            closing = -(vx * x + vy * y) / gap if gap > 0.0 else 0.0
            drac = math.sqrt(vx * vx + vy * vy) / (2.0 * ttc)
        a, a_2, mttc, advantage = first[4, i], second[4, i], ttc, 0.0
        if not math.isfinite(a + a_2):
            mttc = np.nan
        elif ttc > 0.0 and (a != 0.0 or a_2 != 0.0):
            mttc = meeting_accelerated(place, unit, unit_2, reach, (v, a), (v_2, a_2))
        if ttc == np.inf:
            low, high, _ = least_shift(place, rate, rate_2, reach, np.inf, np.inf, slab)
            advantage = np.nan if low > high else max(low, -high, 0.0)
        for k, value in enumerate((gap, closing, ttc, mttc, drac, advantage)):
            found[k, i] = value
