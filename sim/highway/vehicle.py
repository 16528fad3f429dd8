"""The objects that show rows of vehicles to others, as vehicles of highway-env.

The rows (`sim.highway.state.VEHICLE`) are the truth; kernels read and write them. A
`ProfileVehicle` is a view of one row, for those who look at ``road.vehicles``; setting an attribute
changes the row.

Differs from highway-env: others see a decided lane change from the next step on, so that no
decision depends on the order in which vehicles act; vehicles do not drive backwards.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle

from behaviors.labels import Behavior
from behaviors.profiles import Profile
from sim.frames import FloatArray
from sim.highway.draws import CUTS_IN, LAPSES, STOPS, WRONG_WAY, driver_key, wait_s
from sim.highway.driving import profile_fields
from sim.highway.lanes import LaneIndex, PolylineLane, Stretch
from sim.highway.state import VEHICLE, blank_vehicle
from sim.highway.tables import Records
from sim.scenario import AgentSpec, CarFollowing

FIELDS: Final = frozenset(VEHICLE.names or ())


def column(name: str, kind: type) -> Any:
    """A property that shows a field of an object's row as a Python value, and sets it."""

    def show(self: Any) -> Any:
        return kind(self.table[name][self.row])

    def change(self: Any, value: Any) -> None:
        self.table[name][self.row] = value

    return property(show, change)


def lane_column(name: str) -> Any:
    """A property that shows the number of a lane as highway-env's index of it."""

    def show(self: Any) -> LaneIndex:
        index: LaneIndex = self.road.network_info.keys[int(self.table[name][self.row])]
        return index

    def change(self: Any, lane: LaneIndex) -> None:
        self.table[name][self.row] = self.road.network_info.number[lane]

    return property(show, change)


class RowView:
    """Shows one row of an array of agents as an object of highway-env.

    Attributes:
        table: the array.
        row: which of its rows.
    """

    table: Records
    row: int
    heading = column("heading", float)
    speed = column("speed", float)
    LENGTH = column("length", float)
    WIDTH = column("width", float)
    agent = column("agent", int)
    crashed = column("crashed", bool)
    crashed_at = column("crashed_at", float)

    @property
    def position(self) -> FloatArray:
        """(2,) its place, m, in highway-env's axes."""
        return np.array([self.table["x"][self.row], self.table["y"][self.row]])

    @position.setter
    def position(self, xy: FloatArray) -> None:
        self.table["x"][self.row], self.table["y"][self.row] = xy


class ProfileVehicle(RowView, ControlledVehicle):  # type: ignore[misc]
    """A vehicle driven by a `Profile`, seen as a highway-env vehicle.

    Args:
        road: the `TrafficRoad` where it will drive, once it is put on a lane.
        spec: its kind, size, behaviour and profile.
        stretches: the stretches of road that it will drive over.
        seed: of the driver's own random numbers.
        law: the car-following law.
    """

    lane_index = lane_column("lane")
    target_lane_index = lane_column("target")
    wanted_lane_index = lane_column("wanted")
    stop_at = column("stop_at", float)
    stop_until = column("stop_until", float)

    route = None

    def __init__(
        self,
        road: Any,
        spec: AgentSpec,
        stretches: tuple[Stretch, ...],
        seed: int | tuple[int, ...],
        law: CarFollowing = "IDM",
    ) -> None:
        self.road, self.spec, self.law, self.kind = road, spec, law, spec.kind
        self.table, self.row = np.array([blank_vehicle()], VEHICLE), 0
        self.table["key"], self.table["profiled"] = driver_key(seed), True
        self.table["kind"], self.agent = spec.kind.code, spec.id
        self.LENGTH, self.WIDTH = spec.length_m, spec.width_m
        self.stretches = stretches
        assert spec.profile is not None
        self.profile = spec.profile

    def put(self, lane: LaneIndex, s: float, speed: float) -> ProfileVehicle:
        """Place it in the middle of a lane, ``s`` m along it, at a speed in m/s."""
        geometry = self.road.network_info.lanes[lane]
        self.position, self.heading = geometry.position(s, 0.0), geometry.heading_at(s)
        self.speed = self.target_speed = speed
        self.lane_index = self.target_lane_index = self.wanted_lane_index = lane
        self.table["timer"] = float(np.sum(self.position) * np.pi) % 1.0  # as in highway-env
        return self

    @property
    def lane(self) -> PolylineLane:
        """The lane it is on."""
        found: PolylineLane = self.road.network_info.lanes[self.lane_index]
        return found

    @property
    def behavior(self) -> Behavior | None:
        """The driver's true behaviour, for colours and labels only."""
        return self.spec.behavior

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The stretches of road that it drives over."""
        return self._stretches

    @stretches.setter
    def stretches(self, stretches: tuple[Stretch, ...]) -> None:
        self._stretches = stretches
        self.table["leg"][self.row] = 0
        self.table["route"][self.row] = self.road.route_number(stretches)

    @property
    def profile(self) -> Profile:
        """The driver's profile; setting another one changes how the vehicle drives from now on."""
        assert self.spec.profile is not None
        return self.spec.profile

    @profile.setter
    def profile(self, profile: Profile) -> None:
        self.spec = dataclasses.replace(self.spec, profile=profile)
        row = self.table[self.row]
        for name, value in profile_fields(profile, self.kind, self.law).items():
            if name in FIELDS:
                row[name] = value
        row.late_since = -1
        for at, kind, drawn, rate in (
            ("cut_in_at", CUTS_IN, "cut_ins", row.cut_in_rate_per_min),
            ("stop_at", STOPS, "stops", row.stop_rate_per_min),
            ("lapse_at", LAPSES, "lapses", row.lapse_rate_per_min),
            ("wrong_way_at", WRONG_WAY, "wrong_ways", row.wrong_way_rate_per_min),
        ):
            row[at] = row.clock + wait_s(row.key, kind, row[drawn], rate)
            row[drawn] += 1
