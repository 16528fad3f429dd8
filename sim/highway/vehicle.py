"""The one vehicle class of the highway engine: a highway-env vehicle with a driver's `Profile`.

Everybody follows by IDM (or by Krauss's law), bumper to bumper and with no clip to the speed limit,
and changes lanes by MOBIL; the numbers sit on the instance, so highway-env's classes stay as they
are. What the rules of the road demand (stop lines, crossings, junctions) is worked out by the road
(`sim.highway.rules`) and handed to the driver as a distance at which to stop and a speed not to
exceed.

Differs from highway-env: a decided lane change is seen by others from the next step on, so that
nobody's decision depends on the order in which vehicles act; nobody drives backwards.
"""

from __future__ import annotations

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
from sim.highway.lanes import PolylineLane
from sim.highway.network import LaneIndex
from sim.scenario import CarFollowing

FloatArray = NDArray[np.float64]

STOP_LASTS_S: Final = (3.0, 6.0)
"""How long an unprovoked stop lasts, s (our choice)."""

WISH_LASTS_S: Final = 20.0
"""A wish to cut in or to overtake on the wrong side that finds no chance is given up after this
long, s (our choice)."""

CHANGE_LEAST_SPEED_MPS: Final = 1.0
"""Nobody changes lanes slower than this (highway-env's)."""

