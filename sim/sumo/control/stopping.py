"""Slowing and stopping for no reason that others can see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import Steered
from sim.sumo.control.lane_change_mode import NOTHING, ORDINARY

LOWEST_S, HIGHEST_S = 3.0, 6.0
"""How long the slow speed is kept, s (our choice)."""

STOP_SHARE: Final = 0.5
"""Share of full stops; the others slow down to ``SLOW_FACTOR`` of the speed (our choice)."""

SLOW_FACTOR: Final = 0.4

PAUSE_S: Final = 20.0
"""At least this long between two such stops (our choice: oftener, and everyone stands)."""

CLEAR_M: Final = 50.0
"""No leader, junction or crossing within this distance, else there would be a reason."""

IN_LANE_M: Final = 0.1
"""Who is farther from the middle of the lane is changing lanes, and does that first."""

SLOWEST_MPS: Final = 3.0
"""Who drives slower has nothing to slow down from."""


@dataclass(slots=True)
class _Driver:
    """One driver who stops unprovoked."""

    agent: AgentSpec
    rng: np.random.Generator
    wish_s: float
    target_mps: float = -1.0
    release_s: float = -1.0
    hold_s: float = 0.0


class Stopping(Steered[_Driver]):
    """Makes drivers slow down or stop unprovoked as often as their profiles say.

    Args:
        sumo: libsumo's C module.
        road: the road.
        agents: everyone; those who never do are left alone.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        super().__init__()
        self._sumo = sumo
        self._length = {
            lane.id: lane.length_m for lane in road.lanes if not lane.internal and not lane.walking
        }
        for agent in agents:
            if agent.profile is not None and agent.profile.stop_rate_per_min > 0:
                driver = _Driver(agent, np.random.default_rng((agent.seed, 3)), 0.0)
                driver.wish_s = agent.depart_s + _pause_s(driver)
                self._drivers[str(agent.id)] = driver

    def step(self, time_s: float) -> None:
        """Begin, hold and end unprovoked stops.

        Args:
            time_s: simulated time, s.
        """
        sumo = self._sumo
        for name, driver in self._here:
            if driver.target_mps >= 0:
                self._hold(name, driver, time_s)
            elif time_s >= driver.wish_s and self._free(name):
                stop = driver.rng.random() < STOP_SHARE
                driver.hold_s = float(driver.rng.uniform(LOWEST_S, HIGHEST_S))
                driver.target_mps = 0.0 if stop else SLOW_FACTOR * sumo.vehicle_getSpeed(name)
                driver.release_s = -1.0
                sumo.vehicle_setSpeed(name, driver.target_mps)
                sumo.vehicle_setLaneChangeMode(name, NOTHING)  # nobody stands between lanes

    def _hold(self, name: str, driver: _Driver, time_s: float) -> None:
        sumo = self._sumo
        if driver.release_s < 0:
            if sumo.vehicle_getSpeed(name) <= driver.target_mps + 0.1:
                driver.release_s = time_s + driver.hold_s
        elif time_s >= driver.release_s:
            sumo.vehicle_setSpeed(name, -1.0)
            sumo.vehicle_setLaneChangeMode(name, ORDINARY)
            driver.target_mps = -1.0
            driver.wish_s = time_s + PAUSE_S + _pause_s(driver)

    def _free(self, name: str) -> bool:
        """Whether nothing ahead would be a reason to slow down."""
        sumo = self._sumo
        length = self._length.get(sumo.vehicle_getLaneID(name))
        if length is None or sumo.vehicle_getSpeed(name) < SLOWEST_MPS:
            return False
        if length - sumo.vehicle_getLanePosition(name) < CLEAR_M:
            return False
        if abs(sumo.vehicle_getLateralLanePosition(name)) > IN_LANE_M:
            return False
        leader = sumo.vehicle_getLeader(name, CLEAR_M)
        return leader is None or not leader[0] or leader[1] > CLEAR_M


def _pause_s(driver: _Driver) -> float:
    """Time until the next wish, s."""
    profile = driver.agent.profile
    assert profile is not None
    return float(driver.rng.exponential(60.0 / profile.stop_rate_per_min))
