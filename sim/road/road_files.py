"""Reads a road from a file: a SUMO net, the map of a recording, or a road that a dataset keeps.

Datasets keep roads as JSON: maps inside recordings (CommonRoad, Waymo), maps that need the
recording's origin (Lanelet2), and shifted maps. Unknown facts are stored with them.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.input_files import broken_as_one_line, opened, read_bytes, read_once
from sim.road import Connection, Crossing, Lane, MapKnowledge, Road, SignalPlan

SUFFIX: Final = ".road.json"
"""How the names of roads end that datasets keep."""

ENDINGS: Final = (SUFFIX, ".json", ".net.xml")
"""Endings of the roads in a dataset, in the order in which they are looked for; the second one is
that of Argoverse 2 maps."""

PARTS: Final[dict[str, Any]] = {
    "lanes": Lane, "connections": Connection, "crossings": Crossing, "signal_plans": SignalPlan
}  # fmt: skip
"""The kinds of a road's parts, by its fields."""

VERSION: Final = 1
"""Version of the layout of a dataset's road."""

ROOT_BYTES: Final = 4096
"""Bytes of an XML file that are read to find its root element."""


def read_road_file(
    path: Path, name: str | None = None, origin: tuple[float, float] | None = None
) -> Road:
    """Read a road.

    Args:
        path: a SUMO net (``.net.xml``), an Argoverse 2 map (``.json``), a CommonRoad scenario
            (``.xml``), a Lanelet2 map (``.osm``), or a road that a dataset keeps
            (``.road.json``); XML may be gzipped.
        name: what to call the road; by default the file's name without its ending.
        origin: latitude and longitude of (0, 0), degrees, for a Lanelet2 map in such coordinates.

    Raises:
        InputError: if the file is missing or broken, or has no drivable lane.
    """
    with broken_as_one_line(path, "a map"):
        if path.name.endswith((".osm", ".osm.gz", ".osm_xy")):
            from sim.road.maps import lanelet2

            return lanelet2.read_map(path, name, origin)
        if path.name.endswith(SUFFIX):
            return read_stored(path, name)
        if path.suffix == ".json":
            from sim.road.maps import argoverse2

            road = argoverse2.read_map(path, name)
            if road is None:
                raise InputError(f"{path}: found no lane segment, expected at least one")
            return road
        with opened(path) as file:
            commonroad = b"<commonRoad" in file.read(ROOT_BYTES)
        if commonroad:
            from sim.road.maps.commonroad_lanelets import read_map

            return read_map(path, name)
        from sim.road.net import read_road

        return read_road(path, name)


def encode_road(road: Road) -> bytes:
    """A road as a dataset keeps it; equal roads have equal bytes, whatever they are called."""
    stored: dict[str, Any] = {name: [_part(part) for part in getattr(road, name)] for name in PARTS}
    stored |= {
        "version": VERSION,
        "signal_groups": road.signal_groups,
        "knows": asdict(road.knows),
        **({"left_hand": True} if road.left_hand else {}),
    }
    return json.dumps(stored, sort_keys=True, allow_nan=False).encode() + b"\n"


@read_once
def read_stored(path: Path, name: str | None = None) -> Road:
    """Read a road that `encode_road` made."""
    with broken_as_one_line(path, "a road of a dataset"):
        stored = json.loads(read_bytes(path))
        if stored["version"] != VERSION:
            raise InputError(f"version: found {stored['version']!r:.40}, expected {VERSION}")
        parts: dict[str, Any] = {
            field: tuple(kind(**_values(part)) for part in stored[field])
            for field, kind in PARTS.items()
        }
        return Road(
            name=name if name is not None else path.name.removesuffix(SUFFIX),
            signal_groups=tuple(stored["signal_groups"]),
            source=path,
            knows=MapKnowledge(**stored["knows"]),
            left_hand=stored.get("left_hand", False),
            **parts,
        ).checked()


def _part(part: Any) -> dict[str, Any]:
    """The fields of a part of a road, a line as lists and an unknown limit as None."""
    values = {field.name: getattr(part, field.name) for field in fields(part)}
    if "centerline" in values:
        values["centerline"] = part.centerline.tolist()
    if not math.isfinite(values.get("speed_limit_mps", 0.0)):
        values["speed_limit_mps"] = None
    return values


def _values(part: dict[str, Any]) -> dict[str, Any]:
    """The same the other way: tuples, a line as an array, an unknown limit as NaN."""
    values: dict[str, Any] = {name: _tuples(value) for name, value in part.items()}
    if "centerline" in part:
        values["centerline"] = frozen(np.array(part["centerline"], np.float64).reshape(-1, 2))
    if part.get("speed_limit_mps", 0.0) is None:
        values["speed_limit_mps"] = math.nan
    return values


def _tuples(value: Any) -> Any:
    """Lists as tuples, those inside others, too."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
