"""Collisions: who touches whom, who caused it by the rules of the road, and why.

Causes are tried in order: running a red light, driving on the wrong side, cutting in, not keeping
the gap to the vehicle ahead, not giving way. A pedestrian never counts as the cause.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from sim.geometry import separation
from sim.highway.fast_road import outlines_of
from sim.highway.rules.junctions import right_of_way_rank
from sim.highway.state import RoadState
from sim.highway.walkers import Walker

CUT_IN_S: Final = 3.0
"""A vehicle that is hit from behind this soon after its lane change caused the collision, s."""

SAME_WAY: Final = 0.5
"""Cosine of the angle between two headings above which they count as the same way: 60 degrees."""

Pair: TypeAlias = tuple[Vehicle, Vehicle | Walker]


def touching_pairs(road: RoadState) -> list[Pair]:
    """Every two vehicles, and every vehicle and pedestrian, whose outlines overlap."""
    everyone = [*road.vehicles, *road.walkers]
    n = len(road.vehicles)
    if n == 0:
        return []
    xy = np.array([one.position for one in everyone])
    radius = np.array([one.diagonal for one in everyone]) / 2
    across = xy[:n, None] - xy[None]
    near = across[..., 0] ** 2 + across[..., 1] ** 2 <= (radius[:n, None] + radius[None]) ** 2
    near &= np.arange(n)[:, None] < np.arange(len(everyone))[None]
    one, other = np.nonzero(near)
    if not one.size:
        return []
    outlines = outlines_of(everyone)
    hit = separation(outlines.rows(one), outlines.rows(other)) < 0.0
    pairs = zip(one[hit].tolist(), other[hit].tolist(), strict=True)
    return [(everyone[i], everyone[j]) for i, j in pairs]


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
