"""The vehicle class of the highway engine: a highway-env vehicle with a driver's `Profile`.

Drivers follow by IDM or by Krauss's law, from bumper to bumper and not held to the speed limit, and
change lanes by MOBIL. `sim.highway.rules` works out what the rules of the road demand (stop lines,
crossings, junctions) and gives it to each driver as `DriverCommands`. `sim.highway.kernels` decides
for all drivers at once and moves them.

Differs from highway-env: others see a decided lane change from the next step on, so that no
decision depends on the order in which vehicles act; vehicles do not drive backwards.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behaviors.labels import Behavior
from behaviors.profiles import Profile
from sim.frames import AgentKind
from sim.highway import driving
from sim.highway.lanes import LaneIndex
from sim.highway.network import is_wrong_side
from sim.scenario import CarFollowing

FloatArray = NDArray[np.float64]

STOP_LASTS_S: Final = (3.0, 6.0)
"""Least and longest duration of an unprovoked stop, s."""

GIVE_UP_S: Final = 20.0
"""A driver that finds nobody to cut in front of for this long waits for its next time, s."""

CHANGE_LEAST_SPEED_MPS: Final = 1.0
"""Slower vehicles do not change lanes, m/s (as in highway-env)."""

DEFAULT_PARAMETERS: Final = driving.driver_parameters(
    Profile(
        speed_factor=1.0, time_headway_s=1.5, min_gap_m=2.0, max_accel_mps2=3.0,
        comfort_decel_mps2=5.0, politeness=0.0, lane_change_gain=1.0,
        lane_change_patience_s=0.0, lane_change_assertiveness=1.0, gap_acceptance_s=1.0,
        crossing_gap_s=10.0, yield_probability=1.0, red_run_probability=0.0,
        stop_roll_probability=0.0, yellow_run_s=0.0, insistence=0.0, startup_delay_s=0.0,
        cut_in_rate_per_min=0.0, stop_rate_per_min=0.0, wrong_way_rate_per_min=0.0,
    ),
    AgentKind.CAR,
)  # fmt: skip
"""The driver parameters that others assume of a vehicle without a profile: highway-env's own."""


@dataclass(slots=True)
class Neighbours:
    """The vehicles ahead and behind on a lane; gaps are bumper to bumper, infinite without one.

    Attributes:
        front: the vehicle ahead.
        front_gap: m.
        front_speed: along the lane, m/s.
        rear: the vehicle behind.
        rear_gap: m.
        rear_speed: m/s.
    """

    front: Vehicle | None = None
    front_gap: float = math.inf
    front_speed: float = 0.0
    rear: Vehicle | None = None
    rear_gap: float = math.inf
    rear_speed: float = 0.0


@dataclass
class ManeuverSchedule:
    """When a driver next begins an unprovoked manoeuvre; times in s, infinite for never.

    Attributes:
        rng: the driver's own random numbers.
        cut_in_at: when it begins to look for a vehicle to cut in front of.
        stop_at: when it next stops for no reason.
        stop_until: when such a stop ends.
        wrong_way_at: when it begins to look for a chance to overtake on the wrong side.
    """

    rng: np.random.Generator
    cut_in_at: float = math.inf
    stop_at: float = math.inf
    stop_until: float = -math.inf
    wrong_way_at: float = math.inf

    def next(self, now: float, per_minute: float) -> float:
        """Draw the time of the next event of a Poisson process, s."""
        return now + float(self.rng.exponential(60.0 / per_minute)) if per_minute > 0 else math.inf


@dataclass
class DriverCommands:
    """What the rules of the road demand of a driver in this step.

    Attributes:
        stop_gap: front bumper to the nearest line at which to stop, m; infinite if none.
        speed_cap: speed not to exceed, m/s; infinite if none.
        held: whether a light or a sign makes the driver stop at the junction's stop line.
        yields_to: the crossings whose pedestrians the driver lets go first.
        changes: whether lane changes are allowed here.
        forced_lane: the lane to head for, of a driver that overtakes on the wrong side or has to
            get over; None for a free choice.
    """

    stop_gap: float = math.inf
    speed_cap: float = math.inf
    held: bool = False
    yields_to: frozenset[int] = field(default_factory=frozenset)
    changes: bool = True
    forced_lane: LaneIndex | None = None

    def stop_within(self, gap: float) -> None:
        """Stop at a line, m ahead, unless an earlier stop is demanded already."""
        self.stop_gap = min(self.stop_gap, gap)


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
    seed: int | tuple[int, ...] = 0


