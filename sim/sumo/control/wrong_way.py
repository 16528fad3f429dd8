"""Driving on the wrong side to get past a slower car, on two-way roads.

SUMO leads a vehicle over the middle of the road only where it cannot change lanes within its own
side. On roads with several lanes a side, who passes therefore gets a class of vehicle that may use
the leftmost lane only, for as long as the passing lasts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import Steered
from sim.sumo.control.lane_change_mode import NOTHING, ORDINARY
from sim.sumo.vehicle_types import VEHICLE_CLASS

SIGHT_M: Final = 250.0
"""The oncoming lane must be clear this far to start (our choice: with less there are head-on
stand-offs)."""

START_S: Final = 14.0
"""Nor may anyone meet the driver sooner than this."""

RETURN_M, RETURN_S = 100.0, 7.0
"""Someone oncoming nearer than this, or met sooner: back to the right side."""

LONGEST_S: Final = 20.0
"""Nobody stays on the wrong side longer on purpose (our choice)."""

LEADER_M: Final = 40.0
"""A slower car this close ahead is worth passing (our choice)."""

PASSED_M: Final = 12.0
"""So far behind, front to front, the passed car is passed."""

SLOWER_MPS: Final = 1.5
"""What counts as slower than the own desired speed (our choice)."""

STAND_S: Final = 5.0
"""Who stands this long on the wrong side is taken off the road, else everyone waits for good."""

CLEAR_M: Final = 60.0
"""No start closer to the end of the lane (our choice)."""

PASSING_CLASS: Final = "custom1"
"""The vehicle class, otherwise unused, of who passes."""

_PERIOD_S: Final = 0.5
"""How often a driver with a wish looks for a chance."""


@dataclass(slots=True)
class _Driver:
    """One driver who uses the wrong side."""

    agent: AgentSpec
    rng: np.random.Generator
    wish_s: float
    against: frozenset[str]
    passing: str = ""
    since_s: float = -1.0
    returning: bool = False
    standing_s: float = -1.0


class WrongWay(Steered[_Driver]):
    """Makes drivers pass on the wrong side as often as their profiles wish, where it is clear.

    Args:
        sumo: libsumo's C module.
        road: the road; those without opposite lanes never see it happen.
        agents: everyone; those who never do are left alone.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        super().__init__()
        self._sumo = sumo
        self._lanes = {lane.id: lane for lane in road.lanes if not lane.walking}
        self._passable = frozenset(lane.id for lane in road.lanes if lane.opposite)
        self._closed = False
        self._oncoming_lanes = self._passable | {lane.id for lane in road.lanes if lane.internal}
        self.removed: list[int] = []
        for agent in agents if self._passable else ():
            if agent.profile is not None and agent.profile.wrong_way_rate_per_min > 0:
                rng = np.random.default_rng((agent.seed, 4))
                driver = _Driver(agent, rng, 0.0, self._against(agent.route, agents))
                driver.wish_s = agent.depart_s + _pause_s(driver)
                self._drivers[str(agent.id)] = driver

    def step(self, time_s: float, vehicles: Sequence[str]) -> None:
        """Begin, end and clear up drives on the wrong side.

        Args:
            time_s: simulated time, s.
            vehicles: names of the vehicles on the road; who is taken off is in `removed`.
        """
        self.removed = []
        if not self._drivers:
            return
        if not self._closed:
            self._close_other_lanes()
        present = list(vehicles)
        for name, driver in self._here:
            if driver.since_s >= 0:
                self._follow_up(name, driver, time_s, present)
                if driver.agent.id in self.removed:
                    present.remove(name)
            elif time_s >= driver.wish_s:
                leader = self._chance(name, driver, present)
                if leader:
                    lane = self._lanes[self._sumo.vehicle_getLaneID(name)]
                    self._sumo.vehicle_setLaneChangeMode(name, NOTHING)
                    self._sumo.vehicle_setVehicleClass(name, PASSING_CLASS)
                    self._sumo.vehicle_changeLane(name, lane.index + 1, 3.0)
                    driver.passing, driver.since_s = leader, time_s
                else:
                    driver.wish_s = time_s + _PERIOD_S

    def _against(self, route: Sequence[str], agents: Sequence[AgentSpec]) -> frozenset[str]:
        """Names of those who come the other way."""
        edges = {
            self._lanes[lane.opposite].edge
            for lane in self._lanes.values()
            if lane.opposite and lane.edge in route
        }
        return frozenset(str(a.id) for a in agents if edges & set(a.route))

    def _close_other_lanes(self) -> None:
        """Close the lanes beside the leftmost ones to who passes."""
        self._closed = True
        edges = {self._lanes[lane].edge for lane in self._passable}
        for lane in self._lanes.values():
            if lane.edge in edges and lane.id not in self._passable:
                closed = (*self._sumo.lane_getDisallowed(lane.id), PASSING_CLASS)
                self._sumo.lane_setDisallowed(lane.id, closed)

    def _chance(self, name: str, driver: _Driver, vehicles: Sequence[str]) -> str:
        """The slower car ahead, if it can be passed now; otherwise nothing."""
        sumo = self._sumo
        lane = self._lanes.get(sumo.vehicle_getLaneID(name))
        if lane is None or lane.id not in self._passable or lane.internal:
            return ""
        if lane.length_m - sumo.vehicle_getLanePosition(name) < CLEAR_M:
            return ""
        leader = sumo.vehicle_getLeader(name, LEADER_M)
        if not leader or not leader[0] or leader[1] > LEADER_M:
            return ""
        desired = sumo.vehicle_getAllowedSpeed(name)
        if sumo.vehicle_getSpeed(leader[0]) > desired - SLOWER_MPS:
            return ""
        distance, meeting = self._oncoming(name, driver, vehicles)
        return str(leader[0]) if distance > SIGHT_M and meeting > START_S else ""

    def _follow_up(
        self, name: str, driver: _Driver, time_s: float, vehicles: Sequence[str]
    ) -> None:
        sumo = self._sumo
        wrong = self._on_wrong_side(name)
        speed = sumo.vehicle_getSpeed(name)
        if not driver.returning:
            distance, meeting = self._oncoming(name, driver, vehicles)
            passed = driver.passing not in vehicles or self._behind(name, driver.passing)
            late = time_s - driver.since_s > LONGEST_S
            if passed or late or distance < RETURN_M or meeting < RETURN_S:
                driver.returning = True
                sumo.vehicle_setLaneChangeMode(name, ORDINARY)
        elif not wrong and time_s - driver.since_s > 3.0:
            driver.since_s, driver.returning, driver.standing_s = -1.0, False, -1.0
            driver.wish_s = time_s + _pause_s(driver)
            sumo.vehicle_setVehicleClass(name, VEHICLE_CLASS[driver.agent.kind])
            return
        if wrong and speed < 0.1:
            if driver.standing_s < 0:
                driver.standing_s = time_s
            elif time_s - driver.standing_s >= STAND_S:
                sumo.vehicle_remove(name)
                self.removed.append(driver.agent.id)
                driver.since_s = -1.0
                driver.wish_s = math.inf
        else:
            driver.standing_s = -1.0

    def _on_wrong_side(self, name: str) -> bool:
        """Whether a vehicle is on a lane that leads the other way."""
        sumo = self._sumo
        lane = self._lanes.get(sumo.vehicle_getLaneID(name))
        if lane is None:
            return False
        (x0, y0), (x1, y1) = lane.centerline[0], lane.centerline[-1]
        east, north = _direction(sumo.vehicle_getAngle(name))
        return bool(east * (x1 - x0) + north * (y1 - y0) < 0)

    def _behind(self, name: str, other: str) -> bool:
        """Whether another vehicle has fallen behind far enough to return before it."""
        sumo = self._sumo
        x, y = sumo.vehicle_getPosition(name)
        east, north = _direction(sumo.vehicle_getAngle(name))
        ox, oy = sumo.vehicle_getPosition(other)
        ahead = (ox - x) * east + (oy - y) * north
        return bool(ahead < -PASSED_M)

    def _oncoming(self, name: str, driver: _Driver, vehicles: Sequence[str]) -> tuple[float, float]:
        """Distance, m, and time to meeting, s, of the nearest vehicle coming the other way."""
        sumo = self._sumo
        x, y = sumo.vehicle_getPosition(name)
        east, north = _direction(sumo.vehicle_getAngle(name))
        speed = sumo.vehicle_getSpeed(name)
        nearest, soonest = math.inf, math.inf
        for other in vehicles:
            if other not in driver.against:
                continue
            ox, oy = sumo.vehicle_getPosition(other)
            ahead = (ox - x) * east + (oy - y) * north
            if ahead <= 0 or sumo.vehicle_getLaneID(other) not in self._oncoming_lanes:
                continue
            o_east, o_north = _direction(sumo.vehicle_getAngle(other))
            if o_east * east + o_north * north > -0.5 or self._on_wrong_side(other):
                continue
            nearest = min(nearest, ahead)
            closing = speed + sumo.vehicle_getSpeed(other)
            soonest = min(soonest, ahead / max(closing, 1e-6))
        return nearest, soonest


def _direction(angle: float) -> tuple[float, float]:
    """East and north part of a direction given in degrees clockwise from north."""
    radians = math.radians(angle)
    return math.sin(radians), math.cos(radians)


def _pause_s(driver: _Driver) -> float:
    """Time until the next wish, s."""
    profile = driver.agent.profile
    assert profile is not None
    return float(driver.rng.exponential(60.0 / profile.wrong_way_rate_per_min))
