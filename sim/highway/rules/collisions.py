"""Collisions: which vehicles touch, which one caused it by the rules of the road, and why.

Causes are tried in order: running a red light, driving on the wrong side, cutting in, not keeping
the gap to the vehicle ahead, not giving way. A pedestrian never counts as the cause.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.geometry import Outlines
from sim.highway.rules.junctions import right_of_way_rank
from sim.highway.state import RoadState, outlines_of
from sim.highway.walkers import Walker

FloatArray = NDArray[np.float64]

CUT_IN_S: Final = 3.0
"""A vehicle that is hit from behind this soon after its lane change caused the collision, s."""

SAME_WAY: Final = 0.5
"""Cosine of the angle between two headings above which they count as the same way: 60 degrees."""

CROSSWISE: Final = 0.5
"""Sine of the angle between two headings above which the ways cross: 30 degrees."""

FROM_JUNCTION_M: Final = 15.0
"""Ways that cross this far from the ends of both do not meet in a junction, m (more than the
longest vehicle)."""

Pair: TypeAlias = tuple[Vehicle, Vehicle | Walker]


def touching_pairs(road: RoadState) -> list[Pair]:
    """Every two vehicles, and every vehicle and pedestrian, whose outlines overlap."""
    everyone = [*road.vehicles, *road.walkers]
    n = len(road.vehicles)
    if n == 0:
        return []
    radius = np.array([one.diagonal for one in everyone]) / 2
    touching = np.zeros((n, radius.size), dtype=np.bool_)
    _find_touching(outlines_of(everyone), radius, touching)
    pairs = np.argwhere(touching).tolist()
    return [
        (everyone[i], everyone[j])
        for i, j in pairs
        if not _on_two_levels(road, everyone[i], everyone[j])
    ]


def _on_two_levels(road: RoadState, one: Vehicle, other: Vehicle | Walker) -> bool:
    """Whether one of two vehicles passes over the other on a bridge.

    Roads have no heights; but lanes meet at junctions only, so where two of them cross far from
    the ends of both, one lies above the other.
    """
    if isinstance(other, Walker) or one.lane_index[:2] == other.lane_index[:2]:
        return False
    if abs(math.sin(one.heading - other.heading)) < CROSSWISE:
        return False
    for vehicle in (one, other):
        info = road.network_info.info.get(vehicle.lane_index)
        s = vehicle.lane.local_coordinates(vehicle.position)[0]
        if info is None or info.connector or min(s, vehicle.lane.length - s) < FROM_JUNCTION_M:
            return False
    return True


@in_place()
def _find_touching(outlines: Outlines, radius: FloatArray, found: NDArray[np.bool_]) -> None:
    """Find whose outlines overlap; see `sim.geometry.separation`.

    Args:
        outlines: of the vehicles, then of the pedestrians; n in all.
        radius: (n,) half the diagonal, m.
        found: (vehicles, n) receives it above the diagonal; must be false before.
    """
    centre, forward, half = outlines.centre, outlines.forward, outlines.half
    for i in range(len(found)):
        for j in range(i + 1, len(radius)):
            dx, dy = centre[i, 0] - centre[j, 0], centre[i, 1] - centre[j, 1]
            reach = radius[i] + radius[j]
            if not dx * dx + dy * dy <= reach * reach:
                continue
            apart = False
            for one in (i, j):  # the axes of both rectangles
                ahead, aside = forward[one, 0], forward[one, 1]
                for x, y in ((ahead, aside), (-aside, ahead)):
                    reach = 0.0
                    for each in (i, j):
                        fx, fy = forward[each, 0], forward[each, 1]
                        reach += abs(fx * x + fy * y) * half[each, 0]
                        reach += abs(-fy * x + fx * y) * half[each, 1]
                    apart = apart or abs(dx * x + dy * y) - reach >= 0.0
            found[i, j] = not apart


def find_cause(road: RoadState, a: Vehicle, b: Vehicle | Walker) -> tuple[*Pair, str]:
    """Who caused a collision, the other one, and why.

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
    a_first = float((b.position - a.position) @ a.direction) > 0.0
    if math.cos(a.heading - b.heading) > SAME_WAY:
        rear, front = (a, b) if a_first else (b, a)
        if _changed_lately(front):
            return front, rear, "cut in"
        if _changed_lately(rear):
            return rear, front, "changed lanes into another vehicle"
        return rear, front, "did not keep the gap"
    ranks = right_of_way_rank(road, a), right_of_way_rank(road, b)
    if ranks[0] != ranks[1]:
        cause, other = (a, b) if ranks[0] > ranks[1] else (b, a)
        return cause, other, "did not give way"
    cause, other = (a, b) if a_first else (b, a)
    return cause, other, "drove into another vehicle"


def _changed_lately(vehicle: Vehicle) -> bool:
    changed_at = float(getattr(vehicle, "changed_at", -math.inf))
    return bool(getattr(vehicle, "clock", 0.0) - changed_at < CUT_IN_S)
