"""Overtaking on the wrong side of two-way roads.

SUMO moves a vehicle to the opposite lane only where it cannot change lanes within its own side. On
roads with several lanes per direction, an overtaking vehicle is therefore given a vehicle class
that may use the leftmost lane only, until it has overtaken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from behaviors.profiles import Profile
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import LANE_CHANGES, NO_LANE_CHANGES, Controller, Driver, Streets
from sim.sumo.vehicle_types import VEHICLE_CLASS

ONCOMING_CLEAR_M, START_S = 250.0, 14.0
"""To start, the oncoming lane must be clear this far, m (with less, vehicles come to stand face to
face), and no oncoming vehicle may meet the driver sooner than this, s."""

RETURN_M, RETURN_S = 100.0, 7.0
"""The driver returns to its own side if an oncoming vehicle is nearer than this, m, or is met
sooner than this, s."""

LONGEST_PASS_S: Final = 20.0
"""The driver returns to its own side after this time, s."""

LEADER_M, PASSED_M = 40.0, 12.0
"""A driver overtakes a slower leader that is this close, m. The leader is overtaken when its front
is this far behind the driver's, m."""

SLOWER_MPS: Final = 1.5
"""A leader counts as slower if it is this much below the driver's desired speed, m/s."""

STAND_S: Final = 5.0
"""A vehicle that stands this long on the wrong side is removed, s; otherwise the road stays
blocked."""

LANE_END_M: Final = 60.0
"""No overtaking starts closer to the end of the lane, m."""

PASSING_CLASS: Final = "custom1"
"""The vehicle class of overtaking vehicles; nothing else uses it."""

LOOKS_S: Final = 0.5
"""How often a driver that wants to overtake looks for an opportunity, s."""

Pose = tuple[float, float, float, float]
"""East and north of a vehicle's front bumper, m, and of the direction that it faces."""


@dataclass(slots=True)
class _OvertakingDriver(Driver):
    stream = 4
    oncoming: frozenset[str] = frozenset()
    overtaking: str = ""
    since_s: float = -1.0
    returning: bool = False
    standing_s: float = -1.0


class Overtaking(Controller[_OvertakingDriver]):
    """Makes drivers overtake on the wrong side as often as their profiles say, where it is clear.

    Nothing happens on roads without opposite lanes.

    Attributes:
        removed: ids of the agents that the last step removed.
    """

    def __init__(self, streets: Streets) -> None:
        self.removed: list[int] = []
        self._ways = {lane.id: lane for lane in streets.road.lanes if not lane.walking}
        self._passable = {lane.id for lane in self._ways.values() if lane.opposite}
        self._oncoming_lanes = self._passable | {
            lane.id for lane in self._ways.values() if lane.internal
        }
        super().__init__(streets)
        edges = {self._ways[lane].edge for lane in self._passable}
        for lane in self._ways.values():  # the leftmost alone are open to overtaking vehicles
            if lane.edge in edges and lane.id not in self._passable:
                closed = (*self._sumo.lane_getDisallowed(lane.id), PASSING_CLASS)
                self._sumo.lane_setDisallowed(lane.id, closed)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _OvertakingDriver | None:
        rate = profile.wrong_way_rate_per_min
        if not self._passable or rate <= 0:
            return None
        edges = {
            self._ways[lane.opposite].edge
            for lane in self._ways.values()
            if lane.opposite and lane.edge in agent.route
        }
        agents = self._streets.agents
        oncoming = frozenset(str(one.id) for one in agents if edges & set(one.route))
        return _OvertakingDriver(agent, rate, oncoming)

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Begin and end overtaking, and remove those of ``vehicles`` that block the wrong side."""
        left = list(vehicles)
        for driver in self._present:
            if driver.since_s >= 0:
                self._follow_up(driver, time_s, left)
                if driver.agent.id in self.removed:
                    left.remove(driver.name)
            elif time_s >= driver.next_s:
                driver.next_s = time_s + LOOKS_S
                self._begin(driver, time_s, left)

    def overtakes(self, name: str) -> bool:
        """Whether a driver is on the wrong side, on its way there or back."""
        driver = self._drivers.get(name)
        return driver is not None and driver.since_s >= 0

    def _begin(self, driver: _OvertakingDriver, time_s: float, vehicles: Sequence[str]) -> None:
        """Begin to overtake a slower leader if the other side is clear."""
        sumo, name = self._sumo, driver.name
        lane = self._lanes.get(sumo.vehicle_getLaneID(name))
        if lane is None or lane.id not in self._passable:
            return
        if lane.length_m - sumo.vehicle_getLanePosition(name) < LANE_END_M:
            return
        leader = sumo.vehicle_getLeader(name, LEADER_M)
        if not leader or not leader[0] or leader[1] > LEADER_M:
            return
        if sumo.vehicle_getSpeed(leader[0]) > sumo.vehicle_getAllowedSpeed(name) - SLOWER_MPS:
            return
        distance, meeting = self._oncoming(driver, vehicles)
        if distance > ONCOMING_CLEAR_M and meeting > START_S:
            sumo.vehicle_setLaneChangeMode(name, NO_LANE_CHANGES)
            sumo.vehicle_setVehicleClass(name, PASSING_CLASS)
            sumo.vehicle_changeLane(name, lane.index + 1, 3.0)
            driver.overtaking, driver.since_s = str(leader[0]), time_s

    def _follow_up(self, driver: _OvertakingDriver, time_s: float, vehicles: Sequence[str]) -> None:
        """Let a driver return once it has passed or somebody comes, and remove one that stands."""
        sumo, name = self._sumo, driver.name
        wrong = self._on_wrong_side(name, self._pose(name))
        if not driver.returning:
            distance, meeting = self._oncoming(driver, vehicles)
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

    def _on_wrong_side(self, name: str, pose: Pose) -> bool:
        """Whether a vehicle is on a lane of the opposite direction."""
        lane = self._ways.get(self._sumo.vehicle_getLaneID(name))
        if lane is None:
            return False
        along = lane.centerline[-1] - lane.centerline[0]
        return bool(pose[2] * along[0] + pose[3] * along[1] < 0)

    def _pose(self, name: str) -> Pose:
        """Where a vehicle is and faces."""
        angle = math.radians(self._sumo.vehicle_getAngle(name))
        return (*self._sumo.vehicle_getPosition(name), math.sin(angle), math.cos(angle))

    def _ahead_m(self, pose: Pose, other: str) -> float:
        """How far ahead of a pose another vehicle is, m; negative behind it."""
        x, y, east, north = pose
        ox, oy = self._sumo.vehicle_getPosition(other)
        return float((ox - x) * east + (oy - y) * north)

    def _oncoming(self, driver: _OvertakingDriver, vehicles: Sequence[str]) -> tuple[float, float]:
        """Distance to the nearest oncoming vehicle, m, and time until the first is met, s."""
        sumo, pose = self._sumo, self._pose(driver.name)
        speed = sumo.vehicle_getSpeed(driver.name)
        nearest, soonest = math.inf, math.inf
        for other in vehicles:
            if other not in driver.oncoming:
                continue
            ahead = self._ahead_m(pose, other)
            if ahead <= 0 or sumo.vehicle_getLaneID(other) not in self._oncoming_lanes:
                continue
            theirs = self._pose(other)
            facing = theirs[2] * pose[2] + theirs[3] * pose[3]
            if facing <= -0.5 and not self._on_wrong_side(other, theirs):
                nearest = min(nearest, ahead)
                closing = speed + sumo.vehicle_getSpeed(other)
                soonest = min(soonest, ahead / max(closing, 1e-6))
        return nearest, soonest
