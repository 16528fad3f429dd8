"""Compiled: drives by a law of following behind a recorded leader."""

from __future__ import annotations

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
"""Gaps count as no smaller, m (measured ones may be negative)."""

REACHES_S: Final = 1.0
"""Time in which a driver reaches the safe speed of Krauss's law, s."""

PRESSES_MPS2: Final = 1.0
"""A driver that brakes harder by its law does not accelerate beside it, m/s2."""

FREE: Final = shared(idm_free_acceleration)
DESIRED_GAP: Final = shared(idm_desired_gap)
INTERACTION: Final = shared(idm_interaction)
SAFE_SPEED: Final = shared(krauss_safe_speed)


@inner
def acceleration(law: Any, numbers: Any, v: Any, u: Any, gap: Any) -> Any:
    """The acceleration, m/s2, at speed v behind a leader at speed u; an infinite gap is none."""
    wanted, headway, least, a, b = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    if law == 0:
        accel = FREE(v, wanted, a)
        if gap < 1e6:
            wish = DESIRED_GAP(v, u, least, headway, a, b)
            accel -= a * INTERACTION(max(gap, LEAST_GAP_M), wish)
    else:
        target = wanted
        if gap < 1e6:
            target = min(SAFE_SPEED(gap - least, u, headway, b), wanted)
        accel = min((target - v) / REACHES_S, a)
    return max(accel, -HARDEST_MPS2)


@compiled
def drive(
    law: Any, numbers: Any, place: Any, speed: Any, leader: Any, leader_speed: Any, step_s: Any,
    beside: Any, kept: Any,
) -> Any:  # fmt: skip
    """(M, T) places, m, of drivers behind one leader; see `graphrqi.calibrate.fit.simulated`.

    ``law`` is 0 for IDM and 1 for Krauss, ``kept`` the share of ``beside`` left after one row.
    """
    out = np.empty((len(numbers), leader.size))
    for m in range(len(numbers)):
        x, v, more = place, speed, beside[m]
        out[m, 0] = x
        for i in range(1, leader.size):
            accel = acceleration(law, numbers[m], v, leader_speed[i - 1], leader[i - 1] - x)
            if more <= 0.0 or accel > -PRESSES_MPS2:
                accel += more
            more *= kept
            faster = max(v + step_s * accel, 0.0)
            x += 0.5 * step_s * (v + faster)
            v = faster
            out[m, i] = x
    return out


@compiled
def mean_beside(
    law: Any, numbers: Any, place: Any, speed: Any, leader: Any, leader_speed: Any, step_s: Any
) -> Any:
    """(M,) by how much more than its law says each measured driver accelerates on average, m/s2."""
    out = np.empty(len(numbers))
    count = place.size - 1
    for m in range(len(numbers)):
        total = (speed[count] - speed[0]) / step_s
        for i in range(count):
            gap = leader[i] - place[i]
            total -= acceleration(law, numbers[m], speed[i], leader_speed[i], gap)
        out[m] = total / count
    return out
