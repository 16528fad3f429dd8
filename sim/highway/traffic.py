"""The road of the highway engine: everybody on it, and one step of all of them.

The truth is in the arrays of a `Scene`, which compiled functions read and write. The objects in
``vehicles`` and ``walkers`` are views of its rows; ego vehicles are objects of highway-env and are
read into their rows before each step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.objects import Landmark
from numba import typeof
from numpy.typing import NDArray

from behaviors.labels import Behavior
from sim.checked_arrays import frozen
from sim.frames import AgentKind, Event, EventKind, Frame, IntArray, Signal
from sim.highway import move, state
from sim.highway.decide import decide
from sim.highway.driving import STOCK_DRIVER, profile_fields
from sim.highway.lanes import LaneIndex, Stretch
from sim.highway.network import HighwayNetwork
from sim.highway.pedestrians import Footway, find_footway, footways_of
from sim.highway.places import locate, read_motion
from sim.highway.state import Footways, Records, Scene, blank_vehicles

LEAST_ROOM: Final = 16
"""There is room for this many agents at first."""

PHASE_ROUNDING_S: Final = 1e-6
"""Signal plans are looked at again this long before a phase ends, s, because times are rounded."""


def typed_once(kernel: Any) -> Callable[..., Any]:
    """A kernel whose arguments have the same types at every call.

    Numba looks at the type of every array of a `Scene` at each call, which takes as long as a step
    of ten cars.
    """
    entry: Any = None

    def call(*arguments: Any) -> Any:
        nonlocal entry
        if entry is None:
            compile_for = getattr(kernel, "compile", None)  # none with NUMBA_DISABLE_JIT
            entry = compile_for(tuple(map(typeof, arguments))) if compile_for else kernel
        return entry(*arguments)

    return call


_advance, _locate = typed_once(move.advance), typed_once(locate)
_read_motion = typed_once(read_motion)


def _column(name: str, kind: type) -> Any:
    """A property that shows a field of an agent's row as a Python value."""
    return property(lambda self: kind(self.field(name)))


def _lane_column(name: str) -> Any:
    """A property that shows the number of a lane as highway-env's index of it."""
    return property(lambda self: self.road.network.keys[self.field(name)])


class RowView:
    """Shows the row of an agent that is on a road as an object of highway-env."""

    heading = _column("heading", float)
    speed = _column("speed", float)
    LENGTH = _column("length", float)
    WIDTH = _column("width", float)
    crashed = _column("crashed", bool)
    position = property(lambda self: np.array([self.field("x"), self.field("y")]))

    def __init__(self, road: Any, agent: int) -> None:
        self.road, self.agent = road, agent

    def field(self, name: str) -> Any:
        """A field of its row."""
        rows, row = self.road.row_of(self.agent)
        return rows[name][row]


class ProfileVehicle(RowView, ControlledVehicle):  # type: ignore[misc]
    """A vehicle driven by a `Profile`.

    Differs from highway-env: others see a decided lane change from the next step on, so that no
    decision depends on the order in which vehicles act; vehicles do not drive backwards.
    """

    lane_index = _lane_column("lane")
    target_lane_index = _lane_column("target")
    target_speed = _column("entry_speed", float)
    route = None
    lane = property(lambda self: self.road.network.lanes[self.lane_index])
    behavior = property(lambda self: self.road.behaviors.get(self.agent))  # the true one


class Walker(RowView, Landmark):  # type: ignore[misc]
    """A pedestrian."""

    lane_index = lane = behavior = None
    collidable = solid = False


