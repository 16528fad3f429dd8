"""CommonRoad scenarios (XML, 2017a to 2020a): obstacles as a recording, lanelets as its map.

Times of obstacles are seconds in 2017a and 2018a and steps of ``timeStepSize`` later. Positions are
centres, orientations radians, velocities m/s along the orientation. The vehicle that a planner is
to drive is not recorded and not read.

References:
    Althoff, Koschi, Manzinger (2017), CommonRoad: composable benchmarks for motion planning on
    roads, IEEE IV; its XML documentation, 2017a to 2020a.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
import pandas

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, left_out, recorded
from sim.frames import AgentKind
from sim.input_files import read_tree, stem, without_collection
from sim.road.maps.commonroad_lanelets import road_of

VERSIONS: Final = {"2017a": True, "2018a": True, "2018b": False, "2020a": False}
"""Whether each version gives obstacles' times in seconds."""

TYPES: Final[dict[str, AgentKind]] = {
    **{kind.value: kind for kind in AgentKind},
    **dict.fromkeys(("taxi", "parkedVehicle", "priorityVehicle", "unknown"), AgentKind.CAR),
}
"""Types of obstacles that are road-agents; the others (buildings, pillars, ...) are left out."""

OBSTACLES: Final = ("obstacle", "dynamicObstacle", "staticObstacle")

STATE: Final = ("t", "x", "y", "heading", "speed")
"""What is read of an obstacle's states."""

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
    version = root.get("commonRoadVersion", "")
    if version not in VERSIONS:
        raise InputError(
            f"{path}: commonRoadVersion: found {version[:40]!r}, expected one of "
            f"{', '.join(VERSIONS)}"
        )
    rows, notes = _rows(root, 1.0 if VERSIONS[version] else float(root.attrib["timeStepSize"]))
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


def _rows(root: Element, unit_s: float) -> tuple[pandas.DataFrame, list[str]]:
    """The rows of the obstacles, and notes on what was assumed."""
    found, others = list[tuple[object, ...]](), set[str]()
    for element in (one for one in root if one.tag in OBSTACLES):
        word = element.findtext("type", "without a type").strip()
        if word not in TYPES:
            others.add(word[:40])
            continue
        states = _states(element)
        static = "static" in (element.findtext("role", "").strip(), element.tag[:6])
        facts = element.attrib["id"].strip(), TYPES[word].code, *_size(element)
        found += [(*state, *facts, static and len(states) == 1) for state in states]
    if not found:
        raise InputError("found no obstacle that is a road-agent, expected at least one")
    columns = [*STATE, "id", "kind", "length", "width", "stands"]
    rows = pandas.DataFrame(found, columns=columns)
    rows["t"] = np.round(rows["t"] * unit_s, DECIMALS)
    # one that drives backwards: the format's speed has a sign, ours none
    rows["speed"] = rows["speed"].abs()
    moving = rows[~rows["stands"]]
    # those that stand have one state, which lasts
    times = pandas.DataFrame({"t": moving["t"].unique() if len(moving) else [0.0]})
    standing = rows[rows["stands"]].drop(columns="t").merge(times, how="cross").assign(speed=0.0)
    notes = left_out(others)
    if rows[["length", "width"]].isna().any(axis=None):
        notes.append("those without a size have the one usual for their kind")
    return pandas.concat([moving, standing], ignore_index=True), notes


def _states(element: Element) -> list[list[float]]:
    """`STATE` of an obstacle at each time; NaN for what is not there."""
    first, later = (
        [[_value(one, "time"), *_place(one), _value(one, "orientation"), _value(one, "velocity")]
         for one in element.iterfind(tag)]
        for tag in ("initialState", "trajectory/state")
    )  # fmt: skip
    # the initial state may be the trajectory's first one, too
    return [one for one in first if one[0] not in {state[0] for state in later}] + later


def _place(state: Element) -> list[float]:
    """X and y; of an uncertain position, a rectangle or a circle, the centre."""
    parts = [f"position//{part}" for part in ("point", "center")]
    return [_number(state, *(f"{part}/{axis}" for part in parts)) for axis in "xy"]


def _value(state: Element, name: str) -> float:
    """An exact value, or the middle of an interval."""
    return sum(_number(state, f"{name}/exact", f"{name}/interval{e}") for e in ("Start", "End")) / 2


def _size(element: Element) -> tuple[float, float]:
    """Length and width, m; NaN where the file does not say them."""
    across = 2 * _number(element, "shape/circle/radius")
    length, width = (_number(element, f"shape/rectangle/{side}") for side in ("length", "width"))
    return (across, across) if np.isnan(length) else (length, width)


def _number(element: Element, *places: str) -> float:
    """The number at the first of some places that an element has; NaN where it has none."""
    texts = (element.findtext(place) for place in places)
    return float(next(filter(None, texts), "nan"))
