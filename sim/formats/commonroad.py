"""CommonRoad scenarios (XML, 2017a to 2020a): obstacles as a recording, lanelets as its map.

Times of obstacles are seconds in 2017a and 2018a and steps of ``timeStepSize`` later. Positions are
centres, orientations radians, velocities m/s along the orientation. The vehicle that a planner is
to drive is not recorded and not read.

References:
    Althoff, Koschi, Manzinger (2017), CommonRoad: composable benchmarks for motion planning on
    roads, IEEE IV; its XML documentation, 2017a to 2020a.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.recording import (
    MAX_ROWS,
    Recording,
    Rows,
    assemble,
    default_size,
    kind_codes,
)
from sim.formats.common.state_runs import RUN, StateRuns
from sim.frames import AgentKind, Tracks
from sim.road import Road
from sim.road.maps.commonroad import ROOT, real, road_of
from sim.road.maps.lanelets import MAX_COORDINATE_M
from sim.xml_tree import read_tree, whole_number, without_collection

ONCE: Final = ("role", "type", "shape", "initialState", "trajectory")
"""Elements of which an obstacle has one at most."""

VERSIONS: Final = ("2017a", "2018a", "2018b", "2020a")
IN_SECONDS: Final = frozenset({"2017a", "2018a"})
"""Versions that give obstacles' times in seconds."""

TYPES: Final[dict[str, AgentKind]] = {
    "car": AgentKind.CAR,
    "taxi": AgentKind.CAR,
    "parkedVehicle": AgentKind.CAR,
    "priorityVehicle": AgentKind.CAR,
    "truck": AgentKind.TRUCK,
    "bus": AgentKind.BUS,
    "motorcycle": AgentKind.MOTORCYCLE,
    "bicycle": AgentKind.BICYCLE,
    "pedestrian": AgentKind.PEDESTRIAN,
    "unknown": AgentKind.CAR,
}
"""Types of obstacles that are road-agents; the others (buildings, pillars, ...) are left out."""

OBSTACLES: Final = ("obstacle", "dynamicObstacle", "staticObstacle")

DECIMALS: Final = 6
"""Decimals to which times are rounded, so that two obstacles at one step have the same time, s."""


def read(path: Path) -> Iterator[Recording]:
    """Read one scenario.

    Args:
        path: ``.xml`` or ``.xml.gz``.

    Yields:
        One recording with its road.

    Raises:
        InputError: if the file is broken, or has no obstacle; names the file and the element.
    """
    with without_collection():
        recording = _recording(path)
    yield recording


def _recording(path: Path) -> Recording:
    """Read the file's content; its XML tree is freed when this returns."""
    runs = StateRuns(MAX_COORDINATE_M)
    root = read_tree(path, runs.cut)
    if root.tag != ROOT:
        raise InputError(f"{path}: found element {root.tag[:60]!r}, expected {ROOT}")
    version = root.get("commonRoadVersion", "")
    if version not in VERSIONS:
        raise InputError(
            f"{path}: commonRoadVersion: found {version[:40]!r}, expected one of "
            f"{', '.join(VERSIONS)}"
        )
    step_s = real(path, root.get("timeStepSize"), "timeStepSize")
    if step_s <= 0:
        raise InputError(f"{path}: timeStepSize: found {step_s:g}, expected more than 0")
    found = _Obstacles(path, 1.0 if version in IN_SECONDS else step_s, runs)
    for element in root:
        if element.tag in OBSTACLES:
            found.add(element)
    road = road_of(path, root)
    name = path.name.removesuffix(".gz").removesuffix(".xml")
    tracks, notes = found.tracks()
    if road is not None:
        tracks = _lit(tracks, road)
        if road.knows.unknown:
            notes.append(f"not in the map: {', '.join(road.knows.unknown)}")
    return Recording(name, tracks, tuple(notes), road)


def _lit(tracks: Tracks, road: Road) -> Tracks:
    """The tracks with the states of the map's lights at each time."""
    if not road.signal_groups:
        return tracks
    shown = [
        [code for plan in road.signal_plans for code in plan.state_at(float(time_s))]
        for time_s in tracks.time_s
    ]
    return tracks.changed(signals=np.array(shown, dtype=np.int8).T)


