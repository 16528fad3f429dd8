"""Conduct that nothing on the road provokes: slowing, stopping, and lapses of attention."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from behaviors.profiles import Profile
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import NO_LANE_CHANGES, Controller, RandomTimeDriver, release

LOWEST_S, HIGHEST_S = 3.0, 6.0
"""How long the slow speed is kept, s."""

STOP_SHARE: Final = 0.5
"""Share of full stops; the others slow down to `SLOW_FACTOR` of the speed."""

SLOW_FACTOR: Final = 0.4

PAUSE_S: Final = 20.0
"""Shortest pause between two such stops, s (with shorter ones the road jams)."""

FREE_AHEAD_M: Final = 50.0
"""A driver stops only if no leader, junction or crossing is this near, m: a stop is unprovoked."""

IN_LANE_M: Final = 0.1
"""A driver farther from the middle of its lane is changing lanes and does not stop, m."""

SLOWEST_STOP_MPS: Final = 3.0
"""Drivers slower than this do not slow down, m/s."""


SEES_NOTHING: Final = 0
"""SUMO's speed mode: no safe speed, no right of way, no red lights."""


@dataclass(slots=True)
class _StoppingDriver(RandomTimeDriver):
    target_mps: float = -1.0
    release_s: float = -1.0
    hold_s: float = 0.0


class Stopping(Controller[_StoppingDriver]):
    """Makes drivers slow down or stop unprovoked as often as their profiles say."""

    def _driver(self, agent: AgentSpec, profile: Profile) -> _StoppingDriver | None:
        rate = profile.stop_rate_per_min
        return _StoppingDriver(agent, 3, rate) if rate > 0 else None

    def step(self, time_s: float) -> None:
        """Begin, hold and end unprovoked stops at a simulated time, s."""
        sumo = self._sumo
        for name, driver in self._present:
            if driver.target_mps < 0:
                if time_s >= driver.next_s and self._free(name):
                    stop = driver.rng.random() < STOP_SHARE
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
class _InattentiveDriver(RandomTimeDriver):
    until_s: float = -1.0


class Lapses(Controller[_InattentiveDriver]):
    """Makes drivers keep their speed and lane for a while, as often as their profiles say."""

    def _driver(self, agent: AgentSpec, profile: Profile) -> _InattentiveDriver | None:
        rate = profile.lapse_rate_per_min if profile.lapse_s > 0 else 0.0
        return _InattentiveDriver(agent, 10, rate) if rate > 0 else None

    @property
    def away(self) -> set[str]:
        """Names of the vehicles whose drivers look away."""
        return {name for name, driver in self._present if driver.until_s >= 0}

    def step(self, time_s: float) -> list[AgentSpec]:
        """Begin and end lapses at a simulated time, s; returns the drivers who look again."""
        sumo = self._sumo
        ended = []
        for name, driver in self._present:
            if driver.until_s >= 0:
                if time_s >= driver.until_s:
                    driver.until_s = -1.0
                    driver.pause_from(time_s)
                    ended.append(driver.agent)
            elif time_s >= driver.next_s:
                driver.until_s = time_s + float(driver.rng.exponential(driver.profile.lapse_s))
                sumo.vehicle_setSpeedMode(name, SEES_NOTHING)
                sumo.vehicle_setLaneChangeMode(name, NO_LANE_CHANGES)
                sumo.vehicle_setSpeed(name, sumo.vehicle_getSpeed(name))
        return ended
