"""Cutting in: a change into the small gap in front of a chosen car on the next lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.approaches import approaches
from sim.sumo.control.drivers import Steered
from sim.sumo.control.lane_change_mode import COLLISIONS_ONLY, ORDINARY

LARGEST_HEADWAY_S: Final = 0.45
"""The gap left to the chosen car is below this when the box touches the new lane; below one second
is what counts as cutting in."""

FRONT_SHARE: Final = 0.75
"""Share of the own time headway that the new leader must be away (our choice: without this check
cut-ins end in collisions)."""

HARDEST_BRAKING_MPS2: Final = 3.5
"""No cut-in forces its victim to brake harder (our choice: still comfortable to most, AASHTO)."""

SMALLEST_GAP_M: Final = 1.0
"""Never closer than this, before or behind (our choice)."""

SLOWEST_MPS: Final = 4.0
"""Nobody cuts in while crawling (our choice)."""

MANOEUVRE_S: Final = 4.0
"""For how long a change is commanded: it takes 2.5 s."""

ROOM_M: Final = 0.3
"""The victim keeps at least this much beyond its standstill gap, else SUMO delays the change."""

TOUCHING_S: Final = 0.6
"""When the box touches the new lane: a car is 0.7 m from the marking and a change takes 2.5 s."""

MATCHING_S: Final = 0.4
"""A faster driver gains speed difference times this while falling back to the victim's speed."""

HALF_CHANGE_S: Final = 1.4
"""When the centre is on the new lane; until then the victim's speed is kept."""

RETRY_S: Final = 0.2
"""Who finds no gap looks again after this long (our choice)."""

FALLING_BACK_MPS: Final = 2.5
"""Who has somebody to cut in on, but too far behind, falls back at this speed (our choice)."""

FALLING_BACK_S: Final = 6.0
"""Nobody falls back for longer than this to cut in (our choice)."""

CLEAR_M: Final = 30.0
"""No cut-in starts closer to a junction (our choice)."""

_NEIGHBOURS: Final[dict[int, tuple[int, int]]] = {1: (0b000, 0b010), -1: (0b001, 0b011)}
"""SUMO's neighbour queries (follower, leader) on the lane to the left (1) and to the right (-1)."""


@dataclass(slots=True)
class _Driver:
    """One driver who cuts in."""

    agent: AgentSpec
    following: Mapping[str, str]
    rng: np.random.Generator
    wish_s: float
    until_s: float = -1.0
    paced: bool = False
    falls_back: bool = False


