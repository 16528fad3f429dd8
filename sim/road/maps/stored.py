"""A road as one JSON file of ours: the map of a recording that has no map file of its own.

Datasets store in this form maps inside recordings (CommonRoad, Waymo), maps that need the
recording's origin (Lanelet2), and shifted maps. Unknown facts are stored with them.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Final, get_type_hints

import numpy as np
from pydantic import ConfigDict, ValidationError, create_model

from behaviors.errors import InputError
from sim.input_files import read_bytes
from sim.invalid_fields import first_wrong_field
from sim.road import Connection, Crossing, Lane, MapKnowledge, Road, SignalPlan
from sim.road.maps.lanelets import check_lines

SUFFIX: Final = ".road.json"
"""How the names of such files end."""

VERSION: Final = 1
"""Version of the layout of such a file."""

_STORED_TYPES: Final = {
    "centerline": list[tuple[float, float]],
    "speed_limit_mps": float | None,  # None where it is unknown
}
"""Types of fields that are stored in another form than a road has them."""


def _as_stored(part: type) -> Any:
    """Validator of a part of a road: all its fields, of their types."""
    types = get_type_hints(part) | _STORED_TYPES
    named: dict[str, Any] = {field.name: (types[field.name], ...) for field in fields(part)}
    config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
    return create_model(part.__name__, __config__=config, **named)


_PARTS: Final[dict[str, Any]] = {
    "version": (int, ...),
    "lanes": (list.__class_getitem__(_as_stored(Lane)), ...),
    "connections": (list.__class_getitem__(_as_stored(Connection)), ...),
    "crossings": (list.__class_getitem__(_as_stored(Crossing)), ...),
    "signal_groups": (tuple[str, ...], ...),
    "signal_plans": (list.__class_getitem__(_as_stored(SignalPlan)), ...),
    "knows": (_as_stored(MapKnowledge), ...),
    "left_hand": (bool, False),
}
_Stored: Final = create_model(
    "Stored", __config__=ConfigDict(strict=True, extra="forbid"), **_PARTS
)


def encode_road(road: Road) -> bytes:
    """A road as the file's content; equal roads have equal bytes, whatever they are called.

    Args:
        road: any.

    Returns:
        JSON.
    """
    stored = {
        "version": VERSION,
        "lanes": [
            {
                **_fields(lane),
                "speed_limit_mps": (
                    lane.speed_limit_mps if math.isfinite(lane.speed_limit_mps) else None
                ),
            }
            for lane in road.lanes
        ],
        "connections": [asdict(connection) for connection in road.connections],
        "crossings": [_fields(crossing) for crossing in road.crossings],
        "signal_groups": road.signal_groups,
        "signal_plans": [asdict(plan) for plan in road.signal_plans],
        "knows": asdict(road.knows),
        **({"left_hand": True} if road.left_hand else {}),
    }
    return json.dumps(stored, sort_keys=True, allow_nan=False).encode() + b"\n"


def _fields(part: Lane | Crossing) -> dict[str, Any]:
    """A part's fields, its line as lists."""
    fields = {name: getattr(part, name) for name in part.__dataclass_fields__}
    return {**fields, "centerline": part.centerline.tolist()}


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
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected a road ({SUFFIX})")
    stat = path.stat()
    return _read(path.absolute(), name, stat.st_mtime_ns, stat.st_size)


@functools.lru_cache(maxsize=16)
def _read(path: Path, name: str | None, changed_ns: int, size: int) -> Road:
    """The road in a file: read once as long as the file stays as it is."""
    try:
        stored = _Stored.model_validate_json(read_bytes(path)).model_dump()
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None
    if stored["version"] != VERSION:
        raise InputError(f"{path}: version: found {stored['version']}, expected {VERSION}")
    road = Road(
        name=name if name is not None else path.name.removesuffix(SUFFIX),
        lanes=tuple(Lane(**_with_line(lane)) for lane in stored["lanes"]),
        connections=tuple(Connection(**link) for link in stored["connections"]),
        crossings=tuple(Crossing(**_with_line(one)) for one in stored["crossings"]),
        signal_groups=stored["signal_groups"],
        source=path,
        signal_plans=tuple(SignalPlan(**plan) for plan in stored["signal_plans"]),
        knows=MapKnowledge(**stored["knows"]),
        left_hand=stored["left_hand"],
    )
    lines = [lane.centerline for lane in road.lanes]
    check_lines(path, lines + [crossing.centerline for crossing in road.crossings])
    _check_references(path, road)
    return road


def _with_line(part: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a lane or crossing, its line as an array and an unknown limit as NaN."""
    line = np.array(part["centerline"], dtype=np.float64).reshape(-1, 2)
    line.flags.writeable = False
    limit = {"speed_limit_mps": math.nan} if part.get("speed_limit_mps", 0.0) is None else {}
    return {**part, "centerline": line, **limit}


def _check_references(path: Path, road: Road) -> None:
    """Refuse lanes, ways and signals that are not there, and plans that do not fit."""

    def require(holds: bool, where: str, expected: str) -> None:
        if not holds:
            raise InputError(f"{path}: {where}: found others, expected {expected}")

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
