"""Vehicles as rows of one array, and the objects that show these rows to others.

The rows (`VEHICLE`) are the truth; kernels read and write them. A `ProfileVehicle` is a view of one
row with the attributes of a highway-env vehicle, for those who look at ``road.vehicles``; setting
an attribute changes the row.

Differs from highway-env: others see a decided lane change from the next step on, so that no
decision depends on the order in which vehicles act; vehicles do not drive backwards.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.controller import ControlledVehicle
from numpy.typing import NDArray

from behaviors.labels import Behavior
from behaviors.profiles import Profile
from sim.frames import AgentKind
from sim.highway import driving
from sim.highway.draws import CUTS_IN, STOPS, WRONG_WAY, driver_key, wait_s
from sim.highway.lanes import LaneIndex
from sim.highway.tables import LaneTables, Records, record_type
from sim.scenario import CarFollowing

FloatArray = NDArray[np.float64]
Stretch = tuple[str, str]

MOST_MET: Final = 4
"""A driver remembers the pedestrians at this many crossings, until it has passed them."""

VEHICLE: Final = record_type(
    agent="i8", kind="i8", profiled="?", length="f8", width="f8", route="i8", leg="i8", key="u8",
    # its driver: the row of `driver_parameters`, and what the profile says of rules and manoeuvres
    parameters=f"{driving.PARAMETERS}f8", krauss="?",
    yellow_run_s="f8", gap_acceptance_s="f8", insistence="f8", crossing_gap_s="f8",
    red_run_probability="f8", stop_roll_probability="f8", yield_probability="f8",
    cut_in_rate_per_min="f8", stop_rate_per_min="f8", wrong_way_rate_per_min="f8",
    # motion
    x="f8", y="f8", heading="f8", speed="f8", steering="f8", accel="f8",
    lane="i8", target="i8", wanted="i8",
    # memory
    clock="f8", timer="f8", go_at="f8", standing_since="f8", changed_at="f8",
    crashed="?", crashed_at="f8", wrong_way="?", ran_red="?",
    cut_in_at="f8", stop_at="f8", stop_until="f8", wrong_way_at="f8",
    cut_ins="i8", stops="i8", wrong_ways="i8", dawdled="i8",
    last_path="i8", path_before="i8", line_before="f8", stood_at="i8",
    met=f"{MOST_MET}i8", met_near=f"{MOST_MET}i1", yielded=f"{MOST_MET}i1",
    # where it is on its way, in this step
    s="f8", then="i8", path="i8", to_line="f8", stood_s="f8",
    # what the rules demand in this step
    stop_gap="f8", speed_cap="f8", held="?", was_held="?", changes="?", forced="i8", astray="?",
    at_end="?", leaves="i8",
)  # fmt: skip
"""A vehicle; lengths in m, times in s, angles in rad, highway-env's axes, -1 for none.

``profiled``: whether a `Profile` drives it; ``leg``: the last stretch of its route that it came to;
``target``: the lane that it changes to, or the present
one; ``wanted``: the same from the next step on; ``go_at``: when it may start, after standing;
``standing_since``: infinite while it moves; ``cut_ins``, ``stops``, ``wrong_ways``, ``dawdled``:
how many times each was drawn; ``last_path``: the junction path that it was on last, until it has
left it; ``path_before``, ``line_before``: the path ahead a step ago and how far away it was;
``stood_at``: the path before whose stop sign it has stood; ``met``: crossings at which it met
pedestrians (``met_near``) or ``yielded``; ``then``: the stretch after its lane's; ``path``: the
junction path that it is on or comes to next; ``to_line``: front bumper to the beginning of that
path, or to the end of a lane without one, negative beyond it; ``stood_s``: for how long it has
stood; ``stop_gap``: front bumper to the nearest line at which to stop; ``speed_cap``: speed not to
exceed; ``held``: whether a light or a sign makes it stop at the line, and ``was_held`` a step ago;
``changes``: whether lane changes are allowed; ``forced``: the lane that it has to head for;
``astray``: whether it needs another route; ``at_end``: whether it may have arrived; ``leaves``: why
it goes.
"""

Seed = int | tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Driver:
    """Who drives a vehicle.

    Attributes:
        profile: how.
        behavior: the true behaviour, for colours and labels only.
        law: the car-following law.
        seed: of the driver's own random numbers.
    """

    profile: Profile
    behavior: Behavior | None = None
    law: CarFollowing = "IDM"
    seed: Seed = 0


class OnRoad(Protocol):
    """What a vehicle needs of its road."""

    tables: LaneTables

    def route_number(self, stretches: tuple[Stretch, ...]) -> int:
        """The number of a route, the same for equal ones."""


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
        index: LaneIndex = self.road.tables.keys[int(self.table[name][self.row])]
        return index

    def change(self: Any, lane: LaneIndex) -> None:
        self.table[name][self.row] = self.road.tables.number[lane]

    return property(show, change)


def position_of(self: Any) -> FloatArray:
    """The place of an object's row, m, in highway-env's axes."""
    row = self.table[self.row]
    return np.array([row.x, row.y])


def move_to(self: Any, xy: FloatArray) -> None:
    """Change the place of an object's row."""
    self.table["x"][self.row], self.table["y"][self.row] = xy


