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
from sim.road import Connection, Road
from sim.scenario import AgentSpec
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


@dataclass(frozen=True, slots=True)
class Approach:
    """The junction at the end of an edge, for one next edge.

    Attributes:
        lanes: indices of the edge's lanes from which the next edge can be reached.
        signal: whether a signal controls it.
        stop: whether there is a stop sign.
        crossings: ids of the crossings on the way where pedestrians may walk at the same time.
        on_red: ids of all crossings on the way, which vehicles that run a red light may meet.
    """

    lanes: frozenset[int]
    signal: bool
    stop: bool
    crossings: frozenset[str]
    on_red: frozenset[str]


def approaches(road: Road) -> dict[tuple[str, str], Approach]:
    """The approaches of a road, by edge and next edge."""
    lanes = {lane.id: lane for lane in road.lanes}
    links: dict[tuple[str, str], list[Connection]] = {}
    for link in road.connections:
        edges = (lanes[link.from_lane].edge, lanes[link.to_lane].edge)
        links.setdefault(edges, []).append(link)
    found = {}
    for edges, ways in links.items():
        crossed = [one for one in road.crossings if set(edges) & set(one.edges)]
        found[edges] = Approach(
            lanes=frozenset(lanes[link.from_lane].index for link in ways),
            signal=any(link.signal >= 0 for link in ways),
            stop=any(link.must_stop for link in ways),
            crossings=frozenset(
                one.id
                for one in crossed
                if any(road.green_together(link.signal, one.signal) for link in ways)
            ),
            on_red=frozenset(one.id for one in crossed),
        )
    return found


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
            if not driver.near:
                away_m = 0.0
                if lane is not None:
                    away_m = lane.length_m - sumo.vehicle_getLanePosition(name)
                away_m = away_m if ahead is None else away_m - DECIDES_M
                driver.near = ahead is not None and away_m <= 0
                last = edge == driver.agent.route[-1]
                wait_s = math.inf if last else max(away_m, 0.0) / self._fastest_mps
                driver.next_check_s = time_s + wait_s
            mode = ORDINARY_SPEED_MODE
            if driver.near and ahead is not None:
                if occupied is None:
                    occupied = self._occupied(persons)
                mode = self._decide(driver, ahead, occupied)
            if mode != driver.mode:
                sumo.vehicle_setSpeedMode(name, mode)
                driver.mode = mode

    def _enter(self, driver: _RuleBreaker, edge: str) -> None:
        """Draw what the driver will do at the next junction's signal and stop line."""

        def draws(chance: float) -> bool:
            return bool(driver.rng.random() < chance)

        profile = driver.profile
        driver.edge, driver.refuses, driver.near = edge, False, False
        driver.runs_red = draws(profile.red_run_probability)
        driver.rolls = draws(profile.stop_roll_probability)
        chance = profile.overlook_probability  # of whom it has to yield to, and of the light
        driver.overlooks = chance > 0 and draws(chance)
        driver.runs_red |= chance > 0 and draws(chance)
        driver.decided.clear()

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
