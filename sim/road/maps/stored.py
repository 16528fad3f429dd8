"""A road as one JSON file of ours: the map of a recording that has no map file of its own.

Maps inside recordings (CommonRoad, Waymo), maps that need the recording's origin (Lanelet2) and
maps that were shifted onto the tracks are stored so in datasets, with what they do not know.
"""

from __future__ import annotations

import functools
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from behaviors.errors import InputError
from sim.frames import SIGNALS
from sim.road import Connection, Crossing, Lane, MapKnowledge, Road, SignalPlan
from sim.road.maps.lanelets import MAX_COORDINATE_M, check_length
from sim.xml_tree import read_bytes

SUFFIX: Final = ".road.json"
"""How the names of such files end."""

VERSION: Final = 1
"""Version of the layout of such a file."""

_Number = Annotated[float, Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M, allow_inf_nan=False)]
_Name = Annotated[str, Field(max_length=200)]
_Index = Annotated[int, Field(ge=-1, le=10**6)]
_Line = Annotated[list[tuple[_Number, _Number]], Field(min_length=2)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class _Lane(_Part):
    id: _Name
    edge: _Name
    index: _Index
    centerline: _Line
    width_m: Annotated[float, Field(ge=0, le=1e4)]
    speed_limit_mps: Annotated[float, Field(gt=0, le=1e3)] | None
    walking: bool
    internal: bool
    opposite: _Name
    cars: bool


class _Connection(_Part):
    from_lane: _Name
    to_lane: _Name
    via: tuple[_Name, ...]
    direction: Literal["straight", "left", "right", "turnaround"]
    signal: _Index
    must_yield: bool
    must_stop: bool
    yields_to: tuple[_Index, ...]


class _Crossing(_Part):
    id: _Name
    centerline: _Line
    width_m: Annotated[float, Field(ge=0, le=1e4)]
    edges: tuple[_Name, ...]
    signal: _Index
    priority: bool


class _Plan(_Part):
    id: _Name
    groups: tuple[_Index, ...]
    links: tuple[_Index, ...]
    duration_s: tuple[Annotated[float, Field(gt=0, le=1e6)], ...]
    states: tuple[tuple[Annotated[int, Field(ge=0, lt=len(SIGNALS))], ...], ...]
    offset_s: _Number


class _Knows(_Part):
    limits: bool
    signals: bool
    priority: bool
    limits_rule: bool


class _Stored(_Part):
    version: Literal[1]
    lanes: Annotated[list[_Lane], Field(min_length=1)]
    connections: list[_Connection]
    crossings: list[_Crossing]
    signal_groups: tuple[_Name, ...]
    signal_plans: list[_Plan]
    knows: _Knows


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
        InputError: if the file is missing, too large or broken; names the place in it.
    """
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected a road ({SUFFIX})")
    stat = path.stat()
    return _read(path.absolute(), name, stat.st_mtime_ns, stat.st_size)


@functools.lru_cache(maxsize=16)
def _read(path: Path, name: str | None, changed_ns: int, size: int) -> Road:
    """The road in a file: read once as long as the file stays as it is."""
    try:
        stored = _Stored.model_validate_json(read_bytes(path))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])[:200] or "JSON"
        raise InputError(f"{path}: {where}: {' '.join(first['msg'].split())}") from None
    lanes = tuple(
        Lane(
            **{
                **lane.model_dump(),
                "centerline": _line(lane.centerline),
                "speed_limit_mps": (
                    math.nan if lane.speed_limit_mps is None else lane.speed_limit_mps
                ),
            }
        )
        for lane in stored.lanes
    )
    crossings = tuple(
        Crossing(**{**crossing.model_dump(), "centerline": _line(crossing.centerline)})
        for crossing in stored.crossings
    )
    check_length(path, [lane.centerline for lane in lanes] + [c.centerline for c in crossings])
    _check_references(path, stored)
    return Road(
        name=name if name is not None else path.name.removesuffix(SUFFIX),
        lanes=lanes,
        connections=tuple(Connection(**c.model_dump()) for c in stored.connections),
        crossings=crossings,
        signal_groups=stored.signal_groups,
        source=path,
        signal_plans=tuple(SignalPlan(**plan.model_dump()) for plan in stored.signal_plans),
        knows=MapKnowledge(**stored.knows.model_dump()),
    )


def _line(points: list[tuple[float, float]]) -> np.ndarray:
    line = np.array(points, dtype=np.float64)
    line.flags.writeable = False
    return line


def _check_references(path: Path, stored: _Stored) -> None:
    """Refuse lanes, ways and signals that are not there."""
    lanes = {lane.id for lane in stored.lanes}
    if len(lanes) != len(stored.lanes):
        raise InputError(f"{path}: lanes: found an id twice, expected each once")
    for way in stored.connections:
        missing = {way.from_lane, *way.via, way.to_lane} - lanes
        if missing:
            raise InputError(f"{path}: connections: found {min(missing)!r:.60}, expected a lane")
        if any(not 0 <= i < len(stored.connections) for i in way.yields_to):
            raise InputError(f"{path}: yields_to: found a way that is not there")
    groups = len(stored.signal_groups)
    used = [way.signal for way in stored.connections] + [c.signal for c in stored.crossings]
    controlled = [group for plan in stored.signal_plans for group in plan.groups]
    if len(set(controlled)) != len(controlled):
        raise InputError(f"{path}: signal_plans: found a group twice, expected one plan for each")
    used += controlled
    for plan in stored.signal_plans:
        if not plan.duration_s or len(plan.duration_s) != len(plan.states):
            raise InputError(f"{path}: signal_plans: found durations that do not fit the states")
        if any(len(state) != len(plan.groups) for state in plan.states):
            raise InputError(f"{path}: signal_plans: found states that do not fit the groups")
    if any(signal >= groups for signal in used):
        raise InputError(f"{path}: signals: found a group beyond the {groups} there are")