DEFAULT_DRIVER: Final = driving.driver_numbers(
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
"""What others take a vehicle without a profile for: highway-env's IDM defaults."""


@dataclass
class Neighbours:
    """Who is ahead and behind on a lane; gaps are bumper to bumper, m, infinite for nobody.

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
class Wishes:
    """When the driver next wants to do what nothing provokes; times in s, infinite for never.

    Attributes:
        rng: the driver's own chance.
        cut_in_at: when to look for someone to cut in front of.
        stop_at: when to stop for no reason.
        stop_until: until when such a stop lasts.
        wrong_way_at: when to overtake on the wrong side.
    """

    rng: np.random.Generator
    cut_in_at: float = math.inf
    stop_at: float = math.inf
    stop_until: float = -math.inf
    wrong_way_at: float = math.inf

    def next(self, now: float, per_minute: float) -> float:
        """When the next of randomly timed wishes comes, s."""
        return now + float(self.rng.exponential(60.0 / per_minute)) if per_minute > 0 else math.inf


@dataclass
class Orders:
    """What the rules of the road demand of a driver in this step.

    Attributes:
        stop_gap: front bumper to the nearest line at which to stop, m; infinite if none.
        speed_cap: speed not to exceed, m/s; infinite if none.
        held: whether a light or a sign makes the driver stop at the junction's stop line.
        yields_to: the crossings whose pedestrians are let go first.
        changes: whether lane changes are allowed here.
    """

    stop_gap: float = math.inf
    speed_cap: float = math.inf
    held: bool = False
    yields_to: frozenset[int] = field(default_factory=frozenset)
    changes: bool = True


class ProfileVehicle(IDMVehicle):  # type: ignore[misc]
    """A vehicle driven by a `Profile`.

    Args:
        road: where it drives.
        position: (2,) m, in highway-env's axes.
        heading: rad, in highway-env's axes.
        speed: m/s.
        profile: the driver's numbers.
        kind: what it is.
        length: m.
        width: m.
        agent: id, -1 if it has none.
        behavior: the driver's true behaviour, for colours and labels only.
        law: the one by which it follows.
        seed: of the driver's own chance.
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
        profile: Profile,
        kind: AgentKind = AgentKind.CAR,
        length: float = 4.6,
        width: float = 1.8,
        agent: int = -1,
        behavior: Behavior | None = None,
        law: CarFollowing = "IDM",
        seed: int | tuple[int, ...] = 0,
        lane_index: LaneIndex | None = None,
        stretches: tuple[tuple[str, str], ...] = (),
    ) -> None:
        self.LENGTH, self.WIDTH = length, width  # before the base class measures the diagonal
        self.kind, self.agent, self.behavior, self.seed = kind, agent, behavior, seed
        self.law = law
        self.stretches = stretches
        self.orders = Orders()
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
        self.wishes = Wishes(np.random.default_rng(seed))
        self.profile = profile

    @property
    def profile(self) -> Profile:
        """The driver's numbers; setting them changes how the vehicle drives from now on."""
        return self._profile

    @profile.setter
    def profile(self, profile: Profile) -> None:
        self._profile = profile
        self.numbers = driving.driver_numbers(profile, self.kind, self.law)
        wishes, now = self.wishes, self.clock
        wishes.cut_in_at = wishes.next(now, profile.cut_in_rate_per_min)
        wishes.stop_at = wishes.next(now, profile.stop_rate_per_min)
        wishes.wrong_way_at = wishes.next(now, profile.wrong_way_rate_per_min)

    @classmethod
    def create_from(cls, vehicle: Vehicle) -> ProfileVehicle:
        """A copy with the same state, driver and route.

        Raises:
            TypeError: if the other vehicle has no profile.
        """
        if not isinstance(vehicle, ProfileVehicle):
            raise TypeError(f"found a {type(vehicle).__name__}, expected a ProfileVehicle")
        made = cls(
            vehicle.road,
            vehicle.position,
            vehicle.heading,
            vehicle.speed,
            profile=vehicle.profile,
            kind=vehicle.kind,
            length=vehicle.LENGTH,
            width=vehicle.WIDTH,
            agent=vehicle.agent,
            behavior=vehicle.behavior,
            law=vehicle.law,
            seed=vehicle.seed,
            lane_index=vehicle.lane_index,
            stretches=vehicle.stretches,
        )
        made.target_lane_index = made.wanted_lane_index = vehicle.target_lane_index
        made.timer, made.clock = vehicle.timer, vehicle.clock
        return made

    def randomize_behavior(self) -> None:
        """Nothing: the driver's numbers were drawn before the vehicle was made."""

    @property
    def limit(self) -> float:
        """The speed limit here, m/s."""
        return float(self.lane.speed_limit)

    @property
    def desired_speed(self) -> float:
        """The speed wanted on a free road here, m/s."""
        factor, top = self.numbers[driving.SPEED_FACTOR], self.numbers[driving.TOP_SPEED]
        return float(min(factor * self.limit, top, self.orders.speed_cap))

    def neighbours(self, lane_index: LaneIndex) -> Neighbours:
        """Who is ahead and behind on a lane, onward over the junction where the road knows."""
        around = getattr(self.road, "around", None)
        if around is not None:
            found: Neighbours = around(self, lane_index)
            return found
        front, rear = self.road.neighbour_vehicles(self, lane_index)
        lane = self.road.network.get_lane(lane_index)
        here = lane.local_coordinates(self.position)[0]
        seen = Neighbours(front=front, rear=rear)
        for other, ahead in ((front, True), (rear, False)):
            if other is None:
                continue
            s = lane.local_coordinates(other.position)[0]
            gap = abs(s - here) - (self.LENGTH + other.LENGTH) / 2
            speed = other.speed * math.cos(other.heading - lane.heading_at(s))
            if ahead:
                seen.front_gap, seen.front_speed = gap, speed
            else:
                seen.rear_gap, seen.rear_speed = gap, speed
        return seen

    def act(self, action: dict[str, float] | str | None = None) -> None:
        """Decide on a lane, on steering and on acceleration; ``action`` is not used."""
        if self.crashed:
            Vehicle.act(
                self, {"steering": 0.0, "acceleration": -self.numbers[driving.COMFORT_DECEL]}
            )
            return
        here = self.neighbours(self.lane_index)
        self.wanted_lane_index = self._choose_lane(here)
        Vehicle.act(
            self,
            {
                "steering": self.steering_control(self.wanted_lane_index),
                "acceleration": self._accelerate(here),
            },
        )

    def step(self, dt: float) -> None:
        """Move for ``dt`` seconds."""
        self.target_lane_index = self.wanted_lane_index
        self.clock += dt
        super().step(dt)
        if self.speed < 0.0:
            self.speed = 0.0
        if self.speed > driving.STANDING_MPS:
            self.standing_since = math.inf
        elif self.standing_since == math.inf:
            self.standing_since = self.clock

    def on_state_update(self) -> None:
        """Note which lane it is on now: the nearer of the present and the wanted one."""
        if not hasattr(self, "numbers"):
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

    def steering_control(self, target_lane_index: LaneIndex) -> float:
        """The steering angle that leads to a lane and along it, rad."""
        lane = self.road.network.get_lane(target_lane_index)
        s, lateral = lane.local_coordinates(self.position)
        heading, curvature = lane.heading_at(s), 0.0
        if isinstance(lane, PolylineLane):
            curvature = lane.curvature_at(s)
        return float(
            driving.steer(lateral, heading, curvature, self.heading, self.speed, self.LENGTH)
        )

    def wants_stop(self) -> bool:
        """Whether an unprovoked stop is on; begins and ends it."""
        wishes = self.wishes
        if self.clock >= wishes.stop_at:
            wishes.stop_until = self.clock + float(wishes.rng.uniform(*STOP_LASTS_S))
            wishes.stop_at = wishes.next(wishes.stop_until, self.profile.stop_rate_per_min)
        return self.clock < wishes.stop_until

    def wants_cut_in(self) -> bool:
        """Whether the driver is looking for someone to cut in front of; gives up in time."""
        wishes = self.wishes
        if self.clock > wishes.cut_in_at + WISH_LASTS_S:
            self.cut_in_done()
        return self.clock >= wishes.cut_in_at

    def cut_in_done(self) -> None:
        """Note that the wish to cut in is over, and draw when the next one comes."""
        self.wishes.cut_in_at = self.wishes.next(self.clock, self.profile.cut_in_rate_per_min)

    def _accelerate(self, here: Neighbours) -> float:
        desired = self.desired_speed
        accel = driving.follow(self.numbers, self.speed, desired, here.front_gap, here.front_speed)
        if self.wanted_lane_index != self.lane_index:
            there = self.neighbours(self.wanted_lane_index)
            accel = min(
                accel,
                driving.follow(
                    self.numbers, self.speed, desired, there.front_gap, there.front_speed
                ),
            )
        if self.orders.stop_gap < math.inf:
            accel = min(accel, driving.approach(self.numbers, self.speed, self.orders.stop_gap))
        if self.wants_stop():
            accel = min(accel, -float(self.numbers[driving.COMFORT_DECEL]))
        accel, self.go_at = driving.start_up(
            self.numbers, self.speed, accel, self.clock, self.go_at
        )
        if self.law == "Krauss":
            accel -= driving.dawdling(self.numbers, self.speed, float(self.wishes.rng.random()))
        return float(accel)

    def _choose_lane(self, here: Neighbours) -> LaneIndex:
        if self.wrong_way or self.clock >= self.wishes.wrong_way_at:
            overtake = getattr(self.road, "wrong_way_lane", None)
            lane = None if overtake is None else overtake(self, here)
            if lane is not None:
                return lane  # type: ignore[no-any-return]
        if self.lane_index != self.target_lane_index:
            return self._go_on_changing()
        if self.timer <= self.LANE_CHANGE_DELAY:
            return self.lane_index
        self.timer = 0.0
        if self.speed < CHANGE_LEAST_SPEED_MPS or not self.orders.changes:
            return self.lane_index
        cutting_in = self.wants_cut_in()
        best, most = self.lane_index, 0.0
        for side in self.side_lanes():
            there = self.neighbours(side)
            if cutting_in and driving.may_cut_in(
                self.numbers,
                self.speed,
                there.front_gap,
                there.front_speed,
                there.rear_gap,
                there.rear_speed,
            ):
                self.cut_in_done()
                return side
            gain = self._incentive(here, there)
            if gain > most:
                best, most = side, gain
        return best

    def side_lanes(self) -> list[LaneIndex]:
        """The lanes to the left and to the right that lead where it wants to go."""
        allowed = getattr(self.road, "lanes_allowed", None)
        if allowed is None:
            sides: list[LaneIndex] = self.road.network.side_lanes(self.lane_index)
            return sides
        found: list[LaneIndex] = allowed(self)
        return found

    def _go_on_changing(self) -> LaneIndex:
        """Give a change up if someone else just ahead is changing to the same lane."""
        if self.wrong_way or self.target_lane_index[0].startswith("~"):
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
                if ahead > 0.0 and gap < self.numbers[driving.CHANGE_GAP] + self.speed * 0.5:
                    return self.lane_index
        return self.target_lane_index

    def _incentive(self, here: Neighbours, there: Neighbours) -> float:
        rear = numbers_of(there.rear)
        old_rear = numbers_of(here.rear)
        return float(
            driving.change_incentive(
                self.numbers,
                self.speed,
                self.desired_speed,
                here.front_gap,
                here.front_speed,
                there.front_gap,
                there.front_speed,
                rear,
                there.rear_speed,
                self._wanted_by(there.rear, rear),
                there.rear_gap,
                there.rear_gap + self.LENGTH + there.front_gap,
                old_rear,
                here.rear_speed,
                self._wanted_by(here.rear, old_rear),
                here.rear_gap,
                here.rear_gap + self.LENGTH + here.front_gap,
            )
        )

    def _wanted_by(self, other: Vehicle | None, numbers: FloatArray) -> float:
        """The speed another driver wants on this road, m/s."""
        if other is None:
            return 0.0
        return float(min(numbers[driving.SPEED_FACTOR] * self.limit, numbers[driving.TOP_SPEED]))


def numbers_of(vehicle: Vehicle | None) -> FloatArray:
    """A vehicle's driver's numbers; highway-env's defaults for those without a profile."""
    return vehicle.numbers if isinstance(vehicle, ProfileVehicle) else DEFAULT_DRIVER
