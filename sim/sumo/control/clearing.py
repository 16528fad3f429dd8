"""Waiting before a junction until others have left it.

SUMO's drivers enter on green, and at all-way stops, while a vehicle whose path crosses theirs still
stands in the junction, and the two clip each other's corners. Drivers that yield to pedestrians let
vehicles clear the junction, too (German road traffic regulations, section 11(1) and (3)): with the
same probability, drawn once per junction.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.spatial.distance import cdist

from behaviors.driver_models import braking_speed
from behaviors.profiles import Profile
from sim.frames import FloatArray
from sim.geometry import distances_along, points_at
from sim.road import Connection, Road
from sim.road.cells import boxes_of, near_pairs
from sim.road.lane_graph import CELL_M
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import Controller, RouteDriver

APART_M: Final = 2.5
"""Paths that come closer than this cross or join, m (a car's width and some room)."""

ELSEWHERE_S: Final = 1.0
"""A driver on a lane that leads to no such junction is looked at again after this, s."""

BEFORE_LINE_M: Final = 1.0
"""Drivers wait this far before the line, m (SUMO's own distance)."""


@dataclass(slots=True)
class _YieldingDriver(RouteDriver):
    yields: bool = False
    waits: bool = False


class Clearing(Controller[_YieldingDriver]):
    """Keeps drivers before the line while others clear the junction, at a step of ``period_s``."""

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec], period_s: float) -> None:
        self._foes = _foes(road)
        self._period_s = period_s
        super().__init__(sumo, road, agents)

    def _driver(self, agent: AgentSpec, profile: Profile) -> _YieldingDriver | None:
        yields = self._foes and profile.yield_probability > 0
        return _YieldingDriver(agent, 6) if yields else None

    def step(self, time_s: float) -> None:
        """Hold drivers back before the line, or let them go, at a simulated time, s."""
        sumo = self._sumo
        for name, driver in self._present:
            if time_s < driver.next_check_s:
                continue
            lane = self._lanes.get(sumo.vehicle_getLaneID(name))
            edge = "" if lane is None else lane.edge
            ahead = ("" if lane is None else lane.id, driver.following.get(edge, ""))
            foes = self._foes.get(ahead)
            if lane is None or foes is None or not self._yields(driver, edge):
                last = edge == driver.agent.route[-1]
                driver.next_check_s = math.inf if last else time_s + ELSEWHERE_S
                self._go(name, driver)
                continue
            brake, speed = driver.profile.comfort_decel_mps2, sumo.vehicle_getSpeed(name)
            away_m = lane.length_m - sumo.vehicle_getLanePosition(name)
            needs_m = speed * speed / (2.0 * brake)
            if not driver.waits:
                spare_m = away_m - needs_m - 2 * BEFORE_LINE_M - 2 * speed * self._period_s
                if spare_m > 0:
                    driver.next_check_s = time_s + self._until_s(driver.profile, speed, spare_m)
                    continue
                if away_m < needs_m:
                    continue  # too late to stop comfortably
            if any(map(sumo.lane_getLastStepVehicleNumber, foes)):
                left_m = max(away_m - BEFORE_LINE_M - speed * self._period_s, 0.0)
                sumo.vehicle_setSpeed(name, braking_speed(left_m, 0.0, brake))
                driver.waits = True
            else:
                self._go(name, driver)

    def _yields(self, driver: _YieldingDriver, edge: str) -> bool:
        """Whether a driver waits for others at the junction that an edge leads to."""
        if driver.edge != edge:
            driver.edge = edge
            driver.yields = bool(driver.rng.random() < driver.profile.yield_probability)
        return driver.yields

    def _until_s(self, profile: Profile, speed: float, spare_m: float) -> float:
        """The shortest time in which a driver that accelerates can use up the spare room, s."""
        accel = profile.max_accel_mps2
        longer = 1.0 + accel / profile.comfort_decel_mps2  # the braking distance grows, too
        square, linear = 0.5 * accel * longer, speed * longer + 2.0 * self._period_s * accel
        return (math.sqrt(linear**2 + 4.0 * square * spare_m) - linear) / (2.0 * square)

    def _go(self, name: str, driver: _YieldingDriver) -> None:
        if driver.waits:
            self._sumo.vehicle_setSpeed(name, -1.0)
            driver.waits = False


def _foes(road: Road) -> dict[tuple[str, str], tuple[str, ...]]:
    """By lane and next edge, the lanes inside the junction that have to be empty first."""
    edge = {lane.id: lane.edge for lane in road.lanes}
    links = [(number, link) for number, link in enumerate(road.connections) if link.via]
    if not links:
        return {}
    paths = [_points(road, link) for _, link in links]
    boxes = boxes_of(paths, APART_M / 2)
    found: dict[tuple[str, str], tuple[str, ...]] = {}
    near = near_pairs(boxes, boxes, CELL_M).tolist()
    for k, pairs in itertools.groupby(near, key=lambda pair: pair[0]):
        one, link = links[k]
        lanes = [
            lane
            for _, m in pairs
            if links[m][1].from_lane != link.from_lane
            and road.first_come(one, links[m][0])
            and cdist(paths[k], paths[m]).min() < APART_M
            for lane in links[m][1].via
        ]
        if lanes:
            found[link.from_lane, edge[link.to_lane]] = tuple(dict.fromkeys(lanes))
    return found


def _points(road: Road, link: Connection) -> FloatArray:
    """(P, 2) points at most a metre apart along a path through a junction, m."""
    line = np.concatenate([road.lanes[road.lane_index[name]].centerline for name in link.via])
    length_m = distances_along(line)[-1]
    return points_at(line, np.linspace(0.0, length_m, math.ceil(length_m) + 1))
