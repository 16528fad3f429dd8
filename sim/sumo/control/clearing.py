"""Letting those who are still in the junction leave it before one enters.

SUMO's drivers enter on green, and at all-way stops, while somebody on a way that crosses theirs
still stands in the junction, and go on past each other's corners. Who lets pedestrians go first
lets vehicles finish, too (German road traffic regulations, section 11(1) and (3)): with the same
probability, drawn once per junction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from behaviors.driver_models import braking_speed
from behaviors.profiles import Profile
from sim.frames import FloatArray
from sim.road import Connection, Road
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import OnRoute, Steered

APART_M: Final = 2.5
"""Ways that come closer than this cross or join (our choice: a car's width and some room)."""

ELSEWHERE_S: Final = 1.0
"""Who is on no lane that leads to such a junction looks again after this (our choice)."""

BEFORE_LINE_M: Final = 1.0
"""Who waits does it this far before the line (SUMO's own distance)."""


@dataclass(slots=True)
class _Driver(OnRoute):
    """One driver who lets others finish."""

    lets: bool = False
    waits: bool = False


class Clearing(Steered[_Driver]):
    """Keeps drivers before the line while others clear the junction.

    Args:
        sumo: libsumo's C module.
        road: the road.
        agents: everyone; those who never let anybody go first are left alone.
        acts_s: how often drivers act, s.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec], acts_s: float) -> None:
        super().__init__()
        self._sumo = sumo
        self._length = {lane.id: lane.length_m for lane in road.lanes if not lane.internal}
        self._edge = {lane.id: lane.edge for lane in road.lanes if not lane.internal}
        self._foes = _foes(road)
        self._acts_s = acts_s
        self._drivers = {
            str(a.id): _Driver(a, np.random.default_rng((a.seed, 6)))
            for a in agents
            if self._foes and a.profile is not None and a.profile.yield_probability > 0
        }

    def step(self, time_s: float) -> None:
        """Hold drivers back before the line, or let them go.

        Args:
            time_s: simulated time, s.
        """
        sumo = self._sumo
        for name, driver in self._here:
            if time_s < driver.look_s:
                continue
            lane = sumo.vehicle_getLaneID(name)
            edge = self._edge.get(lane, "")
            foes = self._foes.get((lane, driver.following.get(edge, "")))
            if foes is None or not self._lets(driver, edge):
                last = edge == driver.agent.route[-1]
                driver.look_s = math.inf if last else time_s + ELSEWHERE_S
                self._go(name, driver)
                continue
            profile = driver.agent.profile
            assert profile is not None
            brake, speed = profile.comfort_decel_mps2, sumo.vehicle_getSpeed(name)
            away_m = self._length[lane] - sumo.vehicle_getLanePosition(name)
            needs_m = speed * speed / (2.0 * brake)
            if not driver.waits:
                spare_m = away_m - needs_m - 2 * BEFORE_LINE_M - 2 * speed * self._acts_s
                if spare_m > 0:
                    driver.look_s = time_s + self._until_s(profile, speed, spare_m)
                    continue
                if away_m < needs_m:
                    continue  # too late to stop comfortably
            if not any(map(sumo.lane_getLastStepVehicleNumber, foes)):
                self._go(name, driver)
                continue
            left_m = max(away_m - BEFORE_LINE_M - speed * self._acts_s, 0.0)
            sumo.vehicle_setSpeed(name, braking_speed(left_m, 0.0, brake))
            driver.waits = True

    def _lets(self, driver: _Driver, edge: str) -> bool:
        """Whether a driver lets others finish at the junction that an edge leads to."""
        profile = driver.agent.profile
        assert profile is not None
        if driver.edge != edge:
            driver.edge = edge
            driver.lets = bool(driver.rng.random() < profile.yield_probability)
        return driver.lets

    def _until_s(self, profile: Profile, speed: float, spare_m: float) -> float:
        """How long spare room lasts at least, s: for who accelerates all the while."""
        accel = profile.max_accel_mps2
        longer = 1.0 + accel / profile.comfort_decel_mps2  # braking takes longer, too
        square, linear = 0.5 * accel * longer, speed * longer + 2.0 * self._acts_s * accel
        return (math.sqrt(linear**2 + 4.0 * square * spare_m) - linear) / (2.0 * square)

    def _go(self, name: str, driver: _Driver) -> None:
        if driver.waits:
            self._sumo.vehicle_setSpeed(name, -1.0)
            driver.waits = False


def _foes(road: Road) -> dict[tuple[str, str], tuple[str, ...]]:
    """By lane and next edge, the lanes inside a junction on which others have to finish first."""
    edge = {lane.id: lane.edge for lane in road.lanes}
    ways = [(number, way) for number, way in enumerate(road.connections) if way.via]
    if not ways:
        return {}
    paths = [_points(road, way) for _, way in ways]
    low = np.array([path.min(axis=0) for path in paths]) - APART_M
    high = np.array([path.max(axis=0) for path in paths])
    found: dict[tuple[str, str], tuple[str, ...]] = {}
    for k, (one, way) in enumerate(ways):
        close = ((low <= high[k]) & (low[k] <= high)).all(axis=1)
        lanes = [
            lane
            for m in np.flatnonzero(close).tolist()
            if ways[m][1].from_lane != way.from_lane
            and road.first_come(one, ways[m][0])
            and _apart_m(paths[k], paths[m]) < APART_M
            for lane in ways[m][1].via
        ]
        if lanes:
            found[way.from_lane, edge[way.to_lane]] = tuple(dict.fromkeys(lanes))
    return found


def _points(road: Road, way: Connection) -> FloatArray:
    """(P, 2) points at most a metre apart along a way through a junction, m."""
    line = np.concatenate([road.lanes[road.lane_index[name]].centerline for name in way.via])
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    fine = np.linspace(0.0, at[-1], math.ceil(at[-1]) + 1)
    return np.stack([np.interp(fine, at, line[:, k]) for k in (0, 1)], axis=1)


def _apart_m(one: FloatArray, two: FloatArray) -> float:
    """The least distance between points of two lines, m."""
    return float(np.hypot(*(one[:, None] - two[None]).transpose(2, 0, 1)).min())
