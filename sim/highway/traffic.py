"""The road of the highway engine: everybody on it, and one step of all of them.

The truth is in the arrays of a `Scene`, which compiled functions read and write. The objects in
``vehicles`` and ``walkers`` are views of its rows; vehicles of other classes, such as an ego
vehicle, are objects of highway-env and are read into their rows before each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle

from sim.frames import Event, EventKind, Frame, Signal
from sim.highway.decide import act, decide
from sim.highway.driving import STOCK_DRIVER, profile_fields
from sim.highway.lanes import LaneIndex, Stretch
from sim.highway.motion import (
    ARRIVED,
    ASTRAY,
    NO_ROOM,
    SOMEBODY_GOES,
    STAYS,
    STUCK,
    advance,
    move,
)
from sim.highway.network import HighwayNetwork
from sim.highway.scene import locate, read_motion, room_at_entry
from sim.highway.state import (
    ARRIVAL,
    EVENT,
    EVENT_KINDS,
    NOW,
    ON,
    PAIR,
    VEHICLE,
    WALKER,
    IntArray,
    Scene,
    blank_vehicle,
)
from sim.highway.tables import Records
from sim.highway.vehicle import FIELDS, ProfileVehicle, RowView
from sim.highway.walkers import Footway, Walker, find_footway, footways_of

PHASE_ROUNDING_S: Final = 1e-6
"""Signal plans are looked at again this long before a phase ends, s, because times are rounded."""

LEAST_ROOM: Final = 16
"""Arrays have room for this many agents at first."""

CROSSWISE: Final = 0.5
"""Sine of the angle between two headings above which the ways cross: 30 degrees."""

FROM_JUNCTION_M: Final = 15.0
"""Ways that cross this far from the ends of both do not meet in a junction, m (more than the
longest vehicle)."""


class Crowd:
    """Agents of one kind: objects, and a row of an array for each.

    Args:
        kind: type of the rows.
    """

    def __init__(self, kind: np.dtype[Any]) -> None:
        self.array: Records = np.zeros(LEAST_ROOM, kind)
        self.objects: list[Any] = []

    @property
    def rows(self) -> Records:
        """The rows in use."""
        return self.array[: len(self.objects)]

    def add(self, one: Any, row: Any) -> None:
        """Add an agent with its first row."""
        if len(self.objects) == len(self.array):
            self.array = np.concatenate([self.array, np.zeros_like(self.array)])
        self.objects.append(one)
        self.array[len(self.objects) - 1] = row
        self._show()

    def keep(self, stays: Sequence[bool]) -> None:
        """Keep some of the agents; views of those who leave show a copy of their last row."""
        for one, keeps in zip(self.objects, stays, strict=True):
            if not keeps and isinstance(one, RowView):
                one.table, one.row = one.table[one.row : one.row + 1].copy(), 0
        kept = self.rows[np.array(stays, bool)]
        self.objects[:] = [one for one, keeps in zip(self.objects, stays, strict=True) if keeps]
        self.array[: len(kept)] = kept
        self._show()

    def _show(self) -> None:
        """Tell the views which rows they show."""
        for row, one in enumerate(self.objects):
            if isinstance(one, RowView):
                one.table, one.row = self.array, row


class TrafficRoad(Road):  # type: ignore[misc]
    """The road with everybody on it, step by step.

    Args:
        network: the road in highway-env's terms.

    Attributes:
        vehicles: the vehicles, in the order of their rows.
        walkers: the pedestrians, likewise.
        footways: the ways on foot that have a number.
        signals: (g,) what each signal group shows.
        time_s: the time now, s.
    """

    def __init__(self, network: HighwayNetwork) -> None:
        super().__init__(network.net, np_random=np.random.RandomState(0))
        self.network_info = network
        self._cars, self._people = Crowd(VEHICLE), Crowd(WALKER)
        self.vehicles: list[Any] = self._cars.objects
        self.walkers: list[Walker] = self._people.objects
        self.objects = self.walkers
        self.events: list[Event] = []
        self.footways: list[Footway] = []
        self.signals = np.full(len(network.road.signal_groups), Signal.OFF.code, dtype=np.int8)
        self.signal_since = np.zeros(self.signals.size)
        self._now = np.zeros(1, NOW)
        self._plan_due_s = np.zeros(len(network.road.signal_plans))
        self._routes: dict[tuple[Stretch, ...], int] = {}
        self._footway_numbers: dict[tuple[str, ...], int] = {}
        self._others: list[tuple[int, Vehicle]] = []
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

    # Who is there ----------------------------------------------------------------------------

    def add(self, one: Any) -> None:
        """Put a vehicle or a pedestrian on the road."""
        if isinstance(one, Walker):
            self._people.add(one, one.table[one.row])
        elif isinstance(one, ProfileVehicle):
            self._cars.add(one, one.table[one.row])
        else:
            row = blank_vehicle()
            row["agent"], row["kind"] = one.agent, one.kind.code
            for name, value in STOCK_FIELDS.items():
                row[name] = value
            row["route"] = self.route_number(one.stretches)
            self._cars.add(one, row)
        self._changed()

    def remove(self, vehicle: Any) -> None:
        """Take a vehicle off the road."""
        self._cars.keep([one is not vehicle for one in self.vehicles])
        self._changed()

    def _changed(self) -> None:
        """Note that somebody has come or gone."""
        self._scene = None
        self._others = [(i, v) for i, v in enumerate(self.vehicles) if not isinstance(v, RowView)]
        self._read_others()

    def route_number(self, stretches: tuple[Stretch, ...]) -> int:
        """The number of a route, the same for equal ones."""
        if stretches not in self._routes:
            self._routes[stretches] = len(self._routes)
            routes = self._route_table()
            self._work = self._work and self._work._replace(routes=routes)
            self._scene = self._scene and self._scene._replace(routes=routes)
        return self._routes[stretches]

    def footway_number(self, route: tuple[str, ...]) -> int:
        """The number of the way on foot along a route of edges; see `find_footway`."""
        if route not in self._footway_numbers:
            self.footways.append(find_footway(self.network_info.road, route))
            self._footway_numbers[route] = len(self.footways) - 1
            self._scene = self._work = None
        return self._footway_numbers[route]

    def scene(self) -> Scene:
        """Everybody on the road as arrays, with rows in the order of ``vehicles``."""
        if self._scene is None:
            self._scene = self._new_scene()
        return self._scene

    def _read_others(self) -> None:
        """Read the vehicles that are no views of their rows into them."""
        cars, number = self._cars.array, self.network_info.number
        for i, one in self._others:
            cars["x"][i], cars["y"][i] = one.position
            cars["heading"][i], cars["speed"][i] = one.heading, one.speed
            cars["length"][i], cars["width"][i] = one.LENGTH, one.WIDTH
            cars["crashed"][i], cars["lane"][i] = one.crashed, number[one.lane_index]
            target = getattr(one, "target_lane_index", None) or one.lane_index
            cars["target"][i] = number[target]

    def _new_scene(self) -> Scene:
        """The arrays of those who are there now."""
        rows, people = self._cars.rows, self._people.rows
        n, m = len(rows), len(people)
        ids = np.concatenate([rows["agent"], people["agent"]])
        kind = np.concatenate([rows["kind"], np.full(m, Walker.kind.code)]).astype(np.int8)
        length = np.concatenate([rows["length"], people["length"]])
        width = np.concatenate([rows["width"], people["width"]])
        order = self._order = np.argsort(ids, kind="stable")
        self._lasting = {
            "ids": ids[order], "length": length[order], "width": width[order], "kind": kind[order]
        }  # fmt: skip
        if self._work is None or self._work.cell_link.size < n + m:
            self._work = self._new_work()
        return self._work._replace(vehicles=rows, walkers=people)

    def _new_work(self) -> Scene:
        """Arrays with room for twice as many as are there now."""
        n, m = 2 * len(self.vehicles) + 8, 2 * len(self.walkers) + 8
        net = self.network_info.arrays
        entries = 2 * max(4 * n, int(self._now["entries"][0]))
        strips = net.lanes["strip_end"] - net.lanes["strip"]
        return Scene(
            net=net,
            routes=self._route_table(),
            footways=footways_of(self.footways),
            signals=self.signals,
            signal_since=self.signal_since,
            vehicles=self._cars.rows,
            walkers=self._people.rows,
            now=self._now,
            on_first=np.zeros(net.lanes.size + 1, np.int64),
            on=np.zeros(entries, ON),
            unsorted=np.zeros(entries, ON),
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

    def _route_table(self) -> IntArray:
        """The numbers of the stretches on each route, -1 after the last."""
        longest = max((len(route) for route in self._routes), default=0)
        numbers = self.network_info.stretch_number
        table = np.full((len(self._routes) + 1, longest + 1), -1, dtype=np.int64)
        for route, number in self._routes.items():
            table[number, : len(route)] = [numbers[one] for one in route]
        return table

    def frame(self, events: tuple[Event, ...] | None = None) -> Frame:
        """Everybody on the road now, in the axes of a `Frame`, whose y is to the left.

        Args:
            events: what happened; by default the events since they were last taken.
        """
        events = self.take_events() if events is None else events
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
        if not plans:
            return
        for number in np.flatnonzero(self._plan_due_s <= now_s).tolist():
            plan = plans[number]
            states, lasts_s = plan.phase_at(now_s)
            self._plan_due_s[number] = now_s + lasts_s - PHASE_ROUNDING_S
            for group, state in zip(plan.groups, states, strict=True):
                if self.signals[group] != state:
                    self.signals[group] = state
                    self.signal_since[group] = now_s

    def take_events(self) -> tuple[Event, ...]:
        """The events since the last call."""
        taken, self.events = tuple(self.events), []
        return taken

    def _note(self, kind: EventKind, agent: int, other: int | None = None, rule: str = "") -> None:
        self.events.append(Event(kind, self.time_s, agent, other, rule))

    # Places ----------------------------------------------------------------------------------

    def locate(self) -> None:
        """Find who is on which lane; valid until somebody moves."""
        while not locate(self.scene()):
            self._scene = self._work = None  # once more, with room for all entries

    def on_lane(self, lane: LaneIndex) -> list[tuple[float, Any]]:
        """The distances along a lane, ascending, m, of the vehicles on it at the last `locate`."""
        scene, k = self.scene(), self.network_info.number[lane]
        here = scene.on[scene.on_first[k] : scene.on_first[k + 1]]
        return [(s, self.vehicles[row]) for s, row in here[["s", "row"]].tolist()]

    def room_at_entry(self, lanes: IntArray, length: float) -> tuple[list[float], list[float]]:
        """Bumper gap to the first vehicle on lanes or changing to them, m, and its speed, m/s."""
        gap, speed = np.empty(lanes.size), np.empty(lanes.size)
        self._read_others()
        room_at_entry(lanes, length, self.scene(), gap, speed)
        return gap.tolist(), speed.tolist()

    def crossings_in_use(self) -> set[int]:
        """The crossings that a pedestrian is on or steps onto within a metre."""
        people, footways = self.scene().walkers, self.scene().footways
        at = footways.ways["crossover"][people["way"]] + people["crossed"]
        comes = at < footways.ways["crossover_end"][people["way"]]
        ahead = footways.crossovers[at[comes]]
        return set(ahead["crossing"][ahead["begin_s"] - people["s"][comes] < 1.0].tolist())

    # A step ----------------------------------------------------------------------------------

    def advance(self, dt: float) -> None:
        """Let everybody decide and move for ``dt`` seconds; the same as `act` and `step`."""
        if self._others:
            self.act()
            return self.step(dt)
        code = advance(dt, self.scene())
        if code == NO_ROOM:
            self._scene = self._work = None
            return self.advance(dt)
        if code == ASTRAY:
            self._reroute()
            return self.step(dt)
        return self._end_step(code == SOMEBODY_GOES)

    def act(self) -> None:
        """Let everybody decide."""
        self._read_others()
        self.locate()
        if act(self.scene()):
            self._reroute()
        for _, vehicle in self._others:
            vehicle.act()

    def _reroute(self) -> None:
        """Find other routes for those who need one, and let everybody decide."""
        rows = self._cars.rows
        for row in np.flatnonzero(rows["astray"]).tolist():
            driver = self.vehicles[row]
            route = self.network_info.way_to(driver.stretches[-1], int(rows["lane"][row]))
            if route is not None:
                driver.stretches = (driver.lane_index[:2], *route)
        decide(self.scene())

    def step(self, dt: float) -> None:
        """Move everybody for ``dt`` seconds, at most 0.1 s, and record what happened."""
        for _, vehicle in self._others:
            vehicle.step(dt)
        self._read_others()
        self._end_step(move(dt, self.scene()))

    def _end_step(self, somebody_goes: bool) -> None:
        """Show signals, record what happened and remove who goes, after everybody has moved."""
        scene = self.scene()
        self.update_signals()
        if self._now["pairs"][0] or self._touching:
            self._collide(scene)
        if self._now["events"][0]:
            for kind, agent, time_s in scene.events[: int(self._now["events"][0])].tolist():
                self.events.append(Event(EVENT_KINDS[kind], time_s, agent))
            self._now["events"] = 0
        if somebody_goes:
            self._clear(scene)

    def _collide(self, scene: Scene) -> None:
        """Record collisions of those that touch and did not touch before, the faster one first."""
        touching, n = set(), len(self.vehicles)
        for i, j in scene.pairs[: int(self._now["pairs"][0])].tolist():
            one, walks = scene.vehicles[i], j >= n
            other = scene.walkers[j - n] if walks else scene.vehicles[j]
            if not walks and self._are_on_two_levels(one, other):
                continue
            pair = (int(one.agent), int(other.agent))
            touching.add(pair)
            if pair in self._touching:
                continue
            for each in (one, other):
                each.crashed_at, each.crashed = min(each.crashed_at, self.time_s), True
            pair = pair if walks or one.speed >= other.speed else pair[::-1]
            self._note(EventKind.COLLISION, *pair)
        self._touching = touching
        for row, vehicle in self._others:
            vehicle.crashed = bool(scene.vehicles["crashed"][row])

    def _are_on_two_levels(self, one: Any, other: Any) -> bool:
        """Whether one of two vehicles passes over the other on a bridge.

        Roads have no heights; but lanes meet at junctions only, so where two of them cross far from
        the ends of both, one lies above the other.
        """
        network, keys = self.network_info, self.network_info.keys
        if keys[one.lane][:2] == keys[other.lane][:2]:
            return False
        if abs(math.sin(one.heading - other.heading)) < CROSSWISE:
            return False
        for vehicle in (one, other):
            lane = network.lanes[keys[vehicle.lane]]
            s = lane.local_coordinates(np.array([vehicle.x, vehicle.y]))[0]
            inside = keys[vehicle.lane] in network.exit_of
            if inside or min(s, lane.length - s) < FROM_JUNCTION_M:
                return False
        return True

    def _clear(self, scene: Scene) -> None:
        """Remove who has arrived, is stuck, or crashed long ago."""
        for crowd, rows in ((self._cars, scene.vehicles), (self._people, scene.walkers)):
            for code, agent in rows[["leaves", "agent"]].tolist():
                if code not in (STAYS, ARRIVED):
                    rule = "stuck on the wrong side" if code == STUCK else "crashed"
                    self._note(EventKind.REMOVAL, agent, rule=rule)
            crowd.keep((rows["leaves"] == STAYS).tolist())
        self._changed()


STOCK_FIELDS: Final = {
    name: value
    for name, value in profile_fields(STOCK_DRIVER, Walker.kind.CAR).items()
    if name in FIELDS
}
"""The fields of a row that others assume of a vehicle without a profile."""
