"""Reads the state of a running SUMO simulation into frames.

The front bumper of a vehicle is where SUMO puts it, and the rear axle follows it (a tractrix), as
in a rolling car. SUMO's own angle is right in lanes and turns, but a crawling car that changes
lanes is turned by up to 60 degrees, and stays so when it stops.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.frames import AgentKind, BoolArray, Event, EventKind, FloatArray, Frame, IntArray
from sim.road import Road
from sim.road.cells import Cells, boxes_of, cells_of
from sim.road.net import signal_code
from sim.scenario import AgentSpec

AREA_CELL_M: Final = 50.0
"""Width of the cells in which junctions are looked up, m (a large junction's)."""


AXLE_SHARE: Final = 0.8
"""The rear axle is this share of the length behind the front bumper (as in most cars)."""

TURNING, KEEPING = 0.8, 0.25
"""Greatest sideways over forward motion of a front bumper: where the road turns (a car's full
lock), and on straight roads (a hasty lane change). Sideways motion beyond it, which SUMO makes
while cars crawl or stand, moves the rear axle, too."""

STRAIGHTENING_M: Final = 6.0
"""A car is still straightening up this far after a turn (a car's length and more)."""


def turning_areas(road: Road) -> tuple[FloatArray, Cells]:
    """(J, 4) the box round all turns of each junction, m, and the boxes by cell, with a margin."""
    turns: dict[str, list[FloatArray]] = {}
    for link in road.connections:
        if link.direction != "straight":
            for name in link.via:  # SUMO names them :JUNCTION_NUMBER_LANE
                line = road.lanes[road.lane_index[name]].centerline
                turns.setdefault(name.rsplit("_", 2)[0], []).append(line)
    areas = boxes_of([np.concatenate(lines) for lines in turns.values()], 0.0)
    around = areas + np.array([-1.0, -1.0, 1.0, 1.0]) * (STRAIGHTENING_M + 1.0)
    return areas, cells_of(around, np.arange(len(areas)), AREA_CELL_M)


class FrameReader:
    """Reads the state of libsumo's C module into frames; all agents are in ascending order of id.

    SUMO gives the centre of the front bumper and degrees clockwise from north; frames have the
    centre of the outline and radians counter-clockwise from east.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._sumo = sumo
        self._plans = road.signal_plans
        self._row = {str(a.id): row for row, a in enumerate(agents)}
        self._of_all: dict[str, NDArray[Any]] = {
            "ids": np.array([a.id for a in agents], dtype=np.int64),
            "length": np.array([a.length_m for a in agents]),
            "width": np.array([a.width_m for a in agents]),
            "kind": np.array([a.kind.code for a in agents], dtype=np.int8),
        }
        self._pedestrian = np.array([a.kind is AgentKind.PEDESTRIAN for a in agents], dtype=bool)
        self._axles = np.full((len(agents), 4), np.nan)
        self._areas = turning_areas(road)
        self._touching: set[tuple[int, int]] = set()
        self._events: list[Event] = []
        self._names: tuple[Sequence[str], Sequence[str]] = ((), ())
        self._is_new = True
        self._letters = [""] * len(self._plans)
        self._signals = np.zeros(len(road.signal_groups), dtype=np.int8)

    def note(self, time_s: float, removed: Sequence[int]) -> None:
        """Record the collisions of the last simulation step, and who was removed after it."""
        collisions = self._sumo.simulation_getCollisions()
        touching = {(int(c.collider), int(c.victim)) for c in collisions}
        for pair in sorted(touching):
            kind = EventKind.CONTACT if pair in self._touching else EventKind.COLLISION
            self._events.append(Event(kind, time_s, *pair))
        self._touching = touching
        rule = "stood on the wrong side"
        self._events += [Event(EventKind.REMOVAL, time_s, agent, rule=rule) for agent in removed]

    def names(self) -> tuple[Sequence[str], Sequence[str]]:
        """Names of vehicles and pedestrians, the same two objects until an agent comes or goes."""
        names = self._sumo.vehicle_getIDList(), self._sumo.person_getIDList()
        if names != self._names:
            self._names, self._is_new = names, True
        return self._names

    def read(self, time_s: float, walking_speeds: Mapping[str, float]) -> Frame:
        """The state at a simulated time, s, with the events since the last frame.

        SUMO does not know the speeds, m/s, of the pedestrians that a controller moves.
        """
        sumo = self._sumo
        vehicles, persons = self.names()
        n = len(vehicles) + len(persons)
        if self._is_new:
            self._is_new = False
            rows = np.fromiter(map(self._row.__getitem__, chain(vehicles, persons)), np.int64, n)
            self._order = rows.argsort()
            self._rows = rows[self._order]
            self._constant = {name: values[self._rows] for name, values in self._of_all.items()}
            self._angle = np.zeros(len(vehicles))
            for i in np.flatnonzero(np.isnan(self._axles[rows[: len(vehicles)], 0])).tolist():
                # SUMO's angle is only needed when a vehicle departs
                self._angle[i] = sumo.vehicle_getAngle(vehicles[i])
        places: Iterator[float] = chain.from_iterable(map(sumo.vehicle_getPosition, vehicles))
        speeds: Iterator[float] = map(sumo.vehicle_getSpeed, vehicles)
        angle = self._angle
        if persons:
            places = chain(places, chain.from_iterable(map(sumo.person_getPosition, persons)))
            walking = map(sumo.person_getSpeed, persons)
            if walking_speeds:
                walking = map(walking_speeds.get, persons, walking)
            speeds = chain(speeds, walking)
            angles = np.fromiter(map(sumo.person_getAngle, persons), np.float64, len(persons))
            angle = np.concatenate([angle, angles])
        front = np.fromiter(places, np.float64, 2 * n)
        speed = np.fromiter(speeds, np.float64, n)[self._order]
        xy, heading = np.empty((n, 2)), np.empty(n)
        find_poses(
            self._order, self._rows, front, angle, self._of_all["length"], self._pedestrian,
            *self._areas, self._axles, xy, heading,
        )  # fmt: skip
        signals = self._read_signals()
        arrays: list[NDArray[Any]] = [xy, heading, speed, signals, *self._constant.values()]
        for array in arrays:
            array.setflags(write=False)
        events, self._events = tuple(self._events), []
        return Frame(
            time_s=time_s, xy=xy, heading=heading, speed=speed, signals=signals, events=events,
            **self._constant,
        )  # fmt: skip

    def _read_signals(self) -> NDArray[np.int8]:
        """Codes of all signal groups; the same array until a light switches."""
        for i, plan in enumerate(self._plans):
            letters = self._sumo.trafficlight_getRedYellowGreenState(plan.id)
            if letters != self._letters[i]:
                self._letters[i] = letters
                self._signals = self._signals.copy()
                for group, link in zip(plan.groups, plan.links, strict=True):
                    self._signals[group] = signal_code(letters[link])
        return self._signals


@in_place()
def find_poses(
    order: IntArray, rows: IntArray, front: FloatArray, angle: FloatArray, length: FloatArray,
    pedestrian: BoolArray, areas: FloatArray, cells: Cells, axles: FloatArray, xy: FloatArray,
    heading: FloatArray,
) -> None:  # fmt: skip
    """Centres (n, 2), m, and headings (n,), rad in (-pi, pi], from the motion of front bumpers.

    Agent i is number ``order[i]`` in ``front`` (2n,), centres of the front bumpers, x and y
    alternating, m, and in ``angle`` (n,), degrees clockwise from north. The angle is that of
    pedestrians and of vehicles that have just departed. Agent i is row ``rows[i]`` of all N agents:
    their lengths, m, which of them are pedestrians, and ``axles`` (N, 4), the front bumper and the
    rear axle at the last call, m. These are updated; NaN stands for just departed. ``areas`` are
    `turning_areas`, and ``cells`` theirs.
    """
    x0, y0, size, columns, lines, first, items = cells
    for i in range(rows.size):
        row, at = rows[i], order[i]
        x, y = front[2 * at], front[2 * at + 1]
        reach = AXLE_SHARE * length[row]
        if pedestrian[row] or math.isnan(axles[row, 0]):
            heading_east = math.radians(90.0 - angle[at])
            east, north = math.cos(heading_east), math.sin(heading_east)
        else:
            fx, fy, ax, ay = axles[row, 0], axles[row, 1], axles[row, 2], axles[row, 3]
            old_east, old_north = (fx - ax) / reach, (fy - ay) / reach
            ahead = (x - fx) * old_east + (y - fy) * old_north
            aside = (y - fy) * old_east - (x - fx) * old_north
            column, line = math.floor((x - x0) / size), math.floor((y - y0) / size)
            turning = False
            if 0 <= column < columns and 0 <= line < lines:
                cell = line * columns + column
                for p in range(first[cell], first[cell + 1]):
                    a = items[p]
                    # how far outside the area the front is, and whether it drives away from it
                    out_x = x - min(max(x, areas[a, 0]), areas[a, 2])
                    out_y = y - min(max(y, areas[a, 1]), areas[a, 3])
                    leaves = out_x * old_east + out_y * old_north >= 0.0
                    turning |= leaves and max(abs(out_x), abs(out_y)) < STRAIGHTENING_M
            most = (TURNING if turning else KEEPING) * max(ahead, 0.0)
            slid = aside - min(max(aside, -most), most)
            east, north = x - ax + slid * old_north, y - ay - slid * old_east
            far = max(math.hypot(east, north), 1e-9)
            east, north = east / far, north / far
        axles[row, 0], axles[row, 1] = x, y
        axles[row, 2], axles[row, 3] = x - reach * east, y - reach * north
        xy[i, 0], xy[i, 1] = x - 0.5 * length[row] * east, y - 0.5 * length[row] * north
        heading[i] = math.atan2(north, east)
        if heading[i] == -math.pi:
            heading[i] = math.pi
