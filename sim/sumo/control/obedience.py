"""Red lights run, stop lines rolled, pedestrians cut across: decided once per encounter.

SUMO's speed mode says which rules a vehicle regards. A driver's mode is the ordinary one until an
encounter for which the driver's probability says otherwise, and again after the junction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.approaches import Approach, approaches
from sim.sumo.control.drivers import OnRoute, Steered

ORDINARY: Final = 31
"""SUMO's default speed mode: safe speed, limits of the vehicle, right of way, red lights."""

IGNORE_RED: Final = ORDINARY & ~16
"""Red lights are not regarded; those already in the way still are."""

SIGHT_M: Final = 45.0
"""How far before a junction a driver decides (our choice: about three seconds at 50 km/h)."""


FASTEST: Final = 2.5
"""Nobody drives faster than this many times the limit (reckless drivers want 1.6 times it at
most), so nobody comes into sight of a junction sooner."""


@dataclass(slots=True)
class _Driver(OnRoute):
    """One rule breaker's decisions at the approach it is on."""

    red: bool = False
    rolls: bool = False
    cuts: bool = False
    mode: int = ORDINARY
    near: bool = False
    decided: set[str] = field(default_factory=set)


class Obedience(Steered[_Driver]):
    """Lets drivers break the rules that their profiles say they break.

    Args:
        sumo: libsumo's C module.
        road: the road.
        agents: everyone; those who break no rule are left alone.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        super().__init__()
        self._sumo = sumo
        self._approaches = approaches(road)
        self._length = {lane.id: lane.length_m for lane in road.lanes}
        self._edge = {lane.id: lane.edge for lane in road.lanes if not lane.internal}
        self._crossings = frozenset(c.id for c in road.crossings)
        self._fastest_mps = FASTEST * max(lane.speed_limit_mps for lane in road.lanes)
        self._drivers = {
            str(a.id): _Driver(a, np.random.default_rng((a.seed, 1)))
            for a in agents
            if breaks_rules(a)
        }

    def step(self, time_s: float, persons: Sequence[str]) -> None:
        """Decide and set the speed modes for the next simulation step.

        Args:
            time_s: simulated time, s.
            persons: names of the pedestrians on the road.
        """
        sumo = self._sumo
        occupied: frozenset[str] | None = None
        for name, driver in self._here:
            if time_s < driver.look_s:
                continue
            lane = sumo.vehicle_getLaneID(name)
            edge = self._edge.get(lane, "")
            if edge and edge != driver.edge:
                self._enter(driver, edge)
            ahead = self._approaches.get((driver.edge, driver.following.get(driver.edge, "")))
            mode = ORDINARY
            if not driver.near:
                away_m = self._length[lane] - sumo.vehicle_getLanePosition(name) if edge else 0.0
                away_m = away_m if ahead is None else away_m - SIGHT_M
                driver.near = ahead is not None and away_m <= 0
                last = edge == driver.agent.route[-1]
                driver.look_s = math.inf if last else time_s + max(away_m, 0.0) / self._fastest_mps
            if driver.near and ahead is not None:
                if occupied is None:
                    occupied = self._occupied(persons)
                mode = self._decide(driver, ahead, occupied)
            if mode != driver.mode:
                sumo.vehicle_setSpeedMode(name, mode)
                driver.mode = mode

    def _enter(self, driver: _Driver, edge: str) -> None:
        """Draw what the driver will do at the next junction's signal and stop line."""
        profile = driver.agent.profile
        assert profile is not None
        driver.edge, driver.cuts, driver.near = edge, False, False
        driver.red = bool(driver.rng.random() < profile.red_run_probability)
        driver.rolls = bool(driver.rng.random() < profile.stop_roll_probability)
        driver.decided.clear()

    def _decide(self, driver: _Driver, ahead: Approach, occupied: frozenset[str]) -> int:
        profile = driver.agent.profile
        assert profile is not None
        if occupied:
            over = ahead.on_red if driver.red and ahead.signal else ahead.crossings
            for crossing in sorted((over & occupied) - driver.decided):
                driver.decided.add(crossing)
                if driver.rng.random() >= profile.yield_probability:
                    driver.cuts = True
        mode = ORDINARY
        if driver.red and ahead.signal:
            mode &= IGNORE_RED
        if driver.cuts or (driver.rolls and ahead.stop):
            mode |= 32  # right of way is not regarded in the junction,
            if not (driver.red and ahead.signal):
                mode &= ~8  # nor before it
        return mode

    def _occupied(self, persons: Sequence[str]) -> frozenset[str]:
        """Crossings that someone walks on or is about to step on."""
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


def breaks_rules(agent: AgentSpec) -> bool:
    """Whether an agent's profile ever breaks a rule at a junction or crossing."""
    profile = agent.profile
    return profile is not None and (
        profile.red_run_probability > 0
        or profile.stop_roll_probability > 0
        or profile.yield_probability < 1
    )