class CuttingIn(Steered[_Driver]):
    """Makes drivers cut in as often as their profiles wish, where the gaps allow it.

    Args:
        sumo: libsumo's C module.
        road: the road.
        agents: everyone; those who never cut in are left alone.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        super().__init__()
        self._sumo = sumo
        self._approaches = approaches(road)
        self._lanes = {lane.id: lane for lane in road.lanes if not lane.internal}
        self._length = {lane.id: lane.length_m for lane in road.lanes}
        self._drivable = frozenset(
            (lane.edge, lane.index) for lane in road.lanes if not lane.walking
        )
        wide = {edge for edge, index in self._drivable if (edge, index + 1) in self._drivable}
        for agent in agents:
            if not wide.intersection(agent.route):
                continue
            if agent.profile is not None and agent.profile.cut_in_rate_per_min > 0:
                rng = np.random.default_rng((agent.seed, 2))
                driver = _Driver(
                    agent, dict(zip(agent.route, agent.route[1:], strict=False)), rng, 0
                )
                driver.wish_s = agent.depart_s + _pause_s(driver)
                self._drivers[str(agent.id)] = driver

    def step(self, time_s: float) -> None:
        """Begin and end cut-ins.

        Args:
            time_s: simulated time, s.
        """
        for name, driver in self._here:
            if driver.until_s >= 0:
                if driver.paced and time_s >= driver.until_s - MANOEUVRE_S + HALF_CHANGE_S:
                    self._sumo.vehicle_setSpeed(name, -1.0)
                    driver.paced = False
                if time_s >= driver.until_s:
                    self._sumo.vehicle_setLaneChangeMode(name, ORDINARY)
                    driver.until_s = -1.0
            elif time_s >= driver.wish_s:
                if self._cut_in(name, driver):
                    driver.until_s = time_s + MANOEUVRE_S
                    driver.paced = True
                    driver.wish_s = driver.until_s + _pause_s(driver)
                else:
                    driver.wish_s = time_s + RETRY_S
                    if driver.paced and not driver.falls_back:
                        self._sumo.vehicle_setSpeed(name, -1.0)
                    driver.paced = driver.falls_back

    def _cut_in(self, name: str, driver: _Driver) -> bool:
        """Cut in now if there is a car to cut in on and room for it."""
        sumo = self._sumo
        driver.falls_back = False
        speed = sumo.vehicle_getSpeed(name)
        lane = self._lanes.get(sumo.vehicle_getLaneID(name))
        if lane is None or speed < SLOWEST_MPS:
            return False
        if self._length[lane.id] - sumo.vehicle_getLanePosition(name) < CLEAR_M:
            return False
        onward = self._approaches.get((lane.edge, driver.following.get(lane.edge, "")))
        for side in (1, -1):
            target = lane.index + side
            if (lane.edge, target) not in self._drivable:
                continue
            if onward is not None and target not in onward.lanes:
                continue
            behind, ahead = _NEIGHBOURS[side]
            pace, near = self._pace(name, behind, speed)
            if not pace or not self._room(name, driver, ahead, speed, pace):
                continue
            sumo.vehicle_setSpeed(name, pace)
            if near:
                sumo.vehicle_setLaneChangeMode(name, COLLISIONS_ONLY)
                sumo.vehicle_changeLane(name, target, MANOEUVRE_S)
                return True
            driver.falls_back = True
            return False
        return False

    def _pace(self, name: str, side: int, speed: float) -> tuple[float, bool]:
        """The speed at which to cut in on whoever follows there, and whether they are near enough.

        If they are not, it is the speed at which to fall back to them; 0 if it is not worth it.
        The victim must be cut off, not hit: the gap that will be left when the box touches the
        new lane lies between the smallest gap and the largest headway, and does not make the
        victim brake too hard.
        """
        for victim, net_gap in self._sumo.vehicle_getNeighbors(name, side):
            gap = net_gap + self._sumo.vehicle_getMinGap(victim)
            theirs = self._sumo.vehicle_getSpeed(victim)
            faster = speed - theirs
            left = gap + faster * (MATCHING_S if faster > 0 else TOUCHING_S)
            braking = min(faster, 0.0) ** 2 / (2 * max(gap - SMALLEST_GAP_M, 0.01))
            if net_gap < ROOM_M or left < SMALLEST_GAP_M or braking > HARDEST_BRAKING_MPS2:
                return 0.0, False
            if left <= LARGEST_HEADWAY_S * theirs:
                return float(max(theirs, SLOWEST_MPS)), True
            falling = theirs - FALLING_BACK_MPS
            far = left - LARGEST_HEADWAY_S * theirs
            if falling > SLOWEST_MPS and far < FALLING_BACK_S * FALLING_BACK_MPS:
                return float(falling), False
        return 0.0, False

    def _room(self, name: str, driver: _Driver, side: int, speed: float, pace: float) -> bool:
        """Whether the front gap suffices at that pace."""
        profile = driver.agent.profile
        assert profile is not None
        for leader, net_gap in self._sumo.vehicle_getNeighbors(name, side):
            gap = net_gap + profile.min_gap_m
            closing = max(speed - self._sumo.vehicle_getSpeed(leader), 0.0)
            wanted = SMALLEST_GAP_M + FRONT_SHARE * profile.time_headway_s * pace
            wanted += closing**2 / (2 * HARDEST_BRAKING_MPS2)
            return bool(gap > wanted)
        return True


def _pause_s(driver: _Driver) -> float:
    """Time until the next wish, s."""
    profile = driver.agent.profile
    assert profile is not None
    return float(driver.rng.exponential(60.0 / profile.cut_in_rate_per_min))
