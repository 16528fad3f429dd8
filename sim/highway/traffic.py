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
from numba import typeof

from behaviors.labels import Behavior
from sim.checked_arrays import frozen
from sim.frames import AgentKind, Event, EventKind, Frame, IntArray, Signal
from sim.highway import motion, state
from sim.highway.decide import decide
from sim.highway.driving import STOCK_DRIVER, profile_fields
from sim.highway.lanes import LaneIndex, Stretch
from sim.highway.network import HighwayNetwork
from sim.highway.pedestrians import Footway, find_footway, footways_of
from sim.highway.places import locate, read_motion
from sim.highway.state import Scene, blank_vehicles
from sim.highway.vehicle import Crowd, ProfileVehicle, RowView, Walker

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


_advance, _read_motion = typed_once(motion.advance), typed_once(read_motion)


class TrafficRoad(Road):  # type: ignore[misc]
    """The road with everybody on it, step by step.

    Args:
        network: the road in highway-env's terms.

    Attributes:
        cars: the vehicles.
        people: the pedestrians.
        behaviors: of the drivers, by their ids, for colours only.
        routes: the routes that have a number, by their numbers.
        footways: the ways on foot that have a number.
        signals: (g,) what each signal group shows.
        time_s: the time now, s.
    """

    record_history = neighbour_vehicles_connected_lanes = False

    def __init__(self, network: HighwayNetwork) -> None:
        self.network = network
        self.np_random = np.random.RandomState(0)
        self.cars = Crowd(self, state.VEHICLE, ProfileVehicle)
        self.people = Crowd(self, state.WALKER, Walker)
        self.behaviors: dict[int, Behavior | None] = {}
        self.events: list[Event] = []
        self.footways: list[Footway] = []
        self.routes: list[tuple[Stretch, ...]] = []
        self.signals = np.full(len(network.road.signal_groups), Signal.OFF.code, dtype=np.int8)
        self.signal_since = np.zeros(self.signals.size)
        self._now = np.zeros(1, state.NOW)
        self._plan_due_s, self._due_s = np.zeros(len(network.road.signal_plans)), -math.inf
        self._numbers: dict[tuple[Any, ...], int] = {}
        self._egos: list[Any] = []
        self._touching: set[tuple[int, int]] = set()
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
        self._now["time_s"][0] = time_s

    @property
    def vehicles(self) -> list[Any]:
        """The vehicles as objects of highway-env, in the order of their rows."""
        return self.cars.objects

    @property
    def walkers(self) -> list[Any]:
        """The pedestrians, likewise."""
        return self.people.objects

    objects = walkers

    def add(self, row: Any) -> None:
        """Put an agent on the road, by its row of `VEHICLE` or `WALKER`."""
        (self.cars if row.dtype == state.VEHICLE else self.people).add(row)
        self._changed()

    def add_ego(self, ego: Any, agent: int, stretches: tuple[Stretch, ...]) -> None:
        """Put a vehicle of highway-env on the road, to drive over some stretches."""
        ego.agent, ego.behavior, ego.stretches = agent, None, stretches
        row = blank_vehicles(1)
        row["agent"], row["kind"] = agent, AgentKind.CAR.code
        row["route"] = self.route_number(stretches)
        for name, value in profile_fields(STOCK_DRIVER, AgentKind.CAR).items():
            row[name] = value
        self.cars.add(row[0], ego)
        self._changed()

    def remove(self, vehicle: Any) -> None:
        """Take a vehicle off the road."""
        self.cars.keep(self.cars.rows["agent"] != vehicle.agent)
        self._changed()

    def _changed(self) -> None:
        """Note that somebody has come or gone."""
        self._scene = None
        self._egos = [one for one in self.cars.seen.values() if not isinstance(one, RowView)]
        self.read_egos()

    def route_number(self, stretches: tuple[Stretch, ...]) -> int:
        """The number of a route, the same for equal ones."""
        if stretches not in self._numbers:
            self._numbers[stretches] = len(self.routes)
            self.routes.append(stretches)
            self._scene = self._work = None
        return self._numbers[stretches]

    def footway_number(self, route: tuple[str, ...]) -> int:
        """The number of the way on foot along a route of edges; see `find_footway`."""
        if ("on foot", *route) not in self._numbers:
            self._numbers["on foot", *route] = len(self.footways)
            self.footways.append(find_footway(self.network.road, route))
            self._scene = self._work = None
        return self._numbers["on foot", *route]

    def scene(self) -> Scene:
        """Everybody on the road as arrays."""
        if self._scene is None:
            cars, people = self.cars.rows, self.people.rows
            everybody = {
                name: np.concatenate([cars[name], people[name]])
                for name in ("agent", "length", "width", "kind")
            }
            order = self._order = np.argsort(everybody["agent"], kind="stable")
            self._lasting = {name: frozen(of[order]) for name, of in everybody.items()}
            if self._work is None or self._work.cell_link.size < len(order):
                self._work = self._new_work()
            self._scene = self._work._replace(vehicles=cars, walkers=people)
        return self._scene

    def read_egos(self) -> None:
        """Read the ego vehicles into their rows."""
        number = self.network.number
        for one in self._egos:
            row = one.table[one.row]
            row["x"], row["y"] = one.position
            row["heading"], row["speed"], row["crashed"] = one.heading, one.speed, one.crashed
            row["length"], row["width"] = one.LENGTH, one.WIDTH
            target = getattr(one, "target_lane_index", None) or one.lane_index
            row["lane"], row["target"] = number[one.lane_index], number[target]

    def _new_work(self) -> Scene:
        """Arrays with room for twice as many as are there now."""
        n, m = 2 * len(self.cars.rows) + 8, 2 * len(self.people.rows) + 8
        net = self.network.arrays
        entries = 2 * max(4 * n, int(self._now["entries"][0]))
        strips = net.lanes["strip_end"] - net.lanes["strip"]
        return Scene(
            net, self._route_table(), footways_of(self.footways), self.signals, self.signal_since,
            self.cars.rows, self.people.rows, self._now,
            on_first=np.zeros(net.lanes.size + 1, np.int64),
            on=np.zeros(entries, state.ON),
            unsorted=np.zeros(entries, state.ON),
            lane_head=np.full(net.lanes.size, -1),
            lane_link=np.full(2 * (n + m), -1),
            spot_head=np.full(net.spots.size, -1),
            crossing_head=np.full(net.crossings.size, -1),
            cell_head=np.full(net.cells.columns * net.cells.rows, -1),
            cell_link=np.full(n + m, -1),
            arrivals=np.zeros(2 * (n + m) * int(strips.max(initial=0)), state.ARRIVAL),
            pairs=np.zeros(4 * (n + m) + 16, state.PAIR),
            events=np.zeros(8 * (n + m), state.EVENT),
        )  # fmt: skip

    def _route_table(self) -> IntArray:
        """The numbers of the stretches on each route, -1 after the last."""
        numbers = self.network.stretch_number
        longest = max(map(len, self.routes), default=0)
        table = np.full((len(self.routes) + 1, longest + 1), -1, dtype=np.int64)
        for number, route in enumerate(self.routes):
            table[number, : len(route)] = [numbers[one] for one in route]
        return table

    def frame(self, events: tuple[Event, ...] | None = None) -> Frame:
        """Everybody on the road now, in the axes of a `Frame`, whose y is to the left.

        Args:
            events: what happened; by default the events since they were last taken.
        """
        scene, n = self.scene(), len(self._order)
        motion, lasting = np.empty(4 * n), self._lasting
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
        while not locate(self.scene()):
            self._scene = self._work = None  # once more, with room for all entries

    def on_lane(self, lane: LaneIndex) -> tuple[list[float], ...]:
        """Distances along a lane, ascending, lengths, m, and speeds, m/s, at the last `locate`."""
        scene, k = self.scene(), self.network.number[lane]
        here = scene.on[scene.on_first[k] : scene.on_first[k + 1]]
        there = scene.vehicles[here["row"]]
        return here["s"].tolist(), there["length"].tolist(), there["speed"].tolist()

    def crossings_in_use(self) -> set[int]:
        """The crossings that a pedestrian is on or steps onto within a metre."""
        people, footways = self.scene().walkers, self.scene().footways
        at = footways.ways["crossover"][people["way"]] + people["crossed"]
        comes = at < footways.ways["crossover_end"][people["way"]]
        ahead = footways.crossovers[at[comes]]
        return set(ahead["crossing"][ahead["begin_s"] - people["s"][comes] < 1.0].tolist())

    def advance(self, dt: float) -> None:
        """Let everybody decide and move for ``dt`` seconds, at most 0.1 s."""
        self.read_egos()
        code = _advance(dt, len(self._egos) > 0, self.scene())
        if code == motion.NO_ROOM:
            self._scene = self._work = None
            return self.advance(dt)
        if code == motion.ASTRAY:
            self._reroute()
        if code in (motion.ASTRAY, motion.DECIDED):
            for ego in self._egos:
                ego.act()
            for ego in self._egos:
                ego.step(dt)
            self.read_egos()
            code = motion.move(dt, self.scene())
        self.update_signals()
        if self._now["pairs"][0] or self._touching:
            self._collide(self.scene())
        if self._now["events"][0]:
            for kind, agent, time_s in self.scene().events[: int(self._now["events"][0])].tolist():
                self.events.append(Event(state.EVENT_KINDS[kind], time_s, agent))
            self._now["events"] = 0
        if code == motion.SOMEBODY_GOES:
            self._clear()

    def _reroute(self) -> None:
        """Find other routes for those who need one, and let everybody decide."""
        rows, network = self.cars.rows, self.network
        for row in np.flatnonzero(rows["astray"]).tolist():
            lane = int(rows["lane"][row])
            route = network.way_to(self.routes[rows["route"][row]][-1], lane)
            if route is not None:
                rows["route"][row] = self.route_number((network.keys[lane][:2], *route))
                rows["leg"][row] = 0
        decide(self.scene())

    def _collide(self, scene: Scene) -> None:
        """Record collisions of those that touch and did not touch before, the faster one first."""
        touching, n = set(), len(scene.vehicles)
        for i, j in sorted(scene.pairs[: int(self._now["pairs"][0])].tolist()):
            one, walks = scene.vehicles[i], j >= n
            other = scene.walkers[j - n] if walks else scene.vehicles[j]
            pair = (int(one.agent), int(other.agent))
            touching.add(pair)
            if pair in self._touching:
                continue
            for each in (one, other):
                each.crashed_at, each.crashed = min(each.crashed_at, self.time_s), True
            pair = pair if walks or one.speed >= other.speed else pair[::-1]
            self._note(EventKind.COLLISION, *pair)
        self._touching = touching
        for ego in self._egos:
            ego.crashed = bool(ego.table["crashed"][ego.row])

    def _clear(self) -> None:
        """Remove who has arrived, is stuck, or crashed long ago."""
        for crowd in (self.cars, self.people):
            for code, agent in crowd.rows[["leaves", "agent"]].tolist():
                if code not in (motion.STAYS, motion.ARRIVED):
                    rule = "stuck on the wrong side" if code == motion.STUCK else "crashed"
                    self._note(EventKind.REMOVAL, agent, rule=rule)
            crowd.keep(crowd.rows["leaves"] == motion.STAYS)
        self._changed()