def blank_row() -> Records:
    """One row of a vehicle that stands nowhere and has no driver."""
    made = np.zeros(1, VEHICLE)
    for name in ("go_at", "standing_since", "crashed_at", "stop_gap", "speed_cap", "cut_in_at",
                 "stop_at", "wrong_way_at"):  # fmt: skip
        made[name] = math.inf
    made["changed_at"] = made["stop_until"] = -math.inf
    for name in ("last_path", "path_before", "stood_at", "then", "path", "forced", "met", "route"):
        made[name] = -1
    made["agent"], made["changes"] = -1, True
    return made


class ProfileVehicle(ControlledVehicle):  # type: ignore[misc]
    """A vehicle driven by a `Profile`, seen as a highway-env vehicle.

    Args:
        road: where it drives.
        position: (2,) m, in highway-env's axes.
        heading: rad, in highway-env's axes.
        speed: m/s.
        driver: who drives it.
        kind: of vehicle.
        length: m.
        width: m.
        agent: id, -1 if it has none.
        lane_index: the lane it is on.
        stretches: the stretches of road it will drive over, from the present one on.
    """

    position = property(position_of, move_to)
    heading = column("heading", float)
    speed = column("speed", float)
    lane_index = lane_column("lane")
    target_lane_index = lane_column("target")
    wanted_lane_index = lane_column("wanted")
    LENGTH = column("length", float)
    WIDTH = column("width", float)
    agent = column("agent", int)
    crashed = column("crashed", bool)
    crashed_at = column("crashed_at", float)
    standing_since = column("standing_since", float)
    clock = column("clock", float)
    timer = column("timer", float)
    stop_at = column("stop_at", float)
    stop_until = column("stop_until", float)
    stop_gap = column("stop_gap", float)
    wrong_way = column("wrong_way", bool)
    ran_red = column("ran_red", bool)

    route = impact = None
    check_collisions = hit = False

    def __init__(
        self,
        road: OnRoad,
        position: FloatArray,
        heading: float,
        speed: float,
        *,
        driver: Driver,
        lane_index: LaneIndex,
        kind: AgentKind = AgentKind.CAR,
        length: float = 4.6,
        width: float = 1.8,
        agent: int = -1,
        stretches: tuple[Stretch, ...] = (),
    ) -> None:
        self.road, self.driver, self.kind = road, driver, kind
        self.table, self.row = blank_row(), 0
        self.position, self.heading, self.speed = position, heading, speed
        self.target_speed = speed
        self.LENGTH, self.WIDTH, self.agent = length, width, agent
        self.lane_index = self.target_lane_index = self.wanted_lane_index = lane_index
        self.timer = float(np.sum(position) * np.pi) % 1.0  # as in highway-env
        self.table["kind"] = kind.code
        self.table["profiled"], self.table["key"] = True, driver_key(driver.seed)
        self.stretches = stretches
        self.profile = driver.profile

    @property
    def action(self) -> dict[str, float]:
        """The steering angle, rad, and the acceleration, m/s2, decided last."""
        row = self.table[self.row]
        return {"steering": float(row.steering), "acceleration": float(row.accel)}

    @property
    def lane(self) -> AbstractLane:
        """The lane it is on."""
        return self.road.tables.network.lanes[self.lane_index]

    @property
    def diagonal(self) -> float:
        """From corner to corner, m."""
        return math.hypot(self.LENGTH, self.WIDTH)

    @property
    def behavior(self) -> Behavior | None:
        """The driver's true behaviour, for colours and labels only."""
        return self.driver.behavior

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
    def desired_speed(self) -> float:
        """The speed wanted on a free road here, m/s."""
        row, lanes = self.table[self.row], self.road.tables.net.lanes
        wanted = row.parameters[driving.SPEED_FACTOR] * lanes[row.lane].limit
        return float(min(wanted, row.parameters[driving.TOP_SPEED], row.speed_cap))

    @property
    def profile(self) -> Profile:
        """The driver's profile; setting another one changes how the vehicle drives from now on."""
        return self.driver.profile

    @profile.setter
    def profile(self, profile: Profile) -> None:
        self.driver = dataclasses.replace(self.driver, profile=profile)
        row = self.table[self.row]
        row.parameters[:] = driving.driver_parameters(profile, self.kind, self.driver.law)
        for name in PROFILE_FIELDS:
            setattr(row, name, getattr(profile, name))
        now, key = row.clock, row.key
        row.cut_in_at = now + wait_s(key, CUTS_IN, row.cut_ins, profile.cut_in_rate_per_min)
        row.stop_at = now + wait_s(key, STOPS, row.stops, profile.stop_rate_per_min)
        wait = wait_s(key, WRONG_WAY, row.wrong_ways, profile.wrong_way_rate_per_min)
        row.wrong_way_at = now + wait
        row.cut_ins, row.stops, row.wrong_ways = (
            row.cut_ins + 1, row.stops + 1, row.wrong_ways + 1
        )  # fmt: skip


PROFILE_FIELDS: Final = tuple(
    name
    for name in VEHICLE.names or ()
    if name in {field.name for field in dataclasses.fields(Profile)}
)
"""The fields of a profile that a vehicle's row holds as they are."""
