"""What drivers do at random times in their own direction: stops, lapses of attention, cut-ins.

Nothing on the road provokes a stop or a lapse. A cut-in is a change into the small gap in front of
a chosen car on the next lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from behaviors.profiles import Profile
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import (
    FORCED_LANE_CHANGES,
    LANE_CHANGES,
    NO_LANE_CHANGES,
    Controller,
    Driver,
    Streets,
    release,
)

LOWEST_S, HIGHEST_S = 3.0, 6.0
"""How long the slow speed of a stop is kept, s."""

STOP_SHARE, SLOW_FACTOR = 0.5, 0.4
"""Share of full stops; the others slow down to this part of the speed."""

PAUSE_S: Final = 20.0
"""Shortest pause between two such stops, s (with shorter ones the road jams)."""

FREE_AHEAD_M: Final = 50.0
"""A driver stops only if no leader, junction or crossing is this near, m: a stop is unprovoked."""

IN_LANE_M: Final = 0.1
"""A driver farther from the middle of its lane is changing lanes and does not stop, m."""

SLOWEST_STOP_MPS, SLOWEST_CUT_IN_MPS = 3.0, 4.0
"""Drivers slower than this do not slow down, or cut in, m/s."""

SEES_NOTHING: Final = 0
"""SUMO's speed mode: no safe speed, no right of way, no red lights."""

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

SPARE_M: Final = 0.3
"""The victim keeps at least this much beyond its standstill gap, else SUMO delays the change."""

MANOEUVRE_S, TOUCHING_S, HALF_CHANGE_S = 4.0, 0.6, 1.4
"""For how long the lane change is commanded, s; when the vehicle touches the new lane; when its
centre is there, until which it keeps the victim's speed. A change takes 2.5 s, and a car is 0.7 m
from the marking."""

MATCHING_S: Final = 0.4
"""A faster driver moves ahead by this times the speed difference while slowing to the victim's
speed, s."""

RETRY_S: Final = 0.2
"""A driver that finds no gap looks again after this, s."""

FALLING_BACK_MPS, FALLING_BACK_S = 2.5, 6.0
"""A driver whose victim is too far behind falls back at this speed, m/s, for at most this time."""

JUNCTION_M: Final = 30.0
"""No cut-in starts closer to a junction, m."""

_NEIGHBOURS: Final[dict[int, tuple[int, int]]] = {1: (0b000, 0b010), -1: (0b001, 0b011)}
"""SUMO's neighbour queries (follower, leader) on the lane to the left (1) and to the right (-1)."""


@dataclass(slots=True)
class _StoppingDriver(Driver):
    stream = 3
    target_mps: float = -1.0
    release_s: float = -1.0
    hold_s: float = 0.0


class Stopping(Controller[_StoppingDriver]):
    """Makes drivers slow down or stop unprovoked as often as their profiles say."""

    def _driver(self, agent: AgentSpec, profile: Profile) -> _StoppingDriver | None:
        rate = profile.stop_rate_per_min
        return _StoppingDriver(agent, rate) if rate > 0 else None

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Begin, hold and end unprovoked stops."""
        sumo = self._sumo
        for driver in self._present:
            name = driver.name
            if driver.target_mps < 0:
                if time_s >= driver.next_s and self._free(name):
                    stop = driver.draws(STOP_SHARE)
                    driver.hold_s = float(driver.rng.uniform(LOWEST_S, HIGHEST_S))
                    driver.target_mps = 0.0 if stop else SLOW_FACTOR * sumo.vehicle_getSpeed(name)
                    driver.release_s = -1.0
                    sumo.vehicle_setSpeed(name, driver.target_mps)
                    # it must not stop between lanes
                    sumo.vehicle_setLaneChangeMode(name, NO_LANE_CHANGES)
            elif driver.release_s < 0:
                if sumo.vehicle_getSpeed(name) <= driver.target_mps + 0.1:
                    driver.release_s = time_s + driver.hold_s
            elif time_s >= driver.release_s:
                release(sumo, name)
                driver.target_mps = -1.0
                driver.pause_from(time_s + PAUSE_S)

    def _free(self, name: str) -> bool:
        """Whether there is nothing ahead that would provoke slowing down."""
        sumo = self._sumo
        lane = self._lanes.get(sumo.vehicle_getLaneID(name))
        if lane is None or sumo.vehicle_getSpeed(name) < SLOWEST_STOP_MPS:
            return False
        if lane.length_m - sumo.vehicle_getLanePosition(name) < FREE_AHEAD_M:
            return False
        if abs(sumo.vehicle_getLateralLanePosition(name)) > IN_LANE_M:
            return False
        leader = sumo.vehicle_getLeader(name, FREE_AHEAD_M)
        return leader is None or not leader[0] or leader[1] > FREE_AHEAD_M


@dataclass(slots=True)
class _InattentiveDriver(Driver):
    stream = 10
    until_s: float = -1.0


class Lapses(Controller[_InattentiveDriver]):
    """Makes drivers keep their speed and lane for a while, as often as their profiles say.

    Attributes:
        ended: the drivers who looked at the road again in the last step.
    """

    ended: Sequence[AgentSpec] = ()

    def _driver(self, agent: AgentSpec, profile: Profile) -> _InattentiveDriver | None:
        rate = profile.lapse_rate_per_min if profile.lapse_s > 0 else 0.0
        return _InattentiveDriver(agent, rate) if rate > 0 else None

    @property
    def away(self) -> set[str]:
        """Names of the vehicles whose drivers look away."""
        return {driver.name for driver in self._present if driver.until_s >= 0}

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Begin and end lapses."""
        sumo, ended = self._sumo, []
        for driver in self._present:
            if driver.until_s >= 0:
                if time_s >= driver.until_s:
                    driver.until_s = -1.0
                    driver.pause_from(time_s)
                    ended.append(driver.agent)
            elif time_s >= driver.next_s:
                driver.until_s = time_s + float(driver.rng.exponential(driver.profile.lapse_s))
                sumo.vehicle_setSpeedMode(driver.name, SEES_NOTHING)
                sumo.vehicle_setLaneChangeMode(driver.name, NO_LANE_CHANGES)
                sumo.vehicle_setSpeed(driver.name, sumo.vehicle_getSpeed(driver.name))
        self.ended = ended


