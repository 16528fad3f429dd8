"""The road of the highway engine: vehicles, pedestrians and signals of one scenario.

A `FastRoad` on the network of a `Road`. It knows which way everybody wants to go, so that leaders
are found onward over junctions; runs the signals; hands every driver what the rules of the road
demand; moves the pedestrians; notes collisions and clears what has crashed.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from highway_env.vehicle.kinematics import Vehicle
from numba import njit
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.frames import Event, EventKind, Signal
from sim.geometry import separation
from sim.highway import driving
from sim.highway.causes import cause_of
from sim.highway.fast_road import FastRoad, outlines_of
from sim.highway.lanes import corners
from sim.highway.network import HighwayNetwork, LaneIndex
from sim.highway.rules import give_orders
from sim.highway.vehicle import Neighbours, ProfileVehicle
from sim.highway.walkers import Walker
from sim.highway.wrong_way import note_wrong_way, wrong_way_lane

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CLEAR_AFTER_S: Final = 8.0
"""Crashed vehicles and struck pedestrians are taken off the road after this long (our choice: so
that traffic behind sees them and queues, and pile-ups clear)."""

STRETCH_MARGIN_M: Final = 1.0
"""Beyond a lane's edge one still is on it (highway-env's)."""

PATH_MARGIN_M: Final = 0.5
"""The same inside junctions, where paths lie close together (our choice)."""

BEHIND_M: Final = 40.0
"""Who comes straight towards the beginning of a lane from this near counts as behind (our
choice)."""

JOINED_M: Final = 2.0
"""Who comes straight towards the beginning of the next lane from this near leads onto it, whatever
way it takes there (our choice: half a car)."""

ALIGNED: Final = 0.5
"""Vehicles turned more than 60 degrees from a lane are crossing it, not on it; those who face the
other way are on it too, other than inside junctions."""

SIGHT_M: Final = 200.0
"""Leaders farther ahead are not looked for (our choice)."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A vehicle coming to a strip of a crossing.

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


