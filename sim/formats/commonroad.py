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
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
import pandas

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, left_out, recorded
from sim.frames import AgentKind, FloatArray
from sim.input_files import stem
from sim.road.maps.commonroad import ROOT, real, road_of
from sim.xml_tree import read_tree, whole_number, without_collection

VERSIONS: Final = ("2017a", "2018a", "2018b", "2020a")
IN_SECONDS: Final = frozenset({"2017a", "2018a"})
"""Versions that give obstacles' times in seconds."""

TYPES: Final[dict[str, AgentKind]] = {
    **{kind.value: kind for kind in AgentKind},
    **dict.fromkeys(("taxi", "parkedVehicle", "priorityVehicle", "unknown"), AgentKind.CAR),
}
"""Types of obstacles that are road-agents; the others (buildings, pillars, ...) are left out."""

OBSTACLES: Final = ("obstacle", "dynamicObstacle", "staticObstacle")

DECIMALS: Final = 6
"""Decimals to which times are rounded, so that two obstacles at one step have the same time, s."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of one scenario, ``.xml`` or ``.xml.gz``, with its road."""
    with without_collection():
        recording = _recording(path)
    yield recording


def _recording(path: Path) -> Recording:
    """Read the file's content; its XML tree is freed when this returns."""
    root = read_tree(path)
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
    rows, notes = _rows(path, root, 1.0 if version in IN_SECONDS else step_s)
    road = road_of(path, root)
    if road is not None and road.knows.unknown:
        notes.append(f"not in the map: {', '.join(road.knows.unknown)}")
    found = recorded(stem(path), rows, notes, road, own_road=True)
    if road is None or not road.signal_groups:
        return found
    shown = [
        [code for plan in road.signal_plans for code in plan.state_at(float(time_s))]
        for time_s in found.tracks.time_s
    ]
    signals = np.array(shown, dtype=np.int8).T
    return replace(found, tracks=replace(found.tracks, signals=signals))


def _rows(path: Path, root: Element, unit_s: float) -> tuple[pandas.DataFrame, list[str]]:
    """The rows of the obstacles, and notes on what was assumed."""
    found: dict[str, tuple[FloatArray, bool, AgentKind, tuple[float, float]]] = {}
    others: set[str] = set()
    for element in (one for one in root if one.tag in OBSTACLES):
        name = str(whole_number(path, element, "id"))
        word = (element.findtext("type") or "without a type").strip()
        if word not in TYPES:
            others.add(word[:40])
            continue
        if name in found:
            raise InputError(f"{path}: found obstacle {name} twice, expected it once")
        states, moves = _states(path, element, name)
        states[:, 0] = np.round(states[:, 0] * unit_s, DECIMALS)
        # one that drives backwards: the format's speed has a sign, ours none
        states[:, 4] = np.abs(states[:, 4])
        found[name] = states, moves, TYPES[word], _size(path, element, name)
    times = np.unique([t for states, moves, *_ in found.values() if moves for t in states[:, 0]])
    tables = [np.zeros((0, 5))]
    for states, moves, *_ in found.values():
        if not moves:  # those that stand have one state, which lasts
            states = np.repeat(states, max(times.size, 1), axis=0)
            states[:, 0] = times if times.size else 0.0
            states[:, 4] = 0.0
        tables.append(states)
    rows = pandas.DataFrame(np.concatenate(tables), columns=["t", "x", "y", "heading", "speed"])
    facts = pandas.DataFrame(
        [(name, kind.code, *size) for name, (_, _, kind, size) in found.items()],
        columns=["id", "kind", "length", "width"],
    )
    facts = facts.loc[np.repeat(facts.index, [len(table) for table in tables[1:]])]
    notes = left_out(others)
    if (facts["length"] * facts["width"] == 0).any():
        notes.append("those without a size have the one usual for their kind")
    return rows.join(facts.reset_index(drop=True)), notes


def _states(path: Path, element: Element, name: str) -> tuple[FloatArray, bool]:
    """(k, 5) time, x, y, heading and speed of an obstacle's states; does it move?"""
    parts = [
        np.reshape([_row(path, one, f"obstacle {name}") for one in element.iterfind(tag)], (-1, 5))
        for tag in ("initialState", "trajectory/state")
    ]
    if np.isin(parts[0][:, 0], parts[1][:, 0]).any():
        parts = parts[1:]  # the initial state is the trajectory's first one, too
    table = np.concatenate(parts)
    if not len(table):
        raise InputError(f"{path}: obstacle {name}: found no state, expected a trajectory")
    static = "static" in ((element.findtext("role") or "").strip(), element.tag[:6])
    return table, not (static and len(table) == 1)


def _row(path: Path, state: Element, what: str) -> list[float]:
    """Time, x, y, heading and speed of a state; NaN for a heading or speed that it lacks."""
    # of an uncertain position, a rectangle or a circle, the centre
    point, centre = state.find("position//point"), state.find("position//center")
    place = centre if point is None else point
    if place is None or state.find("time") is None:
        raise InputError(f"{path}: {what}: found a state without time or place")
    x, y = (real(path, place.findtext(axis), f"{what} {axis}") for axis in "xy")
    time, heading, speed = (_value(path, state.find(part), what)
                            for part in ("time", "orientation", "velocity"))  # fmt: skip
    return [time, x, y, heading, speed]


def _value(path: Path, part: Element | None, what: str) -> float:
    """An exact value, or the middle of an interval; NaN where there is none."""
    if part is None:
        return math.nan
    exact = part.findtext("exact")
    bounds = [exact] if exact else [part.findtext(f"interval{end}") for end in ("Start", "End")]
    return sum(real(path, bound, f"{what} {part.tag}") for bound in bounds) / len(bounds)


def _size(path: Path, element: Element, name: str) -> tuple[float, float]:
    """Length and width, m; 0 where the file does not say them."""
    box, radius = element.find("shape/rectangle"), element.findtext("shape/circle/radius")
    if box is not None:
        length, width = (
            real(path, box.findtext(side), f"obstacle {name} {side}")
            for side in ("length", "width")
        )
        return length, width
    across = 2 * real(path, radius, f"obstacle {name} radius") if radius is not None else 0.0
    return across, across
