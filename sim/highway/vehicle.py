"""Rows of agents, and the objects that show them to others, as vehicles of highway-env.

The rows are the truth; compiled functions read and write them. An object is a view of one row, made
when somebody looks. Ego vehicles alone are highway-env's own.

Differs from highway-env: others see a decided lane change from the next step on, so that no
decision depends on the order in which vehicles act; vehicles do not drive backwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.objects import Landmark
from numpy.typing import NDArray

from behaviors.labels import Behavior
from sim.frames import FloatArray
from sim.highway import driving
from sim.highway.driving import driver_key, profile_fields, wait_s
from sim.highway.lanes import PolylineLane
from sim.highway.state import Records, blank_vehicles
from sim.scenario import AgentSpec, CarFollowing

LEAST_ROOM: Final = 16
"""Arrays have room for this many agents at first."""

DRAWN_TIMES: Final = (
    ("cut_in_at", "cut_ins", driving.CUTS_IN, "cut_in_rate_per_min"),
    ("stop_at", "stops", driving.STOPS, "stop_rate_per_min"),
    ("lapse_at", "lapses", driving.LAPSES, "lapse_rate_per_min"),
    ("wrong_way_at", "wrong_ways", driving.WRONG_WAY, "wrong_way_rate_per_min"),
)
"""Times that are drawn: their field, the count of such draws, what is drawn, and how often."""


def driver_rows(agents: Sequence[AgentSpec], seed: int, law: CarFollowing = "IDM") -> Records:
    """(n,) rows of `VEHICLE` of drivers that are on no road yet."""
    rows = blank_vehicles(len(agents))
    rows["profiled"] = True
    drivers = [
        {
            "agent": one.id, "kind": one.kind.code, "length": one.length_m, "width": one.width_m,
            "key": driver_key((seed, one.seed)), **profile_fields(one.profile, one.kind, law),
        }
        for one in agents
        if one.profile is not None
    ]  # fmt: skip
    for name in drivers[0] if drivers else ():
        rows[name] = [driver[name] for driver in drivers]
    for at, count, kind, rate in DRAWN_TIMES:
        pairs = zip(rows["key"], rows[rate].tolist(), strict=True)
        rows[at] = [wait_s(key, kind, 0, per_minute) for key, per_minute in pairs]
        rows[count] = 1
    return rows


def _column(name: str, kind: type) -> Any:
    """A property that shows a field of an object's row as a Python value."""
    return property(lambda self: kind(self.table[name][self.row]))


def _lane_column(name: str) -> Any:
    """A property that shows the number of a lane as highway-env's index of it."""
    return property(lambda self: self.road.network.keys[self.table[name][self.row]])


class RowView:
    """Shows the ``row`` of that number in a ``table`` as an object of highway-env."""

    table: Records
    row: int
    heading = _column("heading", float)
    speed = _column("speed", float)
    LENGTH = _column("length", float)
    WIDTH = _column("width", float)
    agent = _column("agent", int)
    crashed = _column("crashed", bool)

    def __init__(self, road: Any) -> None:
        self.road = road

    @property
    def position(self) -> FloatArray:
        """(2,) its place, m, in highway-env's axes."""
        return np.array([self.table["x"][self.row], self.table["y"][self.row]])


class ProfileVehicle(RowView, ControlledVehicle):  # type: ignore[misc]
    """A vehicle driven by a `Profile`."""

    lane_index = _lane_column("lane")
    target_lane_index = _lane_column("target")
    target_speed = _column("entry_speed", float)
    route = None

    @property
    def lane(self) -> PolylineLane:
        """The lane it is on."""
        found: PolylineLane = self.road.network.lanes[self.lane_index]
        return found

    @property
    def behavior(self) -> Behavior | None:
        """The driver's true behaviour, for colours and labels only."""
        found: Behavior | None = self.road.behaviors.get(self.agent)
        return found


class Walker(RowView, Landmark):  # type: ignore[misc]
    """A pedestrian."""

    lane_index = lane = behavior = None
    collidable = solid = False


class Crowd:
    """Agents of one kind: a row of that type for each, and an object of those looked at."""

    def __init__(self, road: Any, kind: np.dtype[Any], view: type[RowView]) -> None:
        self._road, self._view = road, view
        self._array: Records = np.zeros(LEAST_ROOM, kind)
        self.rows, self.seen = self._array[:0], dict[int, Any]()

    def add(self, row: Any, one: Any = None) -> None:
        """Add an agent with its first row, and its object if it is none of ours."""
        n = len(self.rows)
        if n == len(self._array):
            self._renew(self.rows, 2 * n)
        self._array[n] = row
        self._take(n + 1)
        if one is not None:
            self.seen[one.agent] = one
            one.table, one.row = self._array, n

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Keep some of the agents; objects of those who leave show their last row."""
        self._renew(self.rows[stays], len(self._array))

    def _renew(self, rows: Records, room: int) -> None:
        """Put rows into a new array; objects of those who have left show the old one."""
        self._array = np.zeros(room, rows.dtype)
        self._array[: len(rows)] = rows
        self._take(len(rows))

    def _take(self, n: int) -> None:
        """Take the first n rows, and tell the objects which of them they show."""
        self.rows = self._array[:n]
        if self.seen:
            row_of = {agent: row for row, agent in enumerate(self.rows["agent"].tolist())}
            self.seen = {agent: one for agent, one in self.seen.items() if agent in row_of}
            for agent, one in self.seen.items():
                one.table, one.row = self._array, row_of[agent]

    @property
    def objects(self) -> list[Any]:
        """The objects of all, in the order of rows."""
        for row, agent in enumerate(self.rows["agent"].tolist()):
            if agent not in self.seen:
                one = self.seen[agent] = self._view(self._road)
                one.table, one.row = self._array, row
        return [self.seen[agent] for agent in self.rows["agent"].tolist()]
