"""Running red lights, rolling over stop lines, not yielding to pedestrians, overlooking others.

Each is decided once per encounter, with the driver's probability. SUMO's speed mode says which
rules a vehicle obeys. It differs from the ordinary mode only up to the junction of a decided
violation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from behaviors.profiles import Profile
from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.approaches import Approach, approaches
from sim.sumo.control.drivers import Controller, RouteDriver

ORDINARY_SPEED_MODE: Final = 31
"""SUMO's default speed mode: safe speed, limits of the vehicle, right of way, red lights."""

IGNORE_RED: Final = ORDINARY_SPEED_MODE & ~16
"""Ignores red lights, but not vehicles that are already in the way."""

DECIDES_M: Final = 45.0
"""How far before a junction a driver decides, m (about three seconds at 50 km/h)."""

FASTEST_LIMITS: Final = 2.5
"""An upper bound of speeds, in limits, for when a driver can be near a junction at the earliest
(reckless drivers want 1.6 limits at most)."""


@dataclass(slots=True)
class _RuleBreaker(RouteDriver):
    runs_red: bool = False
    rolls: bool = False
    overlooks: bool = False
    refuses: bool = False
    mode: int = ORDINARY_SPEED_MODE
    near: bool = False
    decided: set[str] = field(default_factory=set)


class Obedience(Controller[_RuleBreaker]):
    """Lets drivers break the rules as often as their profiles say."""

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._approaches = approaches(road)
        self._crossings = frozenset(c.id for c in road.crossings)
        self._fastest_mps = FASTEST_LIMITS * max(lane.speed_limit_mps for lane in road.lanes)
        super().__init__(sumo, road, agents)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _RuleBreaker | None:
        breaks = max(
            profile.red_run_probability,
            profile.stop_roll_probability,
            1.0 - profile.yield_probability,
            profile.overlook_probability,
        )
        return _RuleBreaker(agent, 1) if breaks > 0 else None

    def step(self, time_s: float, persons: Sequence[str]) -> None:
        """Decide and set the speed modes for the next simulation step, given the pedestrians."""
        sumo = self._sumo
        occupied: frozenset[str] | None = None
        for name, driver in self._present:
            if time_s < driver.next_check_s:
                continue
            lane = self._lanes.get(sumo.vehicle_getLaneID(name))
            edge = "" if lane is None else lane.edge
            if edge and edge != driver.edge:
                self._enter(driver, edge)
            ahead = self._approaches.get((driver.edge, driver.following.get(driver.edge, "")))
            mode = ORDINARY_SPEED_MODE
            if not driver.near:
                away_m = 0.0
                if lane is not None:
                    away_m = lane.length_m - sumo.vehicle_getLanePosition(name)
                away_m = away_m if ahead is None else away_m - DECIDES_M
                driver.near = ahead is not None and away_m <= 0
                last = edge == driver.agent.route[-1]
                driver.next_check_s = (
                    math.inf if last else time_s + max(away_m, 0.0) / self._fastest_mps
                )
            if driver.near and ahead is not None:
                if occupied is None:
                    occupied = self._occupied(persons)
                mode = self._decide(driver, ahead, occupied)
            if mode != driver.mode:
                sumo.vehicle_setSpeedMode(name, mode)
                driver.mode = mode

    def _enter(self, driver: _RuleBreaker, edge: str) -> None:
        """Draw what the driver will do at the next junction's signal and stop line."""
        profile = driver.profile
        driver.edge, driver.refuses, driver.near = edge, False, False
        driver.runs_red = bool(driver.rng.random() < profile.red_run_probability)
        driver.rolls = bool(driver.rng.random() < profile.stop_roll_probability)
        driver.overlooks = self._overlooks(driver)
        driver.runs_red |= self._overlooks(driver)
        driver.decided.clear()

    def _overlooks(self, driver: _RuleBreaker) -> bool:
        """Draw whether a driver does not see a light, or whom it has to yield to at a junction."""
        chance = driver.profile.overlook_probability
        return chance > 0 and bool(driver.rng.random() < chance)

    def _decide(self, driver: _RuleBreaker, ahead: Approach, occupied: frozenset[str]) -> int:
        profile = driver.profile
        if occupied:
            over = ahead.on_red if driver.runs_red and ahead.signal else ahead.crossings
            for crossing in sorted((over & occupied) - driver.decided):
                driver.decided.add(crossing)
                if driver.rng.random() >= profile.yield_probability:
                    driver.refuses = True
        mode = ORDINARY_SPEED_MODE
        if driver.runs_red and ahead.signal:
            mode &= IGNORE_RED
        if driver.refuses or driver.overlooks or (driver.rolls and ahead.stop):
            mode |= 32  # ignores right of way in the junction,
            if not (driver.runs_red and ahead.signal):
                mode &= ~8  # and before it
        return mode

    def _occupied(self, persons: Sequence[str]) -> frozenset[str]:
        """Crossings that a pedestrian walks on or is about to step on."""
        sumo = self._sumo
        found = set()
        for name in persons:
            place = sumo.person_getRoadID(name)
            if place in self._crossings:
                found.add(place)
            elif place.startswith(":"):
                onward = sumo.person_getNextEdge(name)
                if onward in self._crossings:
                    found.add(onward)
        return frozenset(found)
