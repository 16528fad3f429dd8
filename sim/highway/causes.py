"""Who caused a collision, by the rules of the road, and why.

Tried in order: running a red light, driving on the wrong side, cutting in, not keeping the gap to
the one ahead, not giving way. A pedestrian is never held to have caused one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from highway_env.vehicle.kinematics import Vehicle

from sim.highway.rules import rank_of
from sim.highway.walkers import Walker

if TYPE_CHECKING:
    from sim.highway.traffic import TrafficRoad

CUT_IN_S: Final = 3.0
"""Being hit from behind this soon after a lane change is the changer's doing (our choice)."""

SAME_WAY: Final = 0.5
"""Headings less than 60 degrees apart are the same way."""


def cause_of(
    road: TrafficRoad, a: Vehicle, b: Vehicle | Walker
) -> tuple[Vehicle, Vehicle | Walker, str]:
    """The one that caused a collision, the other one, and why.

    Args:
        road: where it happened.
        a: a vehicle.
        b: another vehicle, or a pedestrian.
    """
    if isinstance(b, Walker):
        return a, b, "did not give way to a pedestrian"
    for one, other in ((a, b), (b, a)):
        if one.crashed and not other.crashed:
            return other, one, "ran into a crashed vehicle"
    for one, other in ((a, b), (b, a)):
        if getattr(one, "ran_red", False) and not getattr(other, "ran_red", False):
            return one, other, "ran a red light"
    for one, other in ((a, b), (b, a)):
        if getattr(one, "wrong_way", False):
            return one, other, "drove on the wrong side"
    if math.cos(a.heading - b.heading) > SAME_WAY:
        ahead = float((b.position - a.position) @ a.direction) > 0.0
        rear, front = (a, b) if ahead else (b, a)
        changed = getattr(front, "changed_at", -math.inf)
        if getattr(front, "clock", 0.0) - changed < CUT_IN_S:
            return front, rear, "cut in"
        changed = getattr(rear, "changed_at", -math.inf)
        if getattr(rear, "clock", 0.0) - changed < CUT_IN_S:
            return rear, front, "changed lanes into another vehicle"
        return rear, front, "did not keep the gap"
    if rank_of(road, a) > rank_of(road, b):
        return a, b, "did not give way"
    if rank_of(road, a) < rank_of(road, b):
        return b, a, "did not give way"
    first = float((b.position - a.position) @ a.direction) > 0.0
    return (a, b, "drove into another vehicle") if first else (b, a, "drove into another vehicle")
