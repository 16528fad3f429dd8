"""Overtaking on the wrong side of two-way roads.

SUMO moves a vehicle to the opposite lane only where it cannot change lanes within its own side. On
roads with several lanes per direction, an overtaking vehicle is therefore given a vehicle class
that may use the leftmost lane only, until it has overtaken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from behaviors.profiles import Profile
from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import (
    LANE_CHANGES,
    NO_LANE_CHANGES,
    Controller,
    RandomTimeDriver,
)
from sim.sumo.vehicle_types import VEHICLE_CLASS

ONCOMING_CLEAR_M: Final = 250.0
"""The oncoming lane must be clear this far to start, m (with less, vehicles come to stand face to
face)."""

START_S: Final = 14.0
"""No oncoming vehicle may meet the driver sooner than this, s."""

RETURN_M, RETURN_S = 100.0, 7.0
"""The driver returns to its own side if an oncoming vehicle is nearer than this, m, or is met
sooner than this, s."""

LONGEST_PASS_S: Final = 20.0
"""The driver returns to its own side after this time, s."""

LEADER_M: Final = 40.0
"""A driver overtakes a slower leader that is this close, m."""

PASSED_M: Final = 12.0
"""The leader is overtaken when its front is this far behind the driver's, m."""

SLOWER_MPS: Final = 1.5
"""A leader counts as slower if it is this much below the driver's desired speed, m/s."""

STAND_S: Final = 5.0
"""A vehicle that stands this long on the wrong side is removed, s; otherwise the road stays
blocked."""

LANE_END_M: Final = 60.0
"""No overtaking starts closer to the end of the lane, m."""

PASSING_CLASS: Final = "custom1"
"""The vehicle class of overtaking vehicles; nothing else uses it."""

_PERIOD_S: Final = 0.5
"""How often a driver that wants to overtake looks for an opportunity, s."""


@dataclass(slots=True)
class _OvertakingDriver(RandomTimeDriver):
    oncoming: frozenset[str] = frozenset()
    overtaking: str = ""
    since_s: float = -1.0
    returning: bool = False
    standing_s: float = -1.0


