"""Cutting in: a change into the small gap in front of a chosen car on the next lane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from behaviors.profiles import Profile
from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import (
    FORCED_LANE_CHANGES,
    LANE_CHANGES,
    Controller,
    RandomTimeDriver,
    drivable,
)
from sim.sumo.control.obedience import approaches

LARGEST_HEADWAY_S: Final = 0.45
"""Largest time gap left to the victim when the vehicle touches the new lane, s; a lane change into
less than one second counts as cutting in."""

FRONT_SHARE: Final = 0.75
"""The new leader must be at least this share of the own time headway ahead (without this check
cut-ins end in collisions)."""

HARDEST_BRAKING_MPS2: Final = 3.5
"""Hardest braking that a cut-in may force on its victim, m/s2 (comfortable to most drivers,
AASHTO)."""

SMALLEST_GAP_M: Final = 1.0
"""Smallest gap ahead and behind, m."""

SLOWEST_CUT_IN_MPS: Final = 4.0
"""Drivers slower than this do not cut in, m/s."""

MANOEUVRE_S: Final = 4.0
"""For how long the lane change is commanded, s; it takes 2.5 s."""

SPARE_M: Final = 0.3
"""The victim keeps at least this much beyond its standstill gap, else SUMO delays the change."""

TOUCHING_S: Final = 0.6
"""When the vehicle touches the new lane, s: a car is 0.7 m from the marking and a lane change takes
2.5 s."""

MATCHING_S: Final = 0.4
"""A faster driver moves ahead by this times the speed difference while slowing to the victim's
speed, s."""

HALF_CHANGE_S: Final = 1.4
"""When the centre is on the new lane, s; until then the driver keeps the victim's speed."""

RETRY_S: Final = 0.2
"""A driver that finds no gap looks again after this, s."""

FALLING_BACK_MPS: Final = 2.5
"""A driver whose victim is too far behind falls back at this speed, m/s."""

FALLING_BACK_S: Final = 6.0
"""Longest time to fall back before a cut-in, s."""

JUNCTION_M: Final = 30.0
"""No cut-in starts closer to a junction, m."""

_NEIGHBOURS: Final[dict[int, tuple[int, int]]] = {1: (0b000, 0b010), -1: (0b001, 0b011)}
"""SUMO's neighbour queries (follower, leader) on the lane to the left (1) and to the right (-1)."""


@dataclass(slots=True)
class _CuttingInDriver(RandomTimeDriver):
    until_s: float = -1.0
    paced: bool = False
    falls_back: bool = False


class CuttingIn(Controller[_CuttingInDriver]):
    """Makes drivers cut in as often as their profiles say, where the gaps allow it."""

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._approaches = approaches(road)
        self._drivable = drivable(road)
        self._wide = {edge for edge, i in self._drivable if (edge, i + 1) in self._drivable}
        super().__init__(sumo, road, agents)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _CuttingInDriver | None:
        rate, can = profile.cut_in_rate_per_min, not self._wide.isdisjoint(agent.route)
        return _CuttingInDriver(agent, 2, rate) if rate > 0 and can else None

    def step(self, time_s: float) -> None:
        """Begin and end cut-ins at a simulated time, s."""
        for name, driver in self._present:
            if driver.until_s >= 0:
                if driver.paced and time_s >= driver.until_s - MANOEUVRE_S + HALF_CHANGE_S:
                    self._sumo.vehicle_setSpeed(name, -1.0)
                    driver.paced = False
                if time_s >= driver.until_s:
                    self._sumo.vehicle_setLaneChangeMode(name, LANE_CHANGES)
                    driver.until_s = -1.0
            elif time_s >= driver.next_s:
                if self._cut_in(name, driver):
                    driver.until_s = time_s + MANOEUVRE_S
                    driver.paced = True
                    driver.pause_from(driver.until_s)
                else:
                    driver.next_s = time_s + RETRY_S
                    if driver.paced and not driver.falls_back:
                        self._sumo.vehicle_setSpeed(name, -1.0)
                    driver.paced = driver.falls_back

    def _cut_in(self, name: str, driver: _CuttingInDriver) -> bool:
        """Cut in now if there is a car to cut in on and room for it."""
        sumo = self._sumo
        driver.falls_back = False
        speed = sumo.vehicle_getSpeed(name)
        lane = self._lanes.get(sumo.vehicle_getLaneID(name))
        if lane is None or speed < SLOWEST_CUT_IN_MPS:
            return False
        if lane.length_m - sumo.vehicle_getLanePosition(name) < JUNCTION_M:
            return False
        onward = self._approaches.get((lane.edge, driver.following.get(lane.edge, "")))
        for side, (behind, ahead) in _NEIGHBOURS.items():
            target = lane.index + side
            leads_on = onward is None or target in onward.lanes
            if (lane.edge, target) not in self._drivable or not leads_on:
                continue
            pace, near = self._pace(name, behind, speed)
            if pace and self._room(name, driver.profile, ahead, speed, pace):
                sumo.vehicle_setSpeed(name, pace)
                driver.falls_back = not near
                if near:
                    sumo.vehicle_setLaneChangeMode(name, FORCED_LANE_CHANGES)
                    sumo.vehicle_changeLane(name, target, MANOEUVRE_S)
                return near
        return False

    def _pace(self, name: str, side: int, speed: float) -> tuple[float, bool]:
        """The speed to cut in at or to fall back at, 0 for none, and whether the victim is near."""
        for victim, net_gap in self._sumo.vehicle_getNeighbors(name, side):
            gap = net_gap + self._sumo.vehicle_getMinGap(victim)
            theirs = self._sumo.vehicle_getSpeed(victim)
            faster = speed - theirs
            left = gap + faster * (MATCHING_S if faster > 0 else TOUCHING_S)
            braking = min(faster, 0.0) ** 2 / (2 * max(gap - SMALLEST_GAP_M, 0.01))
            if net_gap < SPARE_M or left < SMALLEST_GAP_M or braking > HARDEST_BRAKING_MPS2:
                return 0.0, False
            if left <= LARGEST_HEADWAY_S * theirs:
                return float(max(theirs, SLOWEST_CUT_IN_MPS)), True
            falling = theirs - FALLING_BACK_MPS
            far = left - LARGEST_HEADWAY_S * theirs
            if falling > SLOWEST_CUT_IN_MPS and far < FALLING_BACK_S * FALLING_BACK_MPS:
                return float(falling), False
        return 0.0, False

    def _room(self, name: str, profile: Profile, side: int, speed: float, pace: float) -> bool:
        """Whether the gap to the new leader suffices at that pace."""
        for leader, net_gap in self._sumo.vehicle_getNeighbors(name, side):
            closing = max(speed - self._sumo.vehicle_getSpeed(leader), 0.0)
            wanted = SMALLEST_GAP_M + FRONT_SHARE * profile.time_headway_s * pace
            wanted += closing**2 / (2 * HARDEST_BRAKING_MPS2)
            return bool(net_gap + profile.min_gap_m > wanted)
        return True
