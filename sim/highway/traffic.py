"""The road of the highway engine: everybody on it, and one step of all of them.

The truth is in the arrays of a `Scene`, which compiled functions read and write. The objects in
``vehicles`` and ``walkers`` are views of its rows; vehicles of other classes, such as an ego
vehicle, are objects of highway-env and are read into their rows before each step.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from sim.frames import Event, EventKind, Frame, Signal
from sim.geometry import Outlines
from sim.highway.blame import are_on_two_levels, find_cause
from sim.highway.decide import act, decide
from sim.highway.driving import DEFAULT_PARAMETERS
from sim.highway.junctions import EVENT_KINDS
from sim.highway.lanes import LaneIndex
from sim.highway.motion import ARRIVED, STAYS, STUCK, leave, move
from sim.highway.network import HighwayNetwork
from sim.highway.reroute import find_way
from sim.highway.scene import (
    ARRIVAL,
    EVENT,
    NOW,
    ON,
    PAIR,
    Scene,
    beside,
    distance_on,
    locate,
    path_of,
    read_motion,
    room_at_entry,
)
from sim.highway.tables import LaneTables, Records
from sim.highway.vehicle import VEHICLE, ProfileVehicle, blank_row
from sim.highway.walkers import WALKER, Footway, Walker, footways_of

FloatArray = NDArray[np.float64]
Stretch = tuple[str, str]

PHASE_ROUNDING_S: Final = 1e-6
"""Signal plans are looked at again this long before a phase ends, s, because times are rounded."""

VIEWS: Final = (ProfileVehicle, Walker)
"""The classes of objects that show rows."""

LEAST_ROOM: Final = 16
"""Arrays have room for this many agents at first."""


class Neighbours(NamedTuple):
    """The vehicles ahead and behind on a lane; gaps are bumper to bumper, infinite without one.

    Attributes:
        front: the vehicle ahead.
        front_gap: m.
        front_speed: along the lane, m/s.
        rear: the vehicle behind.
        rear_gap: m.
        rear_speed: m/s.
    """

    front: Any
    front_gap: float
    front_speed: float
    rear: Any
    rear_gap: float
    rear_speed: float


class TrafficRoad(Road):  # type: ignore[misc]
    """The road with everybody on it, step by step.

    ``vehicles`` and ``walkers`` are lists to which agents may be added and from which they may be
    removed between two steps.

    Args:
        network: the road in highway-env's terms.
    """

    vehicles: list[Any]

    def __init__(self, network: HighwayNetwork) -> None:
        super().__init__(network.net, np_random=np.random.RandomState(0))
        self.network_info = network
        self.tables: LaneTables = network.tables
        self.events: list[Event] = []
        self.walkers: list[Walker] = []
        self.signals = np.full(len(network.road.signal_groups), Signal.OFF.code, dtype=np.int8)
        self.signal_since = np.zeros(self.signals.size)
        self._now = np.zeros(1, NOW)
        self._plan_due_s = np.zeros(len(network.road.signal_plans))
        self._routes: dict[tuple[Stretch, ...], int] = {}
        self._footways: list[Footway] = []
        self._rows: Records = np.zeros(0, VEHICLE)
        self._people: Records = np.zeros(0, WALKER)
        self._known: list[Any] = []
        self._known_walkers: list[Walker] = []
        self._others: list[tuple[int, Vehicle]] = []
        self._touching: set[tuple[int, int]] = set()
        self._route_rows = np.zeros((0, 1), np.int64)
        self._scene: Scene | None = None
        self._work: Scene | None = None
        self.update_signals()
        self.signal_since[:] = -math.inf

    @property
    def time_s(self) -> float:
        """The time now, s."""
        return float(self._now["time_s"][0])

    @time_s.setter
    def time_s(self, time_s: float) -> None:
        self._now["time_s"] = time_s

    def copied(self) -> TrafficRoad:
        """A copy of the traffic on the same lanes; neither road changes with the other."""
        network = self.network_info
        fixed: list[object] = [network, network.net, self.tables, *network.lanes.values()]
        fixed += [v.driver for v in self.vehicles if isinstance(v, ProfileVehicle)]
        fixed += self._footways
        self.scene()
        self._scene = self._work = None
        return copy.deepcopy(self, {id(one): one for one in fixed})

    # The arrays ------------------------------------------------------------------------------

    def route_number(self, stretches: tuple[Stretch, ...]) -> int:
        """The number of a route, the same for equal ones."""
        if stretches not in self._routes:
            self._routes[stretches] = len(self._routes)
            self._route_rows = np.zeros((0, 1), np.int64)
            if self._scene is not None:
                self._scene = self._scene._replace(routes=self._route_table())
        return self._routes[stretches]

    def scene(self) -> Scene:
        """Everybody on the road as arrays, with rows in the order of ``vehicles``."""
        if self._known != self.vehicles:
            self._rows = self._gather(self._rows, self._known, self.vehicles)
            self._known, self._scene = list(self.vehicles), None
            self._others = [
                (i, v) for i, v in enumerate(self.vehicles) if not isinstance(v, ProfileVehicle)
            ]
        if self._known_walkers != self.walkers:
            self._people = self._gather(self._people, self._known_walkers, self.walkers)
            self._known_walkers, self._scene = list(self.walkers), None
        if self._scene is None:
            self._scene = self._new_scene()
        for row, vehicle in self._others:
            self._read(row, vehicle)
        return self._scene

    def _gather(self, rows: Records, before: list[Any], now: list[Any]) -> Records:
        """The rows of those who are there now; who has left keeps its own."""
        at = {id(one): i for i, one in enumerate(before)}
        order = [at.pop(id(one), -1) for one in now]
        for old in at.values():
            if isinstance(before[old], VIEWS):
                before[old].table, before[old].row = rows[old : old + 1].copy(), 0
        room = rows.size if len(now) <= rows.size else 2 * len(now) + LEAST_ROOM
        made = np.zeros(room, rows.dtype)
        made[: len(now)] = rows[order] if rows.size else 0
        for i, (one, old) in enumerate(zip(now, order, strict=True)):
            if old < 0:
                made[i] = self._first_row(one)
            if isinstance(one, VIEWS):
                one.table, one.row = made, i
        return made

    def _first_row(self, one: Any) -> Any:
        """The row of somebody who has come onto the road."""
        if isinstance(one, Walker):
            one.table["way"] = self._footway_number(one.footway)
        if isinstance(one, VIEWS):
            return one.table[one.row]
        row, kind = blank_row(), getattr(one, "kind", None)
        row["parameters"], row["agent"] = DEFAULT_PARAMETERS, agent_of(one)
        row["kind"] = 0 if kind is None else kind.code
        return row[0]

    def _footway_number(self, footway: Footway) -> int:
        for number, known in enumerate(self._footways):
            if known is footway:
                return number
        self._footways.append(footway)
        self._work = None
        return len(self._footways) - 1

    def _read(self, i: int, vehicle: Vehicle) -> None:
        """Read a vehicle that is no view of its row into it."""
        row, number = self._rows[i], self.tables.number
        row.x, row.y = vehicle.position
        row.heading, row.speed, row.crashed = vehicle.heading, vehicle.speed, vehicle.crashed
        row.length, row.width = vehicle.LENGTH, vehicle.WIDTH
        row.lane = number[vehicle.lane_index]
        row.target = number[getattr(vehicle, "target_lane_index", None) or vehicle.lane_index]
        row.route = self.route_number(getattr(vehicle, "stretches", ()))

    def _new_scene(self) -> Scene:
        """The arrays of those who are there now."""
        n, m = len(self.vehicles), len(self.walkers)
        rows, people = self._rows[:n], self._people[:m]
        for vehicle in self.vehicles:
            self.route_number(getattr(vehicle, "stretches", ()))
        ids = np.concatenate([rows["agent"], people["agent"]])
        kind = np.concatenate([rows["kind"], np.full(m, Walker.kind.code)])
        size = np.concatenate([rows[["length", "width"]], people[["length", "width"]]])
        self._order = np.argsort(ids, kind="stable")
        self._lasting = {
            "ids": ids[self._order],
            "length": size["length"][self._order],
            "width": size["width"][self._order],
            "kind": kind[self._order].astype(np.int8),
        }
        if self._work is None or self._work.cell_link.size < n + m:
            self._work = self._new_work()
        return self._work._replace(vehicles=rows, walkers=people, routes=self._route_table())

    def _new_work(self) -> Scene:
        """Arrays with room for twice as many as are there now."""
        net, n, m = self.tables.net, 2 * len(self.vehicles) + 8, 2 * len(self.walkers) + 8
        entries = 2 * max(4 * n, int(self._now["entries"][0]))
        strips = net.lanes["strip_end"] - net.lanes["strip"]
        return Scene(
            net=net,
            routes=self._route_table(),
            footways=footways_of(self._footways),
            signals=self.signals,
            signal_since=self.signal_since,
            vehicles=self._rows,
            walkers=self._people,
            now=self._now,
            on_first=np.zeros(net.lanes.size + 1, np.int64),
            on=np.zeros(entries, ON),
            unsorted=np.zeros(entries, ON),
            unsorted_lane=np.zeros(entries, np.int64),
            lane_head=np.full(net.lanes.size, -1),
            lane_link=np.full(2 * (n + m), -1),
            spot_head=np.full(net.spots.size, -1),
            crossing_head=np.full(net.crossings.size, -1),
            cell_head=np.full(net.cells.columns * net.cells.rows, -1),
            cell_link=np.full(n + m, -1),
            arrivals=np.zeros(2 * (n + m) * int(strips.max(initial=0)), ARRIVAL),
            pairs=np.zeros(4 * (n + m) + 16, PAIR),
            events=np.zeros(8 * (n + m), EVENT),
        )

    def _route_table(self) -> NDArray[np.int64]:
        """The numbers of the stretches on each route, -1 after the last."""
        if len(self._route_rows) <= len(self._routes):
            longest = max((len(route) for route in self._routes), default=0)
            made = np.full((2 * len(self._routes) + 1, longest + 1), -1, dtype=np.int64)
            for route, number in self._routes.items():
                made[number, : len(route)] = [self.tables.stretch(one) for one in route]
            self._route_rows = made
        return self._route_rows

    def row_of(self, vehicle: Any) -> int:
        """The row of a vehicle on the road."""
        if isinstance(vehicle, ProfileVehicle):
            return int(vehicle.row)
        return next(row for row, other in self._others if other is vehicle)

    def frame(self, events: tuple[Event, ...]) -> Frame:
        """Everybody on the road now, in the axes of a `Frame`, whose y is to the left."""
        scene, n = self.scene(), len(self._order)
        xy, heading, speed = np.empty((n, 2)), np.empty(n), np.empty(n)
        read_motion(self._order, scene, xy, heading, speed)
        return Frame(
            time_s=self.time_s, xy=xy, heading=heading, speed=speed, signals=self.signals.copy(),
            events=events, **self._lasting,
        )  # fmt: skip

    # Signals and events ----------------------------------------------------------------------

    def update_signals(self) -> None:
        """Show what the signal plans say for the present time."""
        plans, now_s = self.network_info.road.signal_plans, self.time_s
        for number in np.flatnonzero(self._plan_due_s <= now_s).tolist():
            plan = plans[number]
            states, lasts_s = plan.phase_at(now_s)
            self._plan_due_s[number] = now_s + lasts_s - PHASE_ROUNDING_S
            for group, state in zip(plan.groups, states, strict=True):
                if self.signals[group] != state:
                    self.signals[group] = state
                    self.signal_since[group] = now_s

    def _add_event(
        self, kind: EventKind, agent: int, other: int | None = None, rule: str = ""
    ) -> None:
        self.events.append(Event(kind, self.time_s, agent, other, rule))

    def _read_events(self, scene: Scene) -> None:
        """Keep the events that kernels recorded."""
        many = int(self._now["events"][0])
        if many:
            for kind, agent in scene.events[:many].tolist():
                self._add_event(EVENT_KINDS[kind], agent)
            self._now["events"] = 0

    def take_events(self) -> tuple[Event, ...]:
        """The events since the last call."""
        taken, self.events = tuple(self.events), []
        return taken

    # Places ----------------------------------------------------------------------------------

    def next_stretch(self, vehicle: Vehicle, stretch: Stretch) -> Stretch | None:
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

    def locate(self) -> None:
        """Find who is on which lane; valid until somebody moves."""
        while not locate(self.scene()):
            self._scene = self._work = None  # once more, with room for all entries

    def distance_along(self, vehicle: Vehicle, lane: LaneIndex) -> float:
        """Distance of a vehicle along a lane, m."""
        scene = self.scene()
        return float(distance_on(self.row_of(vehicle), self.tables.number[lane], scene))

    def on_lane(self, lane: LaneIndex) -> tuple[list[float], list[int], list[float]]:
        """Those on a lane: distances along it, ascending, m, rows, and speeds along it, m/s.

        Rows are indices into ``vehicles``, as of the last `locate`.
        """
        scene, k = self.scene(), self.tables.number[lane]
        here = scene.on[scene.on_first[k] : scene.on_first[k + 1]]
        return here["s"].tolist(), here["row"].tolist(), here["along"].tolist()

    def neighbours(self, vehicle: Vehicle, lane: LaneIndex) -> Neighbours:
        """The vehicles ahead of and behind a vehicle on a lane, ahead also along its way."""
        found = beside(self.row_of(vehicle), self.tables.number[lane], self.scene())
        front, front_gap, front_speed, rear, rear_gap, rear_speed = found
        return Neighbours(
            self.vehicles[front] if front >= 0 else None, front_gap, front_speed,
            self.vehicles[rear] if rear >= 0 else None, rear_gap, rear_speed,
        )  # fmt: skip

    def room_at_entry(self, lane: LaneIndex, length: float) -> tuple[float, float]:
        """Bumper gap to the first vehicle on a lane or changing to it, m, and its speed, m/s."""
        gap, speed = room_at_entry(self.tables.number[lane], length, self.scene())
        return float(gap), float(speed)

    # A step ----------------------------------------------------------------------------------

    def act(self) -> None:
        """Let everybody decide."""
        self.locate()
        scene = self.scene()
        astray = act(scene)
        self._read_events(scene)
        if astray:
            for row in np.flatnonzero(scene.vehicles["astray"]).tolist():
                driver = self.vehicles[row]
                route = find_way(self.network_info, driver.lane_index, driver.stretches[-1])
                if route is not None:
                    driver.stretches = (driver.lane_index[:2], *route)
            decide(self.scene())
        for _, vehicle in self._others:
            vehicle.act()

    def step(self, dt: float) -> None:
        """Move everybody for ``dt`` seconds, at most 0.1 s, and record what happened."""
        for _, vehicle in self._others:
            vehicle.step(dt)
        scene = self.scene()
        somebody_may_go = move(dt, scene)
        self.update_signals()
        self._collide(scene)
        if somebody_may_go and leave(scene):
            self._read_events(scene)
            self._clear(scene)
        else:
            self._read_events(scene)

    def _collide(self, scene: Scene) -> None:
        """Record collisions of those that touch and did not touch before."""
        many = int(self._now["pairs"][0])
        if not many:
            self._touching.clear()
            return
        touching, n = set(), len(self.vehicles)
        for i, j in scene.pairs[:many].tolist():
            one, walker = scene.vehicles[i], j >= n
            other = scene.walkers[j - n] if walker else scene.vehicles[j]
            if not walker and are_on_two_levels(self.network_info, self.tables.keys, one, other):
                continue
            pair = (int(one.agent), int(other.agent))
            touching.add(pair)
            if pair in self._touching:
                continue
            if walker:
                first, rule = True, "did not give way to a pedestrian"
                other.struck_at = min(other.struck_at, self.time_s)
            else:
                must_yield = scene.net.lanes["must_yield"]
                paths = path_of(i, scene), path_of(j, scene)
                ranks = [path >= 0 and bool(must_yield[path]) for path in paths]
                first, rule = find_cause(one, other, ranks, self.time_s)
                other.crashed_at = min(other.crashed_at, self.time_s)
            one.crashed_at = min(one.crashed_at, self.time_s)
            one.crashed = other.crashed = True
            cause, victim = pair if first else pair[::-1]
            self._add_event(EventKind.COLLISION, cause, victim, rule)
        self._touching = touching
        for row, vehicle in self._others:
            vehicle.crashed = bool(scene.vehicles["crashed"][row])

    def _clear(self, scene: Scene) -> None:
        """Remove who has arrived, is stuck, or crashed long ago."""
        why = scene.vehicles["leaves"].tolist()
        for code, vehicle in zip(why, self.vehicles, strict=True):
            if code not in (STAYS, ARRIVED):
                rule = "stuck on the wrong side" if code == STUCK else "crashed"
                self._add_event(EventKind.REMOVAL, vehicle.agent, rule=rule)
        self.vehicles = [v for code, v in zip(why, self.vehicles, strict=True) if code == STAYS]
        why = scene.walkers["leaves"].tolist()
        for code, walker in zip(why, self.walkers, strict=True):
            if code not in (STAYS, ARRIVED):
                self._add_event(EventKind.REMOVAL, walker.agent, rule="struck")
        self.walkers = [w for code, w in zip(why, self.walkers, strict=True) if code == STAYS]
        self.objects = list(self.walkers)


def agent_of(one: Any) -> int:
    """An agent's id; -1 for one that has none."""
    return int(getattr(one, "agent", -1))


def outlines_of(everyone: Sequence[Any]) -> Outlines:
    """The outlines of vehicles and pedestrians, in highway-env's axes."""
    position, heading, length, width = (
        np.array([getattr(one, name) for one in everyone])
        for name in ("position", "heading", "LENGTH", "WIDTH")
    )
    return Outlines.of(position, heading, length, width)