class ProfileVehicle(IDMVehicle):  # type: ignore[misc]
    """A vehicle driven by a `Profile`.

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
        lane_index: the lane it is on; the nearest one if not given.
        stretches: the stretches of road it will drive over, from the present one on.
    """

    speed: float
    timer: float

    def __init__(
        self,
        road: Road,
        position: FloatArray,
        heading: float = 0.0,
        speed: float = 0.0,
        *,
        driver: Driver,
        kind: AgentKind = AgentKind.CAR,
        length: float = 4.6,
        width: float = 1.8,
        agent: int = -1,
        lane_index: LaneIndex | None = None,
        stretches: tuple[tuple[str, str], ...] = (),
    ) -> None:
        self.LENGTH, self.WIDTH = length, width  # before the base class measures the diagonal
        self.kind, self.agent, self.driver = kind, agent, driver
        self.stretches = stretches
        self.commands = DriverCommands()
        self.clock = 0.0
        self.go_at = math.inf
        self.wrong_way = False
        self.draws: dict[Any, bool] = {}
        self.crashed_at = math.inf
        self.changed_at = -math.inf
        self.standing_since = math.inf
        super().__init__(road, position, heading, speed, target_lane_index=lane_index)
        if lane_index is not None:
            self.lane_index, self.lane = lane_index, road.network.get_lane(lane_index)
        self.wanted_lane_index: LaneIndex = self.target_lane_index
        self.schedule = ManeuverSchedule(np.random.default_rng(driver.seed))
        self.profile = driver.profile

    @property
    def behavior(self) -> Behavior | None:
        """The driver's true behaviour, for colours and labels only."""
        return self.driver.behavior

    @property
    def profile(self) -> Profile:
        """The driver's profile; setting another one changes how the vehicle drives from now on."""
        return self.driver.profile

    @profile.setter
    def profile(self, profile: Profile) -> None:
        self.driver = dataclasses.replace(self.driver, profile=profile)
        self.parameters = driving.driver_parameters(profile, self.kind, self.driver.law)
        schedule, now = self.schedule, self.clock
        schedule.cut_in_at = schedule.next(now, profile.cut_in_rate_per_min)
        schedule.stop_at = schedule.next(now, profile.stop_rate_per_min)
        schedule.wrong_way_at = schedule.next(now, profile.wrong_way_rate_per_min)

    @property
    def desired_speed(self) -> float:
        """The speed wanted on a free road here, m/s."""
        wanted = self.parameters[driving.SPEED_FACTOR] * float(self.lane.speed_limit)
        wanted = min(wanted, float(self.parameters[driving.TOP_SPEED]))
        return float(min(wanted, self.commands.speed_cap))

    def on_state_update(self) -> None:
        """Update the lane that the vehicle is on: the nearer of the present and the target one."""
        if not hasattr(self, "parameters"):
            super().on_state_update()
            return
        network = self.road.network
        if self.lane_index != self.target_lane_index:
            own = abs(self.lane.local_coordinates(self.position)[1])
            target = network.get_lane(self.target_lane_index)
            if abs(target.local_coordinates(self.position)[1]) < own:
                self.lane_index, self.lane = self.target_lane_index, target
                self.changed_at = self.clock
        onward = getattr(self.road, "onward_lane", None)
        if onward is not None and self.lane.local_coordinates(self.position)[0] > self.lane.length:
            then = onward(self, self.lane_index)
            if then is not None:
                self.lane_index, self.lane = then, network.get_lane(then)
                self.target_lane_index = self.wanted_lane_index = then

    def wants_stop(self) -> bool:
        """Whether the driver stops for no reason now; schedules such stops."""
        schedule = self.schedule
        if self.clock >= schedule.stop_at:
            schedule.stop_until = self.clock + float(schedule.rng.uniform(*STOP_LASTS_S))
            rate = self.profile.stop_rate_per_min
            schedule.stop_at = schedule.next(schedule.stop_until, rate)
        return self.clock < schedule.stop_until

    def wants_cut_in(self) -> bool:
        """Whether the driver looks for a vehicle to cut in front of; gives up after a while."""
        if self.clock > self.schedule.cut_in_at + GIVE_UP_S:
            self.schedule_cut_in()
        return self.clock >= self.schedule.cut_in_at

    def schedule_cut_in(self) -> None:
        """Draw when the driver next begins to look for a vehicle to cut in front of."""
        self.schedule.cut_in_at = self.schedule.next(self.clock, self.profile.cut_in_rate_per_min)

    def go_on_changing(self) -> LaneIndex:
        """The target lane, or the present one if a vehicle just ahead changes to the same lane."""
        if self.wrong_way or is_wrong_side(self.target_lane_index):
            return self.target_lane_index
        for other in self.road.vehicles:
            if (
                other is not self
                and isinstance(other, ProfileVehicle)
                and other.target_lane_index == self.target_lane_index
                and other.lane_index != self.target_lane_index
            ):
                ahead = self.lane_distance_to(other)
                gap = ahead - (self.LENGTH + other.LENGTH) / 2
                if ahead > 0.0 and gap < self.parameters[driving.CHANGE_GAP] + self.speed * 0.5:
                    return self.lane_index
        return self.target_lane_index


def parameters_of(vehicle: Vehicle | None) -> FloatArray:
    """The driver parameters of a vehicle; highway-env's defaults for one without a profile."""
    return vehicle.parameters if isinstance(vehicle, ProfileVehicle) else DEFAULT_PARAMETERS
