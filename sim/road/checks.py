"""What every road that is read from a file must fulfil: numbers in range, names that exist."""

from __future__ import annotations

from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.geometry import distances_along
from sim.road import Road

MAX_COORDINATE_M: Final = 1e9
"""Largest absolute coordinate (beyond any UTM coordinate)."""

MAX_LENGTH_M: Final = 1e7
"""Longest that all lanes and crossings of a map may be together, m (a city's streets are some
thousand km): what is drawn of them stays small."""

MAX_WIDTH_M: Final = 1000.0
"""Widest lane, m."""


def checked(road: Road) -> Road:
    """The road itself.

    Raises:
        InputError: if its numbers or references make no road; names its file.
    """

    def require(holds: bool, where: str, expected: str) -> None:
        if not holds:
            raise InputError(f"{road.source}: {where}: found others, expected {expected}")

    lines = [lane.centerline for lane in road.lanes]
    lines += [crossing.centerline for crossing in road.crossings]
    require(all(len(line) >= 2 for line in lines), "lines", "2 points or more")
    near = all((np.abs(line) <= MAX_COORDINATE_M).all() for line in lines)
    require(near, "points", f"metres, up to {MAX_COORDINATE_M:g}")
    length_m = sum(float(distances_along(line)[-1]) for line in lines)
    require(0 < length_m <= MAX_LENGTH_M, f"{length_m:.3g} m of lanes", f"up to {MAX_LENGTH_M:g}")
    require(len(road.lane_index) == len(road.lanes), "lanes", "each id once")
    for lane in road.lanes:
        usual = 0 <= lane.width_m <= MAX_WIDTH_M and not lane.speed_limit_mps < 0
        require(usual, f"lane {lane.id!r:.60}", f"a width up to {MAX_WIDTH_M:g} m and a limit")
    ways, groups = len(road.connections), len(road.signal_groups)
    for way in road.connections:
        named = {way.from_lane, *way.via, way.to_lane}
        require(named <= road.lane_index.keys(), "connections", "lanes of the road")
        require(all(0 <= i < ways for i in way.yields_to), "yields_to", "ways of the road")
    used = [way.signal for way in road.connections] + [c.signal for c in road.crossings]
    require(all(-1 <= i < groups for i in used), "signals", f"one of the {groups} groups")
    controlled = [group for plan in road.signal_plans for group in plan.groups]
    once = len({*controlled}) == len(controlled) and {*controlled} <= {*range(groups)}
    require(once, "signal_plans", "each group once")
    for plan in road.signal_plans:
        lasts = np.array([*plan.duration_s, plan.offset_s])
        fits = len(plan.duration_s) == len(plan.states) and sum(plan.duration_s) > 0
        fits &= np.isfinite(lasts).all() and min(plan.duration_s) >= 0
        fits &= all(len(state) == len(plan.groups) for state in plan.states)
        require(fits, "signal_plans", "seconds and a state of each group per phase")
    return road
