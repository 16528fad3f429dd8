"""The state of the highway engine: which vehicles and pedestrians are where on a scenario's road.

`RoadState` knows the network, the signals, every vehicle's place on every lane and its way ahead,
so that it finds leaders across junctions. The rules of the road (`sim.highway.rules`) read it, and
`sim.highway.traffic` moves everybody.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from sim.compiled import compiled
from sim.frames import Event, EventKind, Signal
from sim.highway import driving
from sim.highway.lanes import LaneIndex, corners
from sim.highway.network import HighwayNetwork, is_wrong_side
from sim.highway.vehicle import Neighbours, ProfileVehicle
from sim.highway.walkers import Walker

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STRETCH_MARGIN_M: Final = 1.0
"""A vehicle this far beyond a lane's edge is still on it (highway-env's)."""

PATH_MARGIN_M: Final = 0.5
"""The same on junction paths, which lie close together."""

BEHIND_M: Final = 40.0
"""A vehicle this far before the beginning of a lane, and in line with it, is on it already."""

JOINED_M: Final = 2.0
"""A vehicle this far before the beginning of the next lane, and in line with it, leads onto it,
whichever way it comes (our choice: half a car)."""

ALIGNED: Final = 0.5
"""A vehicle turned by more than 60 degrees from a lane crosses it and is not on it. On stretches,
unlike on junction paths, one that faces the other way is."""

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
    """Where everybody is on the road's K lanes, as of the last `RoadState.locate`; n vehicles.

    Attributes:
        xy: (n, 2) m.
        heading: (n,) rad.
        speed: (n,) m/s.
        s: (n, K) distance along every lane, m.
        lateral: (n, K) distance to the right of it, m.
        along: (n, K) speed along it, m/s.
        on: (n, K) whether it is on it.
    """

    xy: FloatArray
    heading: FloatArray
    speed: FloatArray
    s: FloatArray
    lateral: FloatArray
    along: FloatArray
    on: NDArray[np.bool_]


class _Pieces(NamedTuple):
    """The centre lines of K lanes in pieces, and who counts as on each lane.

    Attributes:
        start: (P, 2) m.
        direction: (P, 2).
        size: (P,) m.
        begin: (P,) distance along the lane, m.
        first: (K,) first piece of each lane.
        last: (K,) last piece of each lane.
        connector: (K,) whether it crosses a junction.
        margin: (K,) how far aside a vehicle is still on it, m.
        length: (K,) m.
        behind: (K,) how far before its beginning a vehicle is on it, m.
    """

    start: FloatArray
    direction: FloatArray
    size: FloatArray
    begin: FloatArray
    first: IntArray
    last: IntArray
    connector: NDArray[np.bool_]
    margin: FloatArray
    length: FloatArray
    behind: FloatArray


@compiled
def _locate(
    xy: FloatArray, heading: FloatArray, speed: FloatArray, length: FloatArray, pieces: _Pieces
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Each vehicle on each lane: distance along, to the right, speed along, and whether it is on.

    Args:
        xy: (n, 2) m.
        heading: (n,) rad.
        speed: (n,) m/s.
        length: (n,) m.
        pieces: of the lanes.
    """
    start, direction, size, begin = pieces.start, pieces.direction, pieces.size, pieces.begin
    n, lanes = len(xy), len(pieces.first)
    s, lateral, moving = np.empty((n, lanes)), np.empty((n, lanes)), np.empty((n, lanes))
    on = np.empty((n, lanes), dtype=np.bool_)
    for i in range(n):
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for k in range(lanes):
            best, facing = np.inf, 0.0
            first, last = pieces.first[k], pieces.last[k]
            for g in range(first, last + 1):
                dx, dy = xy[i, 0] - start[g, 0], xy[i, 1] - start[g, 1]
                along = dx * direction[g, 0] + dy * direction[g, 1]
                across = dy * direction[g, 0] - dx * direction[g, 1]
                clipped = along
                if along < 0.0 and g > first:
                    clipped = 0.0
                elif along > size[g] and g < last:
                    clipped = size[g]
                beyond = along - clipped
                if max(abs(across), abs(beyond)) >= best:
                    continue  # the distance is no less than either
                distance = math.hypot(across, beyond) if beyond != 0.0 else abs(across)
                if distance < best:
                    best = distance
                    s[i, k] = begin[g] + clipped
                    lateral[i, k] = distance if across >= 0.0 else -distance
                    facing = cos * direction[g, 0] + sin * direction[g, 1]
            moving[i, k] = speed[i] * facing
            aligned = facing if pieces.connector[k] else abs(facing)
            on[i, k] = (
                best <= pieces.margin[k]
                and aligned > ALIGNED
                and s[i, k] >= -pieces.behind[k]
                and s[i, k] <= pieces.length[k] + length[i] / 2
            )
    return s, lateral, moving, on


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
        self.update_signals()
        self.signal_since[:] = -math.inf
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
        self._located: list[Vehicle] = []

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
        connector = np.array([self.network_info.info[i].connector for i in self._index])
        width = np.array([lane.width for lane in lanes])
        self._pieces = _Pieces(
            start=np.array(start),
            direction=np.array(direction),
            size=np.array(size),
            begin=np.array(begin),
            first=np.array(first),
            last=np.array(last),
            connector=connector,
            margin=width / 2 + np.where(connector, PATH_MARGIN_M, STRETCH_MARGIN_M),
            length=np.array([lane.length for lane in lanes]),
            behind=np.where(connector, 0.0, BEHIND_M),
        )

    def _strips(self) -> list[list[tuple[float, float]]]:
        """For each crossing, where lanes run over it: middle and half width, m along it."""
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

    # Signals and events ----------------------------------------------------------------------

    def update_signals(self) -> None:
        """Show what the signal plans say for the present time."""
        for plan in self.network_info.road.signal_plans:
            for group, state in zip(plan.groups, plan.state_at(self.time_s), strict=True):
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

    def lanes_allowed(self, vehicle: Vehicle) -> list[LaneIndex]:
        """The lanes beside the present one from which a vehicle's way goes on."""
        lane = vehicle.lane_index
        if self.network_info.info[lane].connector or is_wrong_side(lane):
            return []
        towards = self.network_info.lanes_towards(lane[:2], self.next_stretch(vehicle, lane[:2]))
        return [one for one in towards if abs(one[2] - lane[2]) == 1]

    # Places ----------------------------------------------------------------------------------

    def locate(self) -> None:
        """Find everybody's place on every lane; valid until somebody moves."""
        self._located = list(self.vehicles)
        self._row = {id(vehicle): i for i, vehicle in enumerate(self._located)}
        n = len(self._located)
        xy = np.array([v.position for v in self._located], dtype=np.float64).reshape(n, 2)
        heading = np.array([v.heading for v in self._located], dtype=np.float64)
        self.lengths = np.array([v.LENGTH for v in self._located], dtype=np.float64)
        speed = np.array([v.speed for v in self._located], dtype=np.float64)
        s, lateral, along, on = _locate(xy, heading, speed, self.lengths, self._pieces)
        self.located = Located(xy, heading, speed, s, lateral, along, on)
        self._sorted: dict[LaneIndex, tuple[list[float], list[int]]] = {}

    def place(self, vehicle: Vehicle, lane: LaneIndex) -> tuple[float, float]:
        """Distance along a lane and to the right of it, m, as of the last `locate`."""
        row, k = self._row[id(vehicle)], self._index[lane]
        return float(self.located.s[row, k]), float(self.located.lateral[row, k])

    def on_lane(self, lane: LaneIndex) -> tuple[list[float], list[int]]:
        """Distances along a lane, ascending, m, and indices into ``vehicles`` of those on it."""
        found = self._sorted.get(lane)
        if found is None:
            k = self._index[lane]
            rows = np.flatnonzero(self.located.on[:, k])
            rows = rows[np.argsort(self.located.s[rows, k], kind="stable")]
            found = self._sorted[lane] = (self.located.s[rows, k].tolist(), rows.tolist())
        return found

    def neighbours(self, vehicle: Vehicle, lane: LaneIndex) -> Neighbours:
        """The vehicles ahead of and behind a vehicle on a lane, ahead also along its way."""
        me = self._row[id(vehicle)]
        k = self._index[lane]
        here = float(self.located.s[me, k])
        found = Neighbours()
        distances, rows = self.on_lane(lane)
        at = bisect.bisect_left(distances, here)
        before = at - 1
        while before >= 0 and rows[before] == me:
            before -= 1
        if before >= 0:
            row = rows[before]
            found.rear = self._located[row]
            found.rear_gap = here - distances[before] - (self.lengths[me] + self.lengths[row]) / 2
            found.rear_speed = float(self.located.along[row, k])
        offset, now, visited = -here, lane, 0
        while True:
            while at < len(rows) and rows[at] == me:
                at += 1
            if at < len(rows):
                row = rows[at]
                gap = offset + distances[at] - (self.lengths[me] + self.lengths[row]) / 2
                if gap < LEADER_RANGE_M:
                    found.front, found.front_gap = self._located[row], float(gap)
                    found.front_speed = float(self.located.along[row, self._index[now]])
                return found
            offset += self.network_info.lanes[now].length
            visited += 1
            then = self.onward_lane(vehicle, now)
            if then is None or offset > LEADER_RANGE_M or visited > 4:
                return found
            now = then
            distances, rows = self.on_lane(now)
            at = bisect.bisect_right(distances, max(-offset, -JOINED_M))

    def stood_s(self, vehicle: Vehicle) -> float:
        """For how long a vehicle has stood, s."""
        since = float(getattr(vehicle, "standing_since", math.inf))
        clock = float(getattr(vehicle, "clock", self.time_s))
        return 0.0 if since == math.inf else clock - since

    def update_standing(self) -> None:
        """Record since when vehicles without a profile, such as an ego vehicle, have stood."""
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