@njit(cache=True, error_model="numpy")
def _locate(
    xy: FloatArray,
    heading: FloatArray,
    start: FloatArray,
    direction: FloatArray,
    size: FloatArray,
    begin: FloatArray,
    first: IntArray,
    last: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Each vehicle on each lane: distance along, distance to the right, cosine of the heading."""
    n, lanes = len(xy), len(first)
    s, lateral, facing = np.empty((n, lanes)), np.empty((n, lanes)), np.empty((n, lanes))
    for i in range(n):
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for k in range(lanes):
            best = np.inf
            for g in range(first[k], last[k] + 1):
                dx, dy = xy[i, 0] - start[g, 0], xy[i, 1] - start[g, 1]
                along = dx * direction[g, 0] + dy * direction[g, 1]
                across = dy * direction[g, 0] - dx * direction[g, 1]
                clipped = along
                if along < 0.0 and g > first[k]:
                    clipped = 0.0
                elif along > size[g] and g < last[k]:
                    clipped = size[g]
                distance = math.hypot(across, along - clipped)
                if distance < best:
                    best = distance
                    s[i, k] = begin[g] + clipped
                    lateral[i, k] = distance if across >= 0.0 else -distance
                    facing[i, k] = cos * direction[g, 0] + sin * direction[g, 1]
    return s, lateral, facing


class TrafficRoad(FastRoad):
    """The road with everybody on it.

    Args:
        network: the road in highway-env's terms.
        compiled: decide and move all drivers at once in compiled code; only on a single straight
            stretch (see `sim.highway.straight`). The result is the same within rounding.

    Raises:
        InputError: if ``compiled`` is asked for on a road with junctions or bends.
    """

    vehicles: list[Vehicle]

    def __init__(self, network: HighwayNetwork, *, compiled: bool = False) -> None:
        super().__init__(network.net, np_random=np.random.RandomState(0))
        self.network_info = network
        self.time_s = 0.0
        self.events: list[Event] = []
        self.walkers: list[Walker] = []
        self.arrivals: dict[tuple[int, int], list[Arrival]] = {}
        plans = network.road.signal_plans
        self.signals = np.full(len(network.road.signal_groups), Signal.OFF.code, dtype=np.int8)
        self.signal_since = np.zeros(self.signals.size)
        self._plans = plans
        self._show_signals()
        self.signal_since[:] = -math.inf
        self._touching: set[tuple[int, int]] = set()
        self._index = {lane: k for k, lane in enumerate(network.lanes)}
        self._prepare_lanes()
        self.strips_of = self._strips()
        self.strip_number: dict[tuple[LaneIndex, int], int] = {}
        for lane, info in network.info.items():
            for strip in info.strips:
                for number, (u, _) in enumerate(self.strips_of[strip.crossing]):
                    if abs(u - strip.u) < 0.5:
                        self.strip_number[lane, strip.crossing] = number
                        break
        self._seen: list[Vehicle] = []
        self._straight: Any = None
        if compiled:
            from sim.highway.straight import StraightTraffic

            self._straight = StraightTraffic(self)

    def _prepare_lanes(self) -> None:
        lanes = list(self.network_info.lanes.values())
        start: list[list[float]] = []
        direction: list[list[float]] = []
        size: list[float] = []
        begin: list[float] = []
        first: list[int] = []
        last: list[int] = []
        for line in corners(lanes):
            step = np.diff(line, axis=0)
            length = np.hypot(step[:, 0], step[:, 1])
            first.append(len(size))
            start += line[:-1].tolist()
            direction += (step / length[:, None]).tolist()
            begin += (np.cumsum(length) - length).tolist()
            size += length.tolist()
            last.append(len(size) - 1)
        self._pieces = (
            np.array(start),
            np.array(direction),
            np.array(size),
            np.array(begin),
            np.array(first),
            np.array(last),
        )
        connector = np.array([self.network_info.info[i].connector for i in self._index])
        self._connector = connector
        width = np.array([lane.width for lane in lanes])
        self._margin = width / 2 + np.where(connector, PATH_MARGIN_M, STRETCH_MARGIN_M)
        self._lengths = np.array([lane.length for lane in lanes])
        self._behind = np.where(connector, 0.0, BEHIND_M)

    def _strips(self) -> list[list[tuple[float, float]]]:
        """For each crossing, where the lanes run over it: middle and half width, m along it."""
        found: list[list[tuple[float, float]]] = []
        for crossing in range(len(self.network_info.road.crossings)):
            places: list[tuple[float, float]] = []
            for lane, info in self.network_info.info.items():
                for strip in info.strips:
                    if strip.crossing == crossing and all(
                        abs(u - strip.u) >= 0.5 for u, _ in places
                    ):
                        places.append((strip.u, self.network_info.lanes[lane].width / 2))
            found.append(sorted(places))
        return found

    # Signals ---------------------------------------------------------------------------------

    def _show_signals(self) -> None:
        for plan in self._plans:
            for group, state in zip(plan.groups, plan.state_at(self.time_s), strict=True):
                if self.signals[group] != state:
                    self.signals[group] = state
                    self.signal_since[group] = self.time_s

    # Ways ------------------------------------------------------------------------------------

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

    def lanes_allowed(self, vehicle: Vehicle) -> list[LaneIndex]:
        """The lanes beside the present one from which a vehicle's way goes on."""
        lane = vehicle.lane_index
        if self.network_info.info[lane].connector or lane[0].startswith("~"):
            return []
        towards = self.network_info.lanes_towards(lane[:2], self.next_stretch(vehicle, lane[:2]))
        return [one for one in towards if abs(one[2] - lane[2]) == 1]

    def wrong_way_lane(self, vehicle: ProfileVehicle, here: Neighbours) -> LaneIndex | None:
        """See `sim.highway.wrong_way.wrong_way_lane`."""
        return wrong_way_lane(self, vehicle, here)

    # Who is where ----------------------------------------------------------------------------

    def look(self) -> None:
        """Note where everybody is on every lane; valid until somebody moves."""
        self._seen = list(self.vehicles)
        self._row = {id(vehicle): i for i, vehicle in enumerate(self._seen)}
        n = len(self._seen)
        xy = np.array([v.position for v in self._seen], dtype=np.float64).reshape(n, 2)
        heading = np.array([v.heading for v in self._seen], dtype=np.float64)
        self._length = np.array([v.LENGTH for v in self._seen], dtype=np.float64)
        speed = np.array([v.speed for v in self._seen], dtype=np.float64)
        self._s, self._lateral, facing = _locate(xy, heading, *self._pieces)
        self._along = speed[:, None] * facing
        on = np.abs(self._lateral) <= self._margin[None]
        on &= np.where(self._connector[None], facing, np.abs(facing)) > ALIGNED
        on &= self._s >= -self._behind[None]
        on &= self._s <= self._lengths[None] + self._length[:, None] / 2
        self._on = on
        self._sorted: dict[LaneIndex, tuple[list[float], list[int]]] = {}

    def place(self, vehicle: Vehicle, lane: LaneIndex) -> tuple[float, float]:
        """Distance along a lane and to the right of it, m, as of the last `look`."""
        row, k = self._row[id(vehicle)], self._index[lane]
        return float(self._s[row, k]), float(self._lateral[row, k])

    def on_lane(self, lane: LaneIndex) -> tuple[list[float], list[int]]:
        """Distances along a lane, ascending, and rows of those on it."""
        found = self._sorted.get(lane)
        if found is None:
            k = self._index[lane]
            rows = np.flatnonzero(self._on[:, k])
            rows = rows[np.argsort(self._s[rows, k], kind="stable")]
            found = self._sorted[lane] = (self._s[rows, k].tolist(), rows.tolist())
        return found

    def sorted_rows(self, lanes: list[LaneIndex]) -> tuple[IntArray, IntArray]:
        """Rows of those on each lane, by distance along it, and how many there are."""
        order = np.full((len(lanes), max(len(self._seen), 1)), -1, dtype=np.int64)
        count = np.zeros(len(lanes), dtype=np.int64)
        for k, lane in enumerate(lanes):
            _, rows = self.on_lane(lane)
            order[k, : len(rows)], count[k] = rows, len(rows)
        return order, count

    def lane_table(
        self, lanes: list[LaneIndex]
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Everybody on every given lane, as of the last `look`.

        Returns:
            (n, k) distance along, (n, k) distance to the right, (n, k) speed along, (n,) length.
        """
        columns = [self._index[lane] for lane in lanes]
        return (
            self._s[:, columns],
            self._lateral[:, columns],
            self._along[:, columns],
            self._length,
        )

    def around(self, vehicle: Vehicle, lane: LaneIndex) -> Neighbours:
        """Who is ahead of and behind a vehicle on a lane, onward along its way."""
        me = self._row[id(vehicle)]
        k = self._index[lane]
        here = float(self._s[me, k])
        seen = Neighbours()
        distances, rows = self.on_lane(lane)
        at = bisect.bisect_left(distances, here)
        before = at - 1
        while before >= 0 and rows[before] == me:
            before -= 1
        if before >= 0:
            row = rows[before]
            seen.rear = self._seen[row]
            seen.rear_gap = here - distances[before] - (self._length[me] + self._length[row]) / 2
            seen.rear_speed = float(self._along[row, k])
        offset, now, visited = -here, lane, 0
        while True:
            while at < len(rows) and rows[at] == me:
                at += 1
            if at < len(rows):
                row = rows[at]
                gap = offset + distances[at] - (self._length[me] + self._length[row]) / 2
                if gap < SIGHT_M:
                    seen.front, seen.front_gap = self._seen[row], float(gap)
                    seen.front_speed = float(self._along[row, self._index[now]])
                return seen
            offset += self.network_info.lanes[now].length
            visited += 1
            then = self.onward_lane(vehicle, now)
            if then is None or offset > SIGHT_M or visited > 4:
                return seen
            now = then
            distances, rows = self.on_lane(now)
            at = bisect.bisect_right(distances, max(-offset, -JOINED_M))

    # Time ------------------------------------------------------------------------------------

    def act(self) -> None:
        """Let everybody decide."""
        self.look()
        give_orders(self)
        if self._straight is not None:
            self._straight.act()
            return
        for vehicle in self.vehicles:
            vehicle.act()

    def step(self, dt: float) -> None:
        """Move everybody for ``dt`` seconds, at most 0.1 s, and note what happened."""
        if self._straight is not None:
            self._straight.step(dt)
        else:
            for vehicle in self.vehicles:
                vehicle.step(dt)
        self.time_s += dt
        for walker in self.walkers:
            walker.step(dt, self)
        self._note_standing()
        self._show_signals()
        self._collide()
        self._clear()

    def _note_standing(self) -> None:
        for vehicle in self.vehicles:
            if isinstance(vehicle, ProfileVehicle):
                continue
            if abs(vehicle.speed) > driving.STANDING_MPS:
                vehicle.standing_since = math.inf
            elif getattr(vehicle, "standing_since", math.inf) == math.inf:
                vehicle.standing_since = self.time_s

    def stood_s(self, vehicle: Vehicle) -> float:
        """For how long a vehicle has stood, s."""
        since = float(getattr(vehicle, "standing_since", math.inf))
        clock = float(getattr(vehicle, "clock", self.time_s))
        return 0.0 if since == math.inf else clock - since

    def add_event(
        self, kind: EventKind, agent: int, other: int | None = None, rule: str = ""
    ) -> None:
        """Note an event now."""
        self.events.append(Event(kind, self.time_s, agent, other, rule))

    def take_events(self) -> tuple[Event, ...]:
        """The events since the last call."""
        taken, self.events = tuple(self.events), []
        return taken

    def _collide(self) -> None:
        everyone = [*self.vehicles, *self.walkers]
        n = len(self.vehicles)
        if n == 0:
            return
        xy = np.array([one.position for one in everyone])
        radius = np.array([one.diagonal for one in everyone]) / 2
        across = xy[:n, None] - xy[None]
        near = across[..., 0] ** 2 + across[..., 1] ** 2 <= (radius[:n, None] + radius[None]) ** 2
        near &= np.arange(n)[:, None] < np.arange(len(everyone))[None]
        one, other = np.nonzero(near)
        touching: set[tuple[int, int]] = set()
        if one.size:
            outlines = outlines_of(everyone)
            hit = separation(outlines.rows(one), outlines.rows(other)) < 0.0
            for i, j in zip(one[hit].tolist(), other[hit].tolist(), strict=True):
                a, b = everyone[i], everyone[j]
                key = (id(a), id(b))
                touching.add(key)
                if key not in self._touching:
                    self._crash(a, b)
        self._touching = touching

    def _crash(self, a: Vehicle, b: Vehicle | Walker) -> None:
        cause, victim, rule = cause_of(self, a, b)
        for one in (a, b):
            one.crashed = True
            if isinstance(one, Walker):
                one.hit = True
                one.struck_at = min(one.struck_at, self.time_s)
            else:
                one.crashed_at = min(getattr(one, "crashed_at", math.inf), self.time_s)
        self.add_event(EventKind.COLLISION, agent_of(cause), agent_of(victim), rule)

    def _clear(self) -> None:
        """Take away who has arrived, and what crashed long ago."""
        stuck = note_wrong_way(self) if self.network_info.ghost else []
        staying = []
        for vehicle in self.vehicles:
            if not isinstance(vehicle, ProfileVehicle):
                staying.append(vehicle)
            elif vehicle in stuck:
                self.add_event(EventKind.REMOVAL, vehicle.agent, rule="stuck on the wrong side")
            elif self.time_s - vehicle.crashed_at > CLEAR_AFTER_S:
                self.add_event(EventKind.REMOVAL, vehicle.agent, rule="crashed")
            elif not self._arrived(vehicle):
                staying.append(vehicle)
        self.vehicles = staying
        walking = []
        for walker in self.walkers:
            if self.time_s - walker.struck_at > CLEAR_AFTER_S:
                self.add_event(EventKind.REMOVAL, walker.agent, rule="struck")
            elif not walker.arrived:
                walking.append(walker)
        self.walkers = walking
        self.objects = list(walking)

    def _arrived(self, vehicle: ProfileVehicle) -> bool:
        lane = vehicle.lane_index
        if self.network_info.info[lane].connector:
            return False
        s = vehicle.lane.local_coordinates(vehicle.position)[0]
        if s + vehicle.LENGTH / 2 < vehicle.lane.length:
            return False
        return self.next_stretch(vehicle, lane[:2]) is None


def agent_of(one: Vehicle | Walker) -> int:
    """An agent's id; -1 for one that has none, such as the ego vehicle of an environment."""
    return int(getattr(one, "agent", -1))


def check_single_stretch(network: HighwayNetwork) -> tuple[str, str]:
    """The only stretch of a straight road.

    Raises:
        InputError: if there are several, or it bends.
    """
    from highway_env.road.lane import StraightLane

    stretches = set(network.stretch_of.values())
    straight = all(type(lane) is StraightLane for lane in network.lanes.values())
    if len(stretches) != 1 or not straight:
        raise InputError(
            f"compiled: found road {network.road.name!r} with junctions or bends, "
            "expected one straight stretch"
        )
    return next(iter(stretches))