class TrafficRoad(Road):  # type: ignore[misc]
    """The road with everybody on it, step by step.

    Args:
        network: the road in highway-env's terms.

    Attributes:
        cars: (n,) rows of `VEHICLE`.
        people: (m,) rows of `WALKER`.
        behaviors: of the drivers, by their ids, for colours only.
        routes: the routes that have a number, by their numbers.
        footways: the ways on foot that have a number.
        signals: (g,) what each signal group shows.
        time_s: the time now, s.
    """

    record_history = neighbour_vehicles_connected_lanes = False
    _rows: dict[int, tuple[Records, int]]
    _vehicles: list[Any] | None
    _scene: Scene | None

    def __init__(self, network: HighwayNetwork) -> None:
        self.network = network
        self.np_random = np.random.RandomState(0)
        self.behaviors: dict[int, Behavior | None] = {}
        self.events: list[Event] = []
        self.footways: list[Footway] = []
        self.routes: list[tuple[Stretch, ...]] = []
        self.signals = np.full(len(network.road.signal_groups), Signal.OFF.code, dtype=np.int8)
        self.signal_since = np.zeros(self.signals.size)
        self._now = np.zeros(1, state.NOW)
        self._plan_due_s, self._due_s = np.zeros(len(network.road.signal_plans)), -math.inf
        self._numbers: dict[tuple[Any, ...], int] = {}
        self._ways: tuple[IntArray, Footways] | None = None
        self._egos: dict[int, Any] = {}
        self._touching: set[tuple[int, int]] = set()
        self._rooms = [np.zeros(LEAST_ROOM, kind) for kind in (state.VEHICLE, state.WALKER)]
        lanes = network.arrays.lanes
        self._most_lanes = int(np.diff(network.arrays.cells.first).max(initial=0))
        self._most_strips = int((lanes["strip_end"] - lanes["strip"]).max(initial=0))
        self._take(0, 0)
        self.update_signals()
        self.signal_since[:] = -math.inf

    @property
    def time_s(self) -> float:
        """The time now, s."""
        return float(self._now["time_s"][0])

    @time_s.setter
    def time_s(self, time_s: float) -> None:
        self._now["time_s"][0] = time_s

    @property
    def vehicles(self) -> list[Any]:
        """The vehicles as objects of highway-env, in the order of their rows."""
        if self._vehicles is None:
            agents = self.cars["agent"].tolist()
            self._vehicles = [self._egos.get(one) or ProfileVehicle(self, one) for one in agents]
        return self._vehicles

    @property
    def walkers(self) -> list[Any]:
        """The pedestrians, likewise."""
        return [Walker(self, agent) for agent in self.people["agent"].tolist()]

    objects = walkers

    def row_of(self, agent: int) -> tuple[Records, int]:
        """The rows among which an agent is, and which of them it is."""
        if not self._rows:
            for rows in (self.cars, self.people):
                self._rows.update((a, (rows, i)) for i, a in enumerate(rows["agent"].tolist()))
        return self._rows[agent]

    def add(self, row: Any) -> None:
        """Put an agent on the road, by its row of `VEHICLE` or `WALKER`."""
        walks = row.dtype != state.VEHICLE
        n, room = len(self.people if walks else self.cars), self._rooms[walks]
        if n == len(room):
            room = self._rooms[walks] = np.zeros(2 * n, room.dtype)
            room[:n] = self.people if walks else self.cars
        room[n] = row
        self._take(len(self.cars) + (not walks), len(self.people) + walks)

    def add_ego(self, ego: Any, agent: int, stretches: tuple[Stretch, ...]) -> None:
        """Put a vehicle of highway-env on the road, to drive over some stretches."""
        ego.agent, ego.behavior, ego.stretches = agent, None, stretches
        row = blank_vehicles(1)[0]
        row["agent"], row["kind"] = agent, AgentKind.CAR.code
        row["route"] = self.route_number(stretches)
        for name, value in profile_fields(STOCK_DRIVER, AgentKind.CAR).items():
            row[name] = value
        self._egos[agent] = ego
        self.add(row)

    def remove(self, vehicle: Any) -> None:
        """Take a vehicle off the road."""
        self._keep(self.cars["agent"] != vehicle.agent, self.people["agent"] >= 0)

    def _keep(self, *stays: NDArray[np.bool_]) -> None:
        """Keep some of the vehicles and some of the pedestrians."""
        for room, those in zip(self._rooms, stays, strict=True):
            if not those.all():
                room[: those.sum()] = room[: len(those)][those]
        self._take(*(int(those.sum()) for those in stays))

    def _take(self, cars: int, people: int) -> None:
        """Have the first of the rows that there is room for from now on."""
        self.cars, self.people = self._rooms[0][:cars], self._rooms[1][:people]
        self.cars["row"], agents = np.arange(cars), self.cars["agent"]
        if self._egos:
            self._egos = {agent: ego for agent, ego in self._egos.items() if agent in agents}
        self._rows, self._vehicles, self._scene = {}, None, None
        self.read_egos()

    def route_number(self, stretches: tuple[Stretch, ...]) -> int:
        """The number of a route, the same for equal ones."""
        return self._number_of(stretches, stretches, self.routes)

    def footway_number(self, route: tuple[str, ...]) -> int:
        """The number of the way on foot along a route of edges; see `find_footway`."""
        key = ("on foot", *route)
        if key not in self._numbers:
            self._number_of(key, find_footway(self.network.road, route), self.footways)
        return self._numbers[key]

    def _number_of(self, key: tuple[Any, ...], way: Any, known: list[Any]) -> int:
        if key not in self._numbers:
            self._numbers[key] = len(known)
            known.append(way)
            self._ways = None
        return self._numbers[key]

    def scene(self) -> Scene:
        """Everybody on the road as arrays, until somebody comes or goes."""
        if self._ways is None:
            longest = max(map(len, self.routes), default=0)
            table = np.full((len(self.routes) + 1, longest + 1), -1)
            for number, route in enumerate(self.routes):
                table[number, : len(route)] = [self.network.stretch_number[r] for r in route]
            self._ways = table, footways_of(self.footways)
            if self._scene is not None:  # what a step has found stays
                self._scene = self._scene._replace(routes=table, footways=self._ways[1])
        if self._scene is None:
            cars, people, net = self.cars, self.people, self.network.arrays
            everybody = {
                name: np.concatenate([cars[name], people[name]])
                for name in ("agent", "length", "width", "kind")
            }
            order = self._order = np.argsort(everybody["agent"], kind="stable")
            self._lasting = {name: frozen(of[order]) for name, of in everybody.items()}
            routes, footways = self._ways
            n, many = len(cars), len(order)
            self._scene = Scene(
                net, routes, footways, self.signals, self.signal_since, cars, people, self._now,
                on=np.empty(n * self._most_lanes, state.ON),
                on_head=np.full(net.lanes.size, -1),
                lane_head=np.full(net.lanes.size, -1),
                lane_link=np.full(2 * n, -1),
                spot_head=np.full(net.spots.size, -1),
                crossing_head=np.full(net.crossings.size, -1),
                by_x=np.argsort(np.concatenate([cars["x"], people["x"]]), kind="stable"),
                arrivals=np.empty(2 * n * self._most_strips, state.ARRIVAL),
                pairs=np.empty(4 * many + 16, state.PAIR),
                events=np.empty(8 * many, state.EVENT),
            )  # fmt: skip
        return self._scene

    def read_egos(self) -> None:
        """Read the ego vehicles into their rows."""
        number = self.network.number
        for one in self._egos.values():
            rows, i = self.row_of(one.agent)
            row = rows[i]
            row["x"], row["y"] = one.position
            row["heading"], row["speed"], row["crashed"] = one.heading, one.speed, one.crashed
            row["length"], row["width"] = one.LENGTH, one.WIDTH
            target = getattr(one, "target_lane_index", None) or one.lane_index
            row["lane"], row["target"] = number[one.lane_index], number[target]

    def frame(self, events: tuple[Event, ...] | None = None) -> Frame:
        """Everybody on the road now, in the axes of a `Frame`, whose y is to the left.

        Args:
            events: what happened; by default the events since they were last taken.
        """
        scene, n, lasting = self.scene(), len(self._order), self._lasting
        motion = np.empty(4 * n)
        _read_motion(self._order, scene, motion)
        motion.flags.writeable = False
        return Frame(
            self.time_s, lasting["agent"], motion[: 2 * n].reshape(n, 2), motion[2 * n : 3 * n],
            motion[3 * n :], lasting["length"], lasting["width"], lasting["kind"], self._shown,
            self.take_events() if events is None else events,
        )  # fmt: skip

    def update_signals(self) -> None:
        """Show what the signal plans say for the present time."""
        plans, now_s = self.network.road.signal_plans, self.time_s
        if now_s < self._due_s:
            return
        for number in np.flatnonzero(self._plan_due_s <= now_s).tolist():
            plan = plans[number]
            states, lasts_s = plan.phase_at(now_s)
            self._plan_due_s[number] = now_s + lasts_s - PHASE_ROUNDING_S
            for group, shown in zip(plan.groups, states, strict=True):
                if self.signals[group] != shown:
                    self.signals[group], self.signal_since[group] = shown, now_s
        self._shown = frozen(self.signals.copy())
        self._due_s = float(self._plan_due_s.min(initial=math.inf))

    def take_events(self) -> tuple[Event, ...]:
        """The events since the last call."""
        taken, self.events = tuple(self.events), []
        return taken

    def _note(self, kind: EventKind, agent: int, other: int | None = None, rule: str = "") -> None:
        self.events.append(Event(kind, self.time_s, agent, other, rule))

    def locate(self) -> None:
        """Find who is on which lane; valid until somebody moves."""
        _locate(self.scene())

    def on_lane(self, lane: LaneIndex) -> list[tuple[float, float, float]]:
        """Distance along a lane, m, length, m, and speed, m/s, of the vehicles on it, by distance.

        They are where the last `locate` found them.
        """
        scene, found = self.scene(), []
        at = scene.on_head[self.network.number[lane]]
        while at >= 0:
            row, at, s, _ = scene.on[at].tolist()
            found.append((s, float(self.cars["length"][row]), float(self.cars["speed"][row])))
        return found

    def crossings_in_use(self) -> set[int]:
        """The crossings that a pedestrian is on or steps onto within a metre."""
        people, footways = self.people, self.scene().footways
        ways = footways.ways[people["way"]]
        at = ways["crossover"] + people["crossed"]
        comes = at < ways["crossover_end"]
        ahead = footways.crossovers[at[comes]]
        return set(ahead["crossing"][ahead["begin_s"] - people["s"][comes] < 1.0].tolist())

    def advance(self, dt: float) -> None:
        """Let everybody decide and move for ``dt`` seconds, at most 0.1 s."""
        self.read_egos()
        scene = self.scene()
        if not _advance(dt, len(self._egos) > 0, scene):
            if self._now["astray"][0]:
                self._reroute()
            for ego in self._egos.values():
                ego.act()
            for ego in self._egos.values():
                ego.step(dt)
            self.read_egos()
            scene = self.scene()
            move.move(dt, scene)
        self.update_signals()
        if self._now["pairs"][0] or self._touching:
            self._collide(scene)
        if self._now["events"][0]:
            for kind, agent, time_s in scene.events[: int(self._now["events"][0])].tolist():
                self.events.append(Event(state.RECORDED[kind], time_s, agent))
            self._now["events"] = 0
        if self._now["leaving"][0]:
            self._clear()

    def _reroute(self) -> None:
        """Find other routes for those who need one, and let everybody decide."""
        for row in np.flatnonzero(self.cars["astray"]).tolist():
            car = self.cars[row]
            route = self.network.way_to(self.routes[car.route][-1], int(car.lane))
            if route is not None:
                car.route = self.route_number((self.network.keys[car.lane][:2], *route))
                car.leg = 0
        decide(self.scene())

    def _collide(self, scene: Scene) -> None:
        """Record collisions of those that touch and did not touch before, the faster one first."""
        touching, n = set(), len(self.cars)
        for i, j in sorted(scene.pairs[: int(self._now["pairs"][0])].tolist()):
            one, other = self.cars[i], self.cars[j] if j < n else self.people[j - n]
            pair = (int(one.agent), int(other.agent))
            touching.add(pair)
            if pair not in self._touching:
                for each in (one, other):
                    each.crashed_at, each.crashed = min(each.crashed_at, self.time_s), True
                first = j >= n or one.speed >= other.speed
                self._note(EventKind.COLLISION, *(pair if first else pair[::-1]))
        self._touching = touching
        for ego in self._egos.values():
            rows, row = self.row_of(ego.agent)
            ego.crashed = bool(rows["crashed"][row])

    def _clear(self) -> None:
        """Remove who has arrived, is stuck, or crashed long ago."""
        for rows in (self.cars, self.people):
            for code, agent in rows[["leaves", "agent"]].tolist():
                if code not in (move.STAYS, move.ARRIVED):
                    rule = "stuck on the wrong side" if code == move.STUCK else "crashed"
                    self._note(EventKind.REMOVAL, agent, rule=rule)
        self._keep(*(rows["leaves"] == move.STAYS for rows in (self.cars, self.people)))
