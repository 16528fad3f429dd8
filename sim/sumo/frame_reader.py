"""Reads the state of a running SUMO simulation into frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sim.frames import AgentKind, Event, EventKind, FloatArray, Frame
from sim.road import Road
from sim.road.cells import Cells, boxes_of, cells_of
from sim.road.net import signal_code
from sim.scenario import AgentSpec
from sim.sumo.vehicle_poses import STRAIGHTENING_M, find_poses

AREA_CELL_M: Final = 50.0
"""Width of the cells in which junctions are looked up, m (a large junction's)."""

TRAFFICLIGHT_TYPE_STATIC: Final = 0
"""SUMO's number for lights with a fixed-time programme (``libsumo.constants``)."""


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


@dataclass(frozen=True, slots=True)
class _Present:
    """Constants until an agent comes or goes: the n agents on the road.

    Names are in SUMO's order, vehicles before persons; ``order`` sorts them by their ``rows``.
    ``angle`` is SUMO's of each vehicle that has just departed, and 0 of the others.
    """

    vehicles: Sequence[str]
    persons: Sequence[str]
    order: NDArray[np.int64]
    rows: NDArray[np.int64]
    angle: FloatArray
    ids: NDArray[np.int64]
    length: FloatArray
    width: FloatArray
    kind: NDArray[np.int8]


class FrameReader:
    """Reads the state of the running simulation into frames.

    SUMO gives the centre of the front bumper and degrees clockwise from north; frames have the
    centre of the outline and radians counter-clockwise from east.

    Args:
        sumo: libsumo's C module.
        road: the road.
        agents: all agents of the episode, in ascending order of id.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._sumo = sumo
        self._plans = road.signal_plans
        self._groups = len(road.signal_groups)
        self._row = {str(a.id): row for row, a in enumerate(agents)}
        self._ids = np.array([a.id for a in agents], dtype=np.int64)
        self._length = np.array([a.length_m for a in agents])
        self._width = np.array([a.width_m for a in agents])
        self._kind = np.array([a.kind.code for a in agents], dtype=np.int8)
        self._pedestrian = np.array([a.kind is AgentKind.PEDESTRIAN for a in agents], dtype=bool)
        self._any_pedestrian = bool(self._pedestrian.any())
        self._axles = np.full((len(agents), 4), np.nan)
        self._areas = turning_areas(road)
        self._touching: set[tuple[int, int]] = set()
        self._events: list[Event] = []
        self._names: tuple[Sequence[str], Sequence[str]] = ((), ())
        self._present = self._look_up(*self._names)
        self._letters = [""] * len(self._plans)
        self._fixed = [self._is_fixed(plan.id) for plan in self._plans]
        self._switch_s = np.full(len(self._plans), -np.inf)
        self._signals = np.zeros(self._groups, dtype=np.int8)
        self._signals.setflags(write=False)

    def note_collisions(self, time_s: float) -> None:
        """Record the collisions of the last simulation step as events."""
        collisions = self._sumo.simulation_getCollisions()
        if not collisions and not self._touching:
            return
        touching = {(int(c.collider), int(c.victim)) for c in collisions}
        for pair in sorted(touching):
            kind = EventKind.CONTACT if pair in self._touching else EventKind.COLLISION
            self._events.append(Event(kind, time_s, *pair))
        self._touching = touching

    def names(self, again: bool) -> tuple[Sequence[str], Sequence[str]]:
        """Names of vehicles and pedestrians, the same two objects until an agent comes or goes.

        Args:
            again: whether to ask SUMO in any case; its counts leave out agents that controllers
                removed, and steps that were not read.
        """
        sumo = self._sumo
        changed = again or sumo.simulation_getDepartedNumber() or sumo.simulation_getArrivedNumber()
        if self._any_pedestrian and not changed:
            changed = sumo.simulation_getDepartedPersonNumber()
            changed = changed or sumo.simulation_getArrivedPersonNumber()
        if changed:
            persons = sumo.person_getIDList() if self._any_pedestrian else ()
            names = sumo.vehicle_getIDList(), persons
            if names != self._names:
                self._names = names
        return self._names

    def note_removed(self, agents: Sequence[int], time_s: float) -> None:
        """Record the agents that controllers removed as events."""
        rule = "stood on the wrong side"
        self._events += [Event(EventKind.REMOVAL, time_s, agent, rule=rule) for agent in agents]

    def read(self, time_s: float, walking_speeds: Mapping[str, float], again: bool) -> Frame:
        """The state now, with the events since the last frame.

        Args:
            time_s: simulated time, s.
            walking_speeds: speeds, m/s, of the pedestrians that a controller moves; SUMO does not
                know them.
            again: whether agents may have come or gone since `names` was called.
        """
        sumo = self._sumo
        vehicles, persons = self.names(again=True) if again else self._names
        present = self._present
        if vehicles is not present.vehicles or persons is not present.persons:
            present = self._present = self._look_up(vehicles, persons)
        n = present.rows.size
        places: Iterator[float] = chain.from_iterable(map(sumo.vehicle_getPosition, vehicles))
        speeds: Iterator[float] = map(sumo.vehicle_getSpeed, vehicles)
        angle = present.angle
        if persons:
            places = chain(places, chain.from_iterable(map(sumo.person_getPosition, persons)))
            walking = map(sumo.person_getSpeed, persons)
            if walking_speeds:
                walking = map(walking_speeds.get, persons, walking)
            speeds = chain(speeds, walking)
            angle = np.concatenate(
                [angle, np.fromiter(map(sumo.person_getAngle, persons), np.float64, len(persons))]
            )
        front = np.fromiter(places, np.float64, 2 * n)
        speed = np.fromiter(speeds, np.float64, n)[present.order]
        xy, heading = np.empty((n, 2)), np.empty(n)
        find_poses(
            present.order, present.rows, front, angle, self._length, self._pedestrian,
            *self._areas, self._axles, xy, heading,
        )  # fmt: skip
        for array in (xy, heading, speed):
            array.setflags(write=False)
        events, self._events = tuple(self._events), []
        return Frame(
            time_s=time_s,
            ids=present.ids,
            xy=xy,
            heading=heading,
            speed=speed,
            length=present.length,
            width=present.width,
            kind=present.kind,
            signals=self._read_signals(),
            events=events,
        )

    def _look_up(self, vehicles: Sequence[str], persons: Sequence[str]) -> _Present:
        """The agents of these names."""
        n = len(vehicles) + len(persons)
        rows = np.fromiter(map(self._row.__getitem__, chain(vehicles, persons)), np.int64, n)
        angle = np.zeros(len(vehicles))
        for i in np.flatnonzero(np.isnan(self._axles[rows[: len(vehicles)], 0])).tolist():
            angle[i] = self._sumo.vehicle_getAngle(vehicles[i])  # only needed when it departs
        order = rows.argsort()
        rows = rows[order]
        constants = (self._ids[rows], self._length[rows], self._width[rows], self._kind[rows])
        for array in constants:
            array.setflags(write=False)
        return _Present(vehicles, persons, order, rows, angle, *constants)

    def _read_signals(self) -> NDArray[np.int8]:
        """Codes of all signal groups; only lights that may have switched are asked."""
        sumo, codes = self._sumo, self._signals
        now_s = sumo.simulation_getTime() + 1e-6
        for i in np.flatnonzero(self._switch_s <= now_s).tolist():
            plan = self._plans[i]
            letters = sumo.trafficlight_getRedYellowGreenState(plan.id)
            if letters != self._letters[i]:
                self._letters[i] = letters
                if codes is self._signals:
                    codes = codes.copy()
                for group, link in zip(plan.groups, plan.links, strict=True):
                    codes[group] = signal_code(letters[link])
            if self._fixed[i]:
                self._switch_s[i] = sumo.trafficlight_getNextSwitch(plan.id)
        codes.setflags(write=False)
        self._signals = codes
        return codes

    def _is_fixed(self, lights: str) -> bool:
        """Whether lights follow one fixed-time programme, so that SUMO knows their next switch."""
        programmes = self._sumo.trafficlight_getAllProgramLogics(lights)
        return len(programmes) == 1 and programmes[0].type == TRAFFICLIGHT_TYPE_STATIC
