"""The compiled part of `graphrqi.calibrate.live`."""

from __future__ import annotations

from typing import Any

from behaviors import driver_models
from sim.compiled import compiled, shared

_free = shared(driver_models.idm_free_acceleration)
_desired_gap = shared(driver_models.idm_desired_gap)
_interaction = shared(driver_models.idm_interaction)


@compiled
def tell(told: Any, numbers: Any, seen: Any, noise: float, worth: float) -> None:
    """Add to every candidate's logarithm of the likelihood what a moment tells of each driver.

    Args:
        told: (n, M) logarithms, changed.
        numbers: (M, 5) candidates: v0, T, s0, a, b of IDM.
        seen: (n, 4) speed, leader's speed, m/s, gap, m, and acceleration, m/s2.
        noise: standard deviation of an acceleration around the law, m/s2.
        worth: as so many independent observations each moment counts.
    """
    for i in range(seen.shape[0]):
        v, u, gap, accel = seen[i]
        for m in range(numbers.shape[0]):
            v0, headway, least, a, b = numbers[m]
            wanted = _desired_gap(v, u, least, headway, a, b)
            off = (accel - _free(v, v0, a) + a * _interaction(gap, wanted)) / noise
            told[i, m] -= 0.5 * worth * off * off
