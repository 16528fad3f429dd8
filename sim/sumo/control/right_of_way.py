"""What drivers do at junctions: which rules they break, and whether they wait for others to clear.

Running red lights, rolling over stop lines, not yielding to pedestrians and overlooking others are
each decided once per encounter, with the driver's probability. SUMO's speed mode says which rules a
vehicle obeys. It differs from the ordinary mode only up to the junction of a decided violation.

SUMO's drivers enter on green, and at all-way stops, while a vehicle whose path crosses theirs still
stands in the junction, and the two clip each other's corners. Drivers that yield to pedestrians let
vehicles clear the junction, too (German road traffic regulations, section 11(1) and (3)): with the
same probability, drawn once per junction.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial.distance import cdist

from behaviors.driver_models import braking_speed
from behaviors.profiles import Profile
from sim.geometry import distances_along, points_at
from sim.road import Lane, Road
from sim.road.cells import boxes_of, near_pairs
from sim.road.lane_graph import CELL_M
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import ORDINARY_SPEED_MODE, Approach, Controller, Driver, Streets

IGNORE_RED: Final = ORDINARY_SPEED_MODE & ~16
"""Ignores red lights, but not vehicles that are already in the way."""

DECIDES_M: Final = 45.0
"""How far before a junction a driver decides, m (about three seconds at 50 km/h)."""

FASTEST_LIMITS: Final = 2.5
"""An upper bound of speeds, in limits, for when a driver can be near a junction at the earliest
(reckless drivers want 1.6 limits at most)."""

APART_M: Final = 2.5
"""Paths that come closer than this cross or join, m (a car's width and some room)."""

ELSEWHERE_S: Final = 1.0
"""A driver on a lane that leads to no such junction is looked at again after this, s."""

BEFORE_LINE_M: Final = 1.0
"""Drivers wait this far before the line, m (SUMO's own distance)."""


@dataclass(slots=True)
class _RuleBreaker(Driver):
    stream = 1
    edge: str = ""
    runs_red: bool = False
    rolls: bool = False
    overlooks: bool = False
    refuses: bool = False
    mode: int = ORDINARY_SPEED_MODE
    near: bool = False
    decided: set[str] = field(default_factory=set)


class Obedience(Controller[_RuleBreaker]):
    """Lets drivers break the rules as often as their profiles say."""

    def __init__(self, streets: Streets) -> None:
        self._crossings = frozenset(one.id for one in streets.road.crossings)
        limits = (lane.speed_limit_mps for lane in streets.road.lanes)
        self._fastest_mps = FASTEST_LIMITS * max(limits)
        super().__init__(streets)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _RuleBreaker | None:
        breaks = (
            profile.red_run_probability > 0
            or profile.stop_roll_probability > 0
            or profile.yield_probability < 1
            or profile.overlook_probability > 0
        )
        return _RuleBreaker(agent) if breaks else None

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Decide, and set the speed modes for the next simulation steps."""
        sumo = self._sumo
        occupied: frozenset[str] | None = None
        for driver in self._present:
            if time_s < driver.next_s:
                continue
            lane = self._lanes.get(sumo.vehicle_getLaneID(driver.name))
            if lane is not None and lane.edge != driver.edge:
                self._enter(driver, lane.edge)
            next_edge = driver.following.get(driver.edge, "")
            ahead = self._streets.approaches.get((driver.edge, next_edge))
            if not driver.near:
                away_m = 0.0
                if lane is not None:
                    away_m = lane.length_m - sumo.vehicle_getLanePosition(driver.name)
                away_m = away_m if ahead is None else away_m - DECIDES_M
                driver.near = ahead is not None and away_m <= 0
                last = lane is not None and lane.edge == driver.agent.route[-1]
                wait_s = math.inf if last else max(away_m, 0.0) / self._fastest_mps
                driver.next_s = time_s + wait_s
            mode = ORDINARY_SPEED_MODE
            if driver.near and ahead is not None:
                if occupied is None:
                    occupied = self._occupied(persons)
                mode = self._decide(driver, ahead, occupied)
            if mode != driver.mode:
                sumo.vehicle_setSpeedMode(driver.name, mode)
                driver.mode = mode

    def _enter(self, driver: _RuleBreaker, edge: str) -> None:
        """Draw what the driver will do at the next junction's signal and stop line."""
        profile = driver.profile
        driver.edge, driver.refuses, driver.near = edge, False, False
        driver.runs_red = driver.draws(profile.red_run_probability)
        driver.rolls = driver.draws(profile.stop_roll_probability)
        chance = profile.overlook_probability  # of whom it has to yield to, and of the light
        driver.overlooks = chance > 0 and driver.draws(chance)
        driver.runs_red |= chance > 0 and driver.draws(chance)
        driver.decided.clear()

    def _decide(self, driver: _RuleBreaker, ahead: Approach, occupied: frozenset[str]) -> int:
        """The speed mode of a driver near a junction, given the crossings with pedestrians."""
        runs_red = driver.runs_red and ahead.signal
        over = ahead.on_red if runs_red else ahead.crossings
        for crossing in sorted((over & occupied) - driver.decided):
            driver.decided.add(crossing)
            driver.refuses |= not driver.draws(driver.profile.yield_probability)
        mode = IGNORE_RED if runs_red else ORDINARY_SPEED_MODE
        if driver.refuses or driver.overlooks or (driver.rolls and ahead.stop):
            mode |= 32  # ignores right of way in the junction,
            if not runs_red:
                mode &= ~8  # and before it
        return mode

    def _occupied(self, persons: Sequence[str]) -> frozenset[str]:
        """Crossings that a pedestrian walks on or is about to step on."""
        places = set()
        for name in persons:
            place = self._sumo.person_getRoadID(name)
            if place.startswith(":") and place not in self._crossings:
                place = self._sumo.person_getNextEdge(name)
            places.add(place)
        return self._crossings & places


@dataclass(slots=True)
class _YieldingDriver(Driver):
    stream = 6
    edge: str = ""
    yields: bool = False
    waits: bool = False


class Clearing(Controller[_YieldingDriver]):
    """Keeps drivers before the line while others clear the junction."""

    def __init__(self, streets: Streets) -> None:
        self._foes = _foes(streets.road)
        super().__init__(streets)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _YieldingDriver | None:
        yields = self._foes and profile.yield_probability > 0
        return _YieldingDriver(agent) if yields else None

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Hold drivers back before the line, or let them go."""
        sumo, period_s = self._sumo, self._streets.period_s
        for driver in self._present:
            if time_s < driver.next_s:
                continue
            lane = self._lanes.get(sumo.vehicle_getLaneID(driver.name))
            foes = () if lane is None else self._waits_for(driver, lane)
            if lane is None or not foes:
                last = lane is not None and lane.edge == driver.agent.route[-1]
                driver.next_s = math.inf if last else time_s + ELSEWHERE_S
                self._go(driver)
                continue
            brake, speed = driver.profile.comfort_decel_mps2, sumo.vehicle_getSpeed(driver.name)
            away_m = lane.length_m - sumo.vehicle_getLanePosition(driver.name)
            needs_m = speed * speed / (2.0 * brake)
            if not driver.waits:
                spare_m = away_m - needs_m - 2 * BEFORE_LINE_M - 2 * speed * period_s
                if spare_m > 0:
                    driver.next_s = time_s + self._until_s(driver.profile, speed, spare_m)
                    continue
                if away_m < needs_m:
                    continue  # too late to stop comfortably
            if any(map(sumo.lane_getLastStepVehicleNumber, foes)):
                left_m = max(away_m - BEFORE_LINE_M - speed * period_s, 0.0)
                sumo.vehicle_setSpeed(driver.name, braking_speed(left_m, 0.0, brake))
                driver.waits = True
            else:
                self._go(driver)

    def _waits_for(self, driver: _YieldingDriver, lane: Lane) -> tuple[str, ...]:
        """The lanes that have to be empty before a driver enters the junction ahead."""
        foes = self._foes.get((lane.id, driver.following.get(lane.edge, "")), ())
        if foes and driver.edge != lane.edge:
            driver.edge = lane.edge
            driver.yields = driver.draws(driver.profile.yield_probability)
        return foes if driver.yields else ()

    def _until_s(self, profile: Profile, speed: float, spare_m: float) -> float:
        """The shortest time in which a driver that accelerates can use up the spare room, s."""
        accel = profile.max_accel_mps2
        longer = 1.0 + accel / profile.comfort_decel_mps2  # the braking distance grows, too
        linear = speed * longer + 2.0 * self._streets.period_s * accel
        square = 0.5 * accel * longer
        return (math.sqrt(linear**2 + 4.0 * square * spare_m) - linear) / (2.0 * square)

    def _go(self, driver: _YieldingDriver) -> None:
        if driver.waits:
            self._sumo.vehicle_setSpeed(driver.name, -1.0)
            driver.waits = False


def _foes(road: Road) -> dict[tuple[str, str], tuple[str, ...]]:
    """By lane and next edge, the lanes inside the junction that have to be empty first."""
    lanes = {lane.id: lane for lane in road.lanes}
    links, paths = [], []
    for number, link in enumerate(road.connections):
        if link.via:
            line = np.concatenate([lanes[name].centerline for name in link.via])
            length_m = distances_along(line)[-1]
            links.append((number, link))
            paths.append(points_at(line, np.linspace(0.0, length_m, math.ceil(length_m) + 1)))
    found: dict[tuple[str, str], tuple[str, ...]] = {}
    boxes = boxes_of(paths, APART_M / 2)
    near = near_pairs(boxes, boxes, CELL_M).tolist()
    for k, pairs in itertools.groupby(near, key=lambda pair: pair[0]):
        one, link = links[k]
        crossed = [
            lane
            for _, m in pairs
            if links[m][1].from_lane != link.from_lane
            and road.first_come(one, links[m][0])
            and cdist(paths[k], paths[m]).min() < APART_M
            for lane in links[m][1].via
        ]
        if crossed:
            found[link.from_lane, lanes[link.to_lane].edge] = tuple(dict.fromkeys(crossed))
    return found