class WrongWay(Controller[_OvertakingDriver]):
    """Makes drivers overtake on the wrong side as often as their profiles say, where it is clear.

    Nothing happens on roads without opposite lanes.

    Attributes:
        removed: ids of the agents that the last step removed.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._every_lane = {lane.id: lane for lane in road.lanes if not lane.walking}
        self._passable = frozenset(lane.id for lane in road.lanes if lane.opposite)
        self._oncoming_lanes = self._passable | {lane.id for lane in road.lanes if lane.internal}
        self._agents = agents
        self._closed = False
        self.removed: list[int] = []
        super().__init__(sumo, road, agents)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _OvertakingDriver | None:
        rate = profile.wrong_way_rate_per_min
        if not self._passable or rate <= 0:
            return None
        edges = {
            self._every_lane[lane.opposite].edge
            for lane in self._every_lane.values()
            if lane.opposite and lane.edge in agent.route
        }
        oncoming = frozenset(str(a.id) for a in self._agents if edges & set(a.route))
        return _OvertakingDriver(agent, 4, rate, oncoming)

    def step(self, time_s: float, vehicles: Sequence[str]) -> None:
        """Begin and end overtaking, and remove those of ``vehicles`` that block the wrong side."""
        if not self._drivers:
            return
        if not self._closed:
            self._close_other_lanes()
        left = list(vehicles)
        for name, driver in self._present:
            if driver.since_s >= 0:
                self._follow_up(name, driver, time_s, left)
                if driver.agent.id in self.removed:
                    left.remove(name)
            elif time_s >= driver.next_s:
                leader = self._opportunity(name, driver, left)
                if leader:
                    lane = self._every_lane[self._sumo.vehicle_getLaneID(name)]
                    self._sumo.vehicle_setLaneChangeMode(name, NO_LANE_CHANGES)
                    self._sumo.vehicle_setVehicleClass(name, PASSING_CLASS)
                    self._sumo.vehicle_changeLane(name, lane.index + 1, 3.0)
                    driver.overtaking, driver.since_s = leader, time_s
                else:
                    driver.next_s = time_s + _PERIOD_S

    def overtakes(self, name: str) -> bool:
        """Whether a driver is on the wrong side, on its way there or back."""
        driver = self._drivers.get(name)
        return driver is not None and driver.since_s >= 0

    def _close_other_lanes(self) -> None:
        """Close all lanes but the leftmost ones to overtaking vehicles."""
        self._closed = True
        edges = {self._every_lane[lane].edge for lane in self._passable}
        for lane in self._every_lane.values():
            if lane.edge in edges and lane.id not in self._passable:
                closed = (*self._sumo.lane_getDisallowed(lane.id), PASSING_CLASS)
                self._sumo.lane_setDisallowed(lane.id, closed)

    def _opportunity(self, name: str, driver: _OvertakingDriver, vehicles: Sequence[str]) -> str:
        """Name of the slower leader if it can be overtaken now, otherwise an empty text."""
        sumo = self._sumo
        lane = self._every_lane.get(sumo.vehicle_getLaneID(name))
        if lane is None or lane.id not in self._passable or lane.internal:
            return ""
        if lane.length_m - sumo.vehicle_getLanePosition(name) < LANE_END_M:
            return ""
        leader = sumo.vehicle_getLeader(name, LEADER_M)
        if not leader or not leader[0] or leader[1] > LEADER_M:
            return ""
        desired = sumo.vehicle_getAllowedSpeed(name)
        if sumo.vehicle_getSpeed(leader[0]) > desired - SLOWER_MPS:
            return ""
        distance, meeting = self._oncoming(name, driver, vehicles)
        return str(leader[0]) if distance > ONCOMING_CLEAR_M and meeting > START_S else ""

    def _follow_up(
        self, name: str, driver: _OvertakingDriver, time_s: float, vehicles: Sequence[str]
    ) -> None:
        """Let a driver return once it has passed or somebody comes, and remove one that stands."""
        sumo = self._sumo
        wrong = self._on_wrong_side(name)
        if not driver.returning:
            distance, meeting = self._oncoming(name, driver, vehicles)
            leader = driver.overtaking
            passed = leader not in vehicles or self._ahead_m(self._pose(name), leader) < -PASSED_M
            late = time_s - driver.since_s > LONGEST_PASS_S
            if passed or late or distance < RETURN_M or meeting < RETURN_S:
                driver.returning = True
                sumo.vehicle_setLaneChangeMode(name, LANE_CHANGES)
        elif not wrong and time_s - driver.since_s > 3.0:
            driver.since_s, driver.returning, driver.standing_s = -1.0, False, -1.0
            driver.pause_from(time_s)
            sumo.vehicle_setVehicleClass(name, VEHICLE_CLASS[driver.agent.kind])
            return
        if not wrong or sumo.vehicle_getSpeed(name) >= 0.1:
            driver.standing_s = -1.0
        elif driver.standing_s < 0:
            driver.standing_s = time_s
        elif time_s - driver.standing_s >= STAND_S:
            sumo.vehicle_remove(name)
            self.removed.append(driver.agent.id)
            driver.since_s, driver.next_s = -1.0, math.inf

    def _on_wrong_side(self, name: str) -> bool:
        """Whether a vehicle is on a lane of the opposite direction."""
        lane = self._every_lane.get(self._sumo.vehicle_getLaneID(name))
        if lane is None:
            return False
        along = lane.centerline[-1] - lane.centerline[0]
        *_, east, north = self._pose(name)
        return bool(east * along[0] + north * along[1] < 0)

    def _pose(self, name: str) -> tuple[float, float, float, float]:
        """East and north of a vehicle's front bumper, m, and of the direction that it faces."""
        angle = math.radians(self._sumo.vehicle_getAngle(name))
        return (*self._sumo.vehicle_getPosition(name), math.sin(angle), math.cos(angle))

    def _ahead_m(self, pose: tuple[float, float, float, float], other: str) -> float:
        """How far ahead of a pose another vehicle is, m; negative behind it."""
        x, y, east, north = pose
        ox, oy = self._sumo.vehicle_getPosition(other)
        return float((ox - x) * east + (oy - y) * north)

    def _oncoming(
        self, name: str, driver: _OvertakingDriver, vehicles: Sequence[str]
    ) -> tuple[float, float]:
        """Distance to the nearest oncoming vehicle, m, and time until the first is met, s."""
        sumo, pose = self._sumo, self._pose(name)
        speed = sumo.vehicle_getSpeed(name)
        nearest, soonest = math.inf, math.inf
        for other in vehicles:
            if other not in driver.oncoming:
                continue
            ahead = self._ahead_m(pose, other)
            if ahead <= 0 or sumo.vehicle_getLaneID(other) not in self._oncoming_lanes:
                continue
            *_, east, north = self._pose(other)
            if east * pose[2] + north * pose[3] > -0.5 or self._on_wrong_side(other):
                continue
            nearest = min(nearest, ahead)
            closing = speed + sumo.vehicle_getSpeed(other)
            soonest = min(soonest, ahead / max(closing, 1e-6))
        return nearest, soonest