@dataclass(slots=True)
class _CuttingInDriver(Driver):
    stream = 2
    until_s: float = -1.0
    paced: bool = False
    falls_back: bool = False


class CuttingIn(Controller[_CuttingInDriver]):
    """Makes drivers cut in as often as their profiles say, where the gaps allow it."""

    def __init__(self, streets: Streets) -> None:
        self._wide = {lane.edge for lane in streets.lanes.values() if streets.beside(lane, 1)}
        super().__init__(streets)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _CuttingInDriver | None:
        rate, can = profile.cut_in_rate_per_min, not self._wide.isdisjoint(agent.route)
        return _CuttingInDriver(agent, rate) if rate > 0 and can else None

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Begin and end cut-ins."""
        for driver in self._present:
            if driver.until_s >= 0:
                if driver.paced and time_s >= driver.until_s - MANOEUVRE_S + HALF_CHANGE_S:
                    self._sumo.vehicle_setSpeed(driver.name, -1.0)
                    driver.paced = False
                if time_s >= driver.until_s:
                    self._sumo.vehicle_setLaneChangeMode(driver.name, LANE_CHANGES)
                    driver.until_s = -1.0
            elif time_s >= driver.next_s:
                if self._cut_in(driver):
                    driver.until_s = time_s + MANOEUVRE_S
                    driver.paced = True
                    driver.pause_from(driver.until_s)
                else:
                    driver.next_s = time_s + RETRY_S
                    if driver.paced and not driver.falls_back:
                        self._sumo.vehicle_setSpeed(driver.name, -1.0)
                    driver.paced = driver.falls_back

    def _cut_in(self, driver: _CuttingInDriver) -> bool:
        """Cut in now if there is a car to cut in on and room for it."""
        sumo, name = self._sumo, driver.name
        driver.falls_back = False
        speed = sumo.vehicle_getSpeed(name)
        lane = self._lanes.get(sumo.vehicle_getLaneID(name))
        if lane is None or speed < SLOWEST_CUT_IN_MPS:
            return False
        if lane.length_m - sumo.vehicle_getLanePosition(name) < JUNCTION_M:
            return False
        onward = self._streets.approaches.get((lane.edge, driver.following.get(lane.edge, "")))
        for side, (behind, ahead) in _NEIGHBOURS.items():
            target = self._streets.beside(lane, side)
            if target is None or (onward is not None and target.index not in onward.lanes):
                continue
            pace, near = self._pace(name, behind, speed)
            if pace and self._has_room(driver, ahead, speed, pace):
                sumo.vehicle_setSpeed(name, pace)
                driver.falls_back = not near
                if near:
                    sumo.vehicle_setLaneChangeMode(name, FORCED_LANE_CHANGES)
                    sumo.vehicle_changeLane(name, target.index, MANOEUVRE_S)
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

    def _has_room(self, driver: Driver, side: int, speed: float, pace: float) -> bool:
        """Whether the gap to the new leader suffices at that pace."""
        for leader, net_gap in self._sumo.vehicle_getNeighbors(driver.name, side):
            closing = max(speed - self._sumo.vehicle_getSpeed(leader), 0.0)
            wanted = SMALLEST_GAP_M + FRONT_SHARE * driver.profile.time_headway_s * pace
            wanted += closing**2 / (2 * HARDEST_BRAKING_MPS2)
            return bool(net_gap + driver.profile.min_gap_m > wanted)
        return True
