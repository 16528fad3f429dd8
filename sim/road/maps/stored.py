"""A road as one JSON file of ours: the map of a recording that has no map file of its own.

Datasets store in this form maps inside recordings (CommonRoad, Waymo), maps that need the
recording's origin (Lanelet2), and shifted maps. Unknown facts are stored with them.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.input_files import broken_as_one_line, read_bytes, read_once
from sim.road import Connection, Crossing, Lane, MapKnowledge, Road, SignalPlan
from sim.road.maps.lanelets import check_lines

SUFFIX: Final = ".road.json"
"""How the names of such files end."""

VERSION: Final = 1
"""Version of the layout of such a file."""


def encode_road(road: Road) -> bytes:
    """A road as the file's content; equal roads have equal bytes, whatever they are called."""
    stored = {
        "version": VERSION,
        "lanes": [_fields(lane) for lane in road.lanes],
        "connections": [asdict(connection) for connection in road.connections],
        "crossings": [_fields(crossing) for crossing in road.crossings],
        "signal_groups": road.signal_groups,
        "signal_plans": [asdict(plan) for plan in road.signal_plans],
        "knows": asdict(road.knows),
        **({"left_hand": True} if road.left_hand else {}),
    }
    return json.dumps(stored, sort_keys=True, allow_nan=False).encode() + b"\n"


def _fields(part: Lane | Crossing) -> dict[str, Any]:
    """A part's fields, its line as lists and an unknown limit as None."""
    fields = {name: getattr(part, name) for name in part.__dataclass_fields__}
    if not math.isfinite(fields.get("speed_limit_mps", 0.0)):
        fields["speed_limit_mps"] = None
    return {**fields, "centerline": part.centerline.tolist()}


@read_once
def read_stored(path: Path, name: str | None = None) -> Road:
    """Read such a file.

    Args:
        path: ``....road.json``.
        name: what to call the road; by default the file's name without its ending.

    Returns:
        The road as it was.

    Raises:
        InputError: if the file is missing or broken; names the place in it.
    """
    with broken_as_one_line(path, "a road of a dataset"):
        stored = json.loads(read_bytes(path))
        if stored["version"] != VERSION:
            raise InputError(f"version: found {stored['version']!r:.40}, expected {VERSION}")
        road = Road(
            name=name if name is not None else path.name.removesuffix(SUFFIX),
            lanes=tuple(Lane(**_with_line(lane)) for lane in stored["lanes"]),
            connections=tuple(Connection(**_tuples(link)) for link in stored["connections"]),
            crossings=tuple(Crossing(**_with_line(one)) for one in stored["crossings"]),
            signal_groups=tuple(stored["signal_groups"]),
            source=path,
            signal_plans=tuple(SignalPlan(**_tuples(plan)) for plan in stored["signal_plans"]),
            knows=MapKnowledge(**stored["knows"]),
            left_hand=stored.get("left_hand", False),
        )
        lines = [lane.centerline for lane in road.lanes]
        check_lines(path, lines + [crossing.centerline for crossing in road.crossings])
        _check_references(road)
    return road


def _tuples(value: Any) -> Any:
    """Lists as tuples, those inside others, too."""
    if isinstance(value, dict):
        return {name: _tuples(part) for name, part in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _with_line(part: dict[str, Any]) -> dict[str, Any]:
    """The fields of a lane or crossing, its line as an array and an unknown limit as NaN."""
    line = frozen(np.array(part["centerline"], dtype=np.float64).reshape(-1, 2))
    limit = {"speed_limit_mps": math.nan} if part.get("speed_limit_mps", 0.0) is None else {}
    return {**_tuples(part), "centerline": line, **limit}


def _check_references(road: Road) -> None:
    """Refuse lanes, ways and signals that are not there, and plans that do not fit."""

    def require(holds: bool, where: str, expected: str) -> None:
        if not holds:
            raise InputError(f"{where}: found others, expected {expected}")

    require(0 < len(road.lane_index) == len(road.lanes), "lanes", "each id once")
    ways, groups = len(road.connections), len(road.signal_groups)
    for way in road.connections:
        named = {way.from_lane, *way.via, way.to_lane}
        require(named <= road.lane_index.keys(), "connections", "lanes of the road")
        require(all(0 <= i < ways for i in way.yields_to), "yields_to", "ways of the road")
    controlled = [group for plan in road.signal_plans for group in plan.groups]
    used = [way.signal for way in road.connections] + [c.signal for c in road.crossings]
    require(all(-1 <= i < groups for i in used), "signals", f"one of the {groups} groups")
    require(sorted(controlled) == sorted({*controlled} & {*range(groups)}), "signal_plans",
            "each group once")  # fmt: skip
    for plan in road.signal_plans:
        fits = len(plan.duration_s) == len(plan.states) > 0 and min(plan.duration_s) > 0
        fits &= all(len(state) == len(plan.groups) for state in plan.states)
        require(fits, "signal_plans", "a duration above 0 and a state of each group per phase")
