"""Which of two who collide caused it by the rules of the road, and why.

Causes are tried in order: running a red light, driving on the wrong side, cutting in, not keeping
the gap to the vehicle ahead, not giving way. A pedestrian never counts as the cause.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from sim.highway.network import HighwayNetwork

CUT_IN_S: Final = 3.0
"""A vehicle that is hit from behind this soon after its lane change caused the collision, s."""

SAME_WAY: Final = 0.5
"""Cosine of the angle between two headings above which they count as the same way: 60 degrees."""

CROSSWISE: Final = 0.5
"""Sine of the angle between two headings above which the ways cross: 30 degrees."""

FROM_JUNCTION_M: Final = 15.0
"""Ways that cross this far from the ends of both do not meet in a junction, m (more than the
longest vehicle)."""


def are_on_two_levels(network: HighwayNetwork, keys: list[Any], one: Any, other: Any) -> bool:
    """Whether one of two vehicles passes over the other on a bridge.

    Roads have no heights; but lanes meet at junctions only, so where two of them cross far from
    the ends of both, one lies above the other.

    Args:
        network: the road.
        keys: the lanes by number.
        one: the row of a vehicle.
        other: of another one.
    """
    if keys[one.lane][:2] == keys[other.lane][:2]:
        return False
    if abs(math.sin(one.heading - other.heading)) < CROSSWISE:
        return False
    for vehicle in (one, other):
        lane = network.lanes[keys[vehicle.lane]]
        s = lane.local_coordinates((vehicle.x, vehicle.y))[0]
        inside = network.info[keys[vehicle.lane]].connector
        if inside or min(s, lane.length - s) < FROM_JUNCTION_M:
            return False
    return True


def find_cause(a: Any, b: Any, yields: Sequence[bool], time_s: float) -> tuple[bool, str]:
    """Who caused a collision of two vehicles, and why.

    Args:
        a: the row of a vehicle.
        b: of another one.
        yields: whether each of them drives without priority.
        time_s: the time now, s.

    Returns:
        Whether ``a`` caused it, and the reason.
    """
    if a.crashed != b.crashed:
        return bool(b.crashed), "ran into a crashed vehicle"
    if a.ran_red != b.ran_red:
        return bool(a.ran_red), "ran a red light"
    if a.wrong_way or b.wrong_way:
        return bool(a.wrong_way), "drove on the wrong side"
    towards = (b.x - a.x) * math.cos(a.heading) + (b.y - a.y) * math.sin(a.heading)
    a_first = towards > 0.0
    if math.cos(a.heading - b.heading) > SAME_WAY:
        rear, front = (a, b) if a_first else (b, a)
        if _changed_lately(front, time_s):
            return not a_first, "cut in"
        if _changed_lately(rear, time_s):
            return a_first, "changed lanes into another vehicle"
        return a_first, "did not keep the gap"
    if not a.ran_red and yields[0] != yields[1]:
        return yields[0], "did not give way"
    return a_first, "drove into another vehicle"


def _changed_lately(vehicle: Any, time_s: float) -> bool:
    clock = vehicle.clock if vehicle.profiled else time_s
    return bool(clock - vehicle.changed_at < CUT_IN_S)