class _Obstacles:
    """Gathers the states of the obstacles."""

    def __init__(self, path: Path, unit_s: float, runs: StateRuns) -> None:
        self.path = path
        self.runs = runs
        self.unit_s = unit_s
        self.names: dict[str, None] = {}
        self.kinds: list[AgentKind] = []
        self.sizes: list[tuple[float, float]] = []
        self.agent: list[int] = []
        self.tables: list[NDArray[np.float64]] = []  # time, x, y, heading, speed
        self.standing: list[tuple[int, tuple[float, float, float, float, float]]] = []
        self.left_out: set[str] = set()
        self.unsized = 0

    def add(self, element: Element) -> None:
        """One obstacle."""
        identity = str(whole_number(self.path, element, "id"))
        word = (element.findtext("type") or "").strip()
        kind = TYPES.get(word)
        if kind is None:
            self.left_out.add(word[:40])
            return
        what = f"obstacle {identity}"
        index = len(self.names)
        if identity in self.names:
            raise InputError(f"{self.path}: found {what} twice, expected it once")
        self.names[identity] = None
        self.kinds.append(kind)
        self.sizes.append(self._size(element, kind, what))
        self._each_once([part for part in element if part.tag in ONCE], what)
        inside = next((part.tag for part in element if part.tag.lower().endswith("obstacle")), None)
        if inside is not None:
            raise InputError(f"{self.path}: {what}: found {inside} inside, expected it beside")
        initial = element.find("initialState")
        states = element.findall("trajectory/*")
        tags = ("state", RUN) if self.runs.tables else ("state",)
        states = [state for state in states if state.tag in tags]
        role = (element.findtext("role") or "").strip()
        if not states and initial is not None and "static" in (role, element.tag[:6]):
            row = self._row(initial, what)
            self.standing.append((index, (*row[:4], 0.0)))
            return
        if initial is not None:
            states = [initial, *states]
        if not states:
            raise InputError(f"{self.path}: {what}: found no state, expected a trajectory")
        for whole, part in groupby(states, key=lambda state: state.tag == RUN):
            if whole:
                tables = [self._run(run) for run in part]
            else:
                tables = [np.array([self._row(state, what) for state in part])]
            self.tables += tables
            self.agent += [index] * sum(map(len, tables))
        if len(self.agent) > MAX_ROWS:
            raise InputError(f"{self.path}: found more than {MAX_ROWS} states")

    def _each_once(self, parts: Iterable[Element], what: str) -> None:
        """Refuse two elements of one name, because only one of them would be read."""
        names = [part.tag for part in parts]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{self.path}: {what}: found {twice} twice, expected it once")

    def _run(self, element: Element) -> NDArray[np.float64]:
        """(k, 5) the states of a run, each as `_row` has it."""
        table = self.runs.tables[whole_number(self.path, element, "number")]
        table[:, 0] = [round(time * self.unit_s, DECIMALS) for time in table[:, 0].tolist()]
        table[:, 4] = np.where(table[:, 4] < 0, -table[:, 4], table[:, 4])
        return table

    def _row(self, state: Element, what: str) -> tuple[float, float, float, float, float]:
        """Time, x, y, heading and speed of a state; NaN for a heading or speed that it lacks."""
        self._each_once(state, what)
        x = y = time = None
        heading = speed = math.nan
        for part in state:
            tag = part.tag
            if tag == "position":
                for point in part.iter("point"):
                    x, y = point.findtext("x"), point.findtext("y")
                    break
                else:
                    x, y = _center(part)
            elif tag == "orientation":
                heading = self._value(part, what)
            elif tag == "time":
                time = self._value(part, what)
            elif tag == "velocity":
                speed = self._value(part, what)
        if time is None or x is None or y is None:
            raise InputError(f"{self.path}: {what}: found a state without time or place")
        if speed < 0:  # it drives backwards: the format's speed has a sign, ours none
            speed = -speed
        return (
            round(time * self.unit_s, DECIMALS),
            real(self.path, x, what),
            real(self.path, y, what),
            heading,
            speed,
        )

    def _value(self, part: Element, what: str) -> float:
        """An exact value, or the middle of an interval."""
        first = part[0] if len(part) else None
        if first is not None and first.tag == "exact":
            return real(self.path, first.text, f"{what} {part.tag}")
        low, high = part.findtext("intervalStart"), part.findtext("intervalEnd")
        name = f"{what} {part.tag}"
        return (real(self.path, low, name) + real(self.path, high, name)) / 2

    def _size(self, element: Element, kind: AgentKind, what: str) -> tuple[float, float]:
        shape = element.find("shape")
        if shape is not None:
            box, circle = shape.find("rectangle"), shape.find("circle")
            if box is not None:
                length, width = (
                    real(self.path, box.findtext(side), f"{what} {side}")
                    for side in ("length", "width")
                )
                return length, width
            if circle is not None:
                across = 2 * real(self.path, circle.findtext("radius"), f"{what} radius")
                return across, across
        self.unsized += 1
        return default_size(kind)

    def tracks(self) -> tuple[Tracks, list[str]]:
        """The obstacles as tracks, and notes on what was assumed."""
        table = np.concatenate([np.zeros((0, 5)), *self.tables])
        agent = np.array(self.agent, dtype=np.int64)
        if self.standing:
            times = np.unique(table[:, 0]) if len(table) else np.zeros(1)
            if len(self.standing) * times.size > MAX_ROWS:
                raise InputError(f"{self.path}: found more than {MAX_ROWS} obstacles times steps")
            stood = np.array([row for _, row in self.standing])
            rows = np.repeat(stood, times.size, axis=0)
            rows[:, 0] = np.tile(times, len(stood))
            table = np.concatenate([table, rows])
            agent = np.append(agent, np.repeat([i for i, _ in self.standing], times.size))
        sizes = np.array(self.sizes).reshape(-1, 2)
        tracks = assemble(
            self.path,
            Rows(
                agent=agent,
                names=tuple(self.names),
                time_s=table[:, 0],
                x=table[:, 1],
                y=table[:, 2],
                heading=table[:, 3],
                speed=table[:, 4],
                length=sizes[:, 0],
                width=sizes[:, 1],
                kind=kind_codes(self.kinds),
            ),
        )
        notes = []
        if self.left_out:
            names = ", ".join(sorted(self.left_out)) or "without a type"
            notes.append(f"left out, because they are not road-agents: {names}")
        if self.unsized:
            notes.append("those without a size have the one usual for their kind")
        return tracks, notes


def _center(position: Element) -> tuple[str | None, str | None]:
    """The centre of an uncertain position, a rectangle or a circle."""
    for center in position.iter("center"):
        return center.findtext("x"), center.findtext("y")
    return None, None
