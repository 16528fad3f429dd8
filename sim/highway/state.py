"""The state of the highway engine: which vehicles and pedestrians are where on a scenario's road.

`RoadState` knows the network, the signals, every vehicle's place on every lane and its way ahead,
so that it finds leaders across junctions. The rules of the road (`sim.highway.rules`) read it, and
`sim.highway.traffic` moves everybody.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from sim.frames import Event, EventKind, Signal
from sim.geometry import Outlines
from sim.highway import driving
from sim.highway.lane_places import OnLanes, distances_along, find_on_lanes
from sim.highway.lanes import LaneIndex
from sim.highway.network import HighwayNetwork
from sim.highway.vehicle import Neighbours, ProfileVehicle
from sim.highway.walkers import Walker

FloatArray = NDArray[np.float64]

JOINED_M: Final = 2.0
"""A vehicle this far before the beginning of the next lane, and in line with it, leads onto it,
whichever way it comes (half a car)."""

PHASE_ROUNDING_S: Final = 1e-6
"""Signal plans are looked at again this long before a phase ends, s, because times are rounded."""

LEADER_RANGE_M: Final = 200.0
"""Leaders farther ahead are not looked for."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A vehicle coming to the place where its lane runs over a crossing.

    Attributes:
        near: front bumper to the near edge, m.
        far: front bumper to the far edge, m.
        vehicle: which.
        yields: the crossings whose pedestrians it lets go first.
        held: whether it is going to stop at a line before the crossing.
        stood_s: for how long it has stood, s.
    """

    near: float
    far: float
    vehicle: Vehicle
    yields: frozenset[int]
    held: bool
    stood_s: float


class Located(NamedTuple):
    """Where everybody is, as of the last `RoadState.locate`; n vehicles.

    Attributes:
        xy: (n, 2) m.
        heading: (n,) rad.
        speed: (n,) m/s.
        on: who is on which lane.
    """

    xy: FloatArray
    heading: FloatArray
    speed: FloatArray
    on: OnLanes


class RoadState(Road):  # type: ignore[misc]
    """The road with everybody on it, at one time.

    Args:
        network: the road in highway-env's terms.
    """

    vehicles: list[Vehicle]

    def __init__(self, network: HighwayNetwork) -> None:
        super().__init__(network.net, np_random=np.random.RandomState(0))
        self.network_info = network
        self.time_s = 0.0
        self.events: list[Event] = []
        self.walkers: list[Walker] = []
        self.arrivals: dict[tuple[int, int], list[Arrival]] = {}
        self.signals = np.full(len(network.road.signal_groups), Signal.OFF.code, dtype=np.int8)
        self.signal_since = np.zeros(self.signals.size)
        self._plan_due_s = np.zeros(len(network.road.signal_plans))
        self.update_signals()
        self.signal_since[:] = -math.inf
        self._index = {lane: k for k, lane in enumerate(network.lanes)}
        self.strips_of = self._strips()
        self.strip_number: dict[tuple[LaneIndex, int], int] = {}
        for lane, info in network.info.items():
            for strip in info.strips:
                for number, (u, _) in enumerate(self.strips_of[strip.crossing]):
                    if abs(u - strip.u) < 0.5:
                        self.strip_number[lane, strip.crossing] = number
                        break
        self._located: list[Vehicle] = []

    def _strips(self) -> list[list[tuple[float, float]]]:
        """For each crossing, where lanes run over it: middle and half width, m along it."""
        found: list[list[tuple[float, float]]] = [[] for _ in self.network_info.road.crossings]
        for lane, info in self.network_info.info.items():
            for strip in info.strips:
                places = found[strip.crossing]
                if all(abs(u - strip.u) >= 0.5 for u, _ in places):
                    places.append((strip.u, self.network_info.lanes[lane].width / 2))
        return [sorted(places) for places in found]

    # Signals and events ----------------------------------------------------------------------

    def update_signals(self) -> None:
        """Show what the signal plans say for the present time."""
        plans = self.network_info.road.signal_plans
        for number in np.flatnonzero(self._plan_due_s <= self.time_s).tolist():
            plan = plans[number]
            states, lasts_s = plan.phase_at(self.time_s)
            self._plan_due_s[number] = self.time_s + lasts_s - PHASE_ROUNDING_S
            for group, state in zip(plan.groups, states, strict=True):
                if self.signals[group] != state:
                    self.signals[group] = state
                    self.signal_since[group] = self.time_s

    def add_event(
        self, kind: EventKind, agent: int, other: int | None = None, rule: str = ""
    ) -> None:
        """Record an event now."""
        self.events.append(Event(kind, self.time_s, agent, other, rule))

    def take_events(self) -> tuple[Event, ...]:
        """The events since the last call."""
        taken, self.events = tuple(self.events), []
        return taken

    # The way ahead ---------------------------------------------------------------------------

    def next_stretch(self, vehicle: Vehicle, stretch: tuple[str, str]) -> tuple[str, str] | None:
        """The stretch that a vehicle wants to reach after one; None at the end of its way."""
        ways = getattr(vehicle, "stretches", ())
        if stretch in ways:
            at = ways.index(stretch)
            return ways[at + 1] if at + 1 < len(ways) else None
        return None

    def onward_lane(self, vehicle: Vehicle, lane: LaneIndex) -> LaneIndex | None:
        """The lane that follows on a vehicle's way; None at its end or on a wrong lane."""
        exit_of = self.network_info.exit_of
        if lane in exit_of:
            return exit_of[lane]
        then = self.next_stretch(vehicle, lane[:2])
        return None if then is None else self.network_info.onward.get((lane, then))

    # Places ----------------------------------------------------------------------------------

    def locate(self) -> None:
        """Find who is on which lane; valid until somebody moves."""
        self._located = list(self.vehicles)
        self._row = {id(vehicle): i for i, vehicle in enumerate(self._located)}
        n = len(self._located)
        xy = np.array([v.position for v in self._located], dtype=np.float64).reshape(n, 2)
        heading = np.array([v.heading for v in self._located], dtype=np.float64)
        self.lengths = np.array([v.LENGTH for v in self._located], dtype=np.float64)
        speed = np.array([v.speed for v in self._located], dtype=np.float64)
        on = find_on_lanes(xy, heading, speed, self.lengths, self.network_info.lines)
        self.located = Located(xy, heading, speed, on)
        self._on_lane: dict[LaneIndex, tuple[list[float], list[int], list[float]]] = {}
        self._along: dict[tuple[int, int], float] = {}

    def distance_along(self, vehicle: Vehicle, lane: LaneIndex) -> float:
        """Distance of a vehicle along a lane, m, as of the last `locate`."""
        lines = self.network_info.lines
        if not self._along:  # of everybody on the present lane at once, which is asked most often
            lanes = [self._index[one.lane_index] for one in self._located]
            s = distances_along(self.located.xy, np.array(lanes, np.int64), lines)
            self._along = dict(zip(enumerate(lanes), s.tolist(), strict=True))
        row, k = self._row[id(vehicle)], self._index[lane]
        found = self._along.get((row, k))
        if found is None:
            xy = self.located.xy[row : row + 1]
            found = float(distances_along(xy, np.array([k]), lines)[0])
            self._along[row, k] = found
        return found

    def on_lane(self, lane: LaneIndex) -> tuple[list[float], list[int], list[float]]:
        """Those on a lane: distances along it, ascending, m, rows, and speeds along it, m/s.

        Rows are indices into ``vehicles``.
        """
        found = self._on_lane.get(lane)
        if found is None:
            k, on = self._index[lane], self.located.on
            here = slice(on.first[k], on.first[k + 1])
            found = on.s[here].tolist(), on.row[here].tolist(), on.along[here].tolist()
            self._on_lane[lane] = found
        return found

    def neighbours(self, vehicle: Vehicle, lane: LaneIndex) -> Neighbours:
        """The vehicles ahead of and behind a vehicle on a lane, ahead also along its way."""
        me = self._row[id(vehicle)]
        here = self.distance_along(vehicle, lane)
        found = Neighbours()
        distances, rows, speeds = self.on_lane(lane)
        at = bisect.bisect_left(distances, here)
        before = at - 1
        while before >= 0 and rows[before] == me:
            before -= 1
        if before >= 0:
            row = rows[before]
            found.rear = self._located[row]
            found.rear_gap = here - distances[before] - (self.lengths[me] + self.lengths[row]) / 2
            found.rear_speed = speeds[before]
        offset, now, visited = -here, lane, 0
        while True:
            while at < len(rows) and rows[at] == me:
                at += 1
            if at < len(rows):
                row = rows[at]
                gap = offset + distances[at] - (self.lengths[me] + self.lengths[row]) / 2
                if gap < LEADER_RANGE_M:
                    found.front, found.front_gap = self._located[row], float(gap)
                    found.front_speed = speeds[at]
                return found
            offset += self.network_info.lanes[now].length
            visited += 1
            then = self.onward_lane(vehicle, now)
            if then is None or offset > LEADER_RANGE_M or visited > 4:
                return found
            now = then
            distances, rows, speeds = self.on_lane(now)
            at = bisect.bisect_right(distances, max(-offset, -JOINED_M))

    def stood_s(self, vehicle: Vehicle) -> float:
        """For how long a vehicle has stood, s."""
        since = float(getattr(vehicle, "standing_since", math.inf))
        clock = float(getattr(vehicle, "clock", self.time_s))
        return 0.0 if since == math.inf else clock - since

    def update_standing(self) -> None:
        """Record since when vehicles without a profile have stood, such as an ego vehicle."""
        for vehicle in self.vehicles:
            if isinstance(vehicle, ProfileVehicle):
                continue
            if abs(vehicle.speed) > driving.STANDING_MPS:
                vehicle.standing_since = math.inf
            elif getattr(vehicle, "standing_since", math.inf) == math.inf:
                vehicle.standing_since = self.time_s


def agent_of(one: Vehicle | Walker) -> int:
    """An agent's id; -1 for one that has none, such as the ego vehicle of an environment."""
    return int(getattr(one, "agent", -1))


def outlines_of(everyone: Sequence[Any]) -> Outlines:
    """The outlines of highway-env's vehicles and objects, in its axes."""
    heading = np.array([one.heading for one in everyone])
    return Outlines(
        centre=np.array([one.position for one in everyone]),
        forward=np.stack([np.cos(heading), np.sin(heading)], axis=1),
        half=np.array([(one.LENGTH / 2, one.WIDTH / 2) for one in everyone]),
    )
