"""INTERACTION: ``vehicle_tracks_NNN.csv`` with ``pedestrian_tracks_NNN.csv`` beside it, 10 Hz.

Box centres in metres, headings in radians, times in milliseconds. Pedestrians and bicycles have
neither heading nor size. A file with a column ``case_id`` holds many short recordings, each with
ids and times of its own.

References:
    Zhan et al. (2019), INTERACTION dataset, arXiv:1910.03088.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.formats.common.columns import Columns
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import joined, read_table
from sim.frames import AgentKind
from sim.input_files import beside, plain_name, stem
from sim.road.files import read_road_file

TYPES: Final[dict[str, AgentKind]] = {
    "car": AgentKind.CAR,
    "bus": AgentKind.BUS,
    "truck": AgentKind.TRUCK,
    "motorcycle": AgentKind.MOTORCYCLE,
    "van": AgentKind.CAR,
    "bicycle": AgentKind.BICYCLE,
    "bike": AgentKind.BICYCLE,
    "pedestrian": AgentKind.PEDESTRIAN,
    "pedestrian/bicycle": AgentKind.PEDESTRIAN,
}
"""``agent_type``, in lower case."""

_BOX: Final = ("psi_rad", "length", "width")
COLUMNS: Final = Columns(
    id=("track_id", "agent_type"), t="timestamp_ms", heading="psi_rad", speed=("vx", "vy"),
    size=("length", "width"), kind="agent_type", kinds=TYPES, units={"timestamp_ms": "ms"},
    words=("case_id",), optional=(*_BOX, "case_id"), empty=_BOX,
)  # fmt: skip
"""Columns of both files; agents of one id and two types are two agents."""


def read(path: Path) -> Iterator[Recording]:
    """Read one file of vehicles, and the pedestrians recorded with them.

    Args:
        path: ``vehicle_tracks_NNN.csv`` (or pedestrians alone), or a file of the multi-agent
            challenge, ``..._train.csv``.

    Yields:
        One recording, or one for each case.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    walkers = beside(path, plain_name(path).replace("vehicle_tracks", "pedestrian_tracks"))
    table = COLUMNS.read(path)
    if walkers is not None:
        table = joined(table, COLUMNS.read(walkers))
    found, origin = map_beside(path), _origin(path)
    road = None if found is None else read_road_file(found, origin=origin)
    for case, part in table.by_word("case_id"):
        rows = COLUMNS.rows(part)
        notes = []
        if walkers is not None or (rows.sizes is not None and np.isnan(rows.sizes).any()):
            notes.append("those without a size have the one usual for their kind")
        name = f"{stem(path)}-{case}" if case else stem(path)
        yield recorded(path, name, rows, notes, road, origin)


def map_beside(path: Path) -> Path | None:
    """The map of a recording, by its name.

    It is ``map_NNN.xml`` beside ``vehicle_tracks_NNN.csv`` (SinD), the only
    ``log_map_archive_*.json`` there (Argoverse 2 sensor logs), the only ``.osm`` there, or the
    ``.osm`` in a folder ``maps`` nearby that is called like the recording's folder (INTERACTION).

    Args:
        path: the recording.

    Returns:
        The file; None where there is none.
    """
    number = stem(path).rpartition("tracks_")[2]
    found = beside(path, f"map_{number}.xml")
    if found is not None:
        return found
    home = path.absolute().parent
    for pattern in ("log_map_archive_*.json", "*.osm", "*.osm.gz"):
        maps = sorted(home.glob(pattern))
        if len(maps) == 1:
            return maps[0]
    folders = (home / "maps", home.parent / "maps", home.parent.parent / "maps")
    files = (f / f"{home.name}{end}" for f in folders for end in (".osm", ".osm.gz", ".osm_xy"))
    return next((file for file in files if file.is_file()), None)


def _origin(path: Path) -> tuple[float, float] | None:
    """Latitude and longitude of (0, 0) from ``meta_data.csv`` beside a recording, degrees."""
    facts = beside(path, "meta_data.csv")
    if facts is None:
        return None
    names = ("originlat", "originlon")
    table = read_table(facts, names, optional=names)
    if not all(name in table for name in names):
        return None
    latitude, longitude = (float(table.numbers(name)[0]) for name in names)
    if abs(latitude) > 89 or abs(longitude) > 180:
        raise InputError(f"{facts}: found origin {latitude:g}, {longitude:g}, expected degrees")
    return latitude, longitude
