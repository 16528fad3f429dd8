"""Lapses of attention: the driver goes on as it was, whatever happens around it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from behaviors.profiles import Profile
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import NO_LANE_CHANGES, Controller, RandomTimeDriver

SEES_NOTHING: Final = 0
"""SUMO's speed mode: no safe speed, no right of way, no red lights."""


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
