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
from sim.formats.common.motion import MOVING_MPS
from sim.formats.common.recording import Recording, Rows, first_sizes, recorded
from sim.formats.common.tables import Table, read_table
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

_COMMON: Final = ("timestamp_ms", "x", "y", "vx", "vy")
_BOX: Final = ("psi_rad", "length", "width")


def read(path: Path) -> Iterator[Recording]:
    """Read one file of vehicles, and the pedestrians recorded with them.

    Args:
        path: ``vehicle_tracks_NNN.csv`` (or pedestrians alone), or a file of the multi-agent
            challenge, ``..._train.csv``, whose agents of one id and two types are two agents.

    Yields:
        One recording, or one for each case.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    walkers = beside(path, plain_name(path).replace("vehicle_tracks", "pedestrian_tracks"))
    tables = [_cases(path), *([] if walkers is None else [_cases(walkers)])]
    found, origin = map_beside(path), _origin(path)
    road = None if found is None else read_road_file(found, origin=origin)
    for case in dict.fromkeys(case for table in tables for case in table):
        rows = _joined([_rows(table[case]) for table in tables if case in table])
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


def _cases(path: Path) -> dict[str, Table]:
    """The rows of each case, by its name; of a file without cases, under no name."""
    table = read_table(
        path, [*_COMMON, *_BOX], ["track_id", "agent_type", "case_id"], [*_BOX, "case_id"], _BOX
    )
    if "case_id" not in table:
        return {"": table}
    code, cases = table.codes("case_id")
    return {case: table.part(np.flatnonzero(code == k)) for k, case in enumerate(cases)}


def _rows(table: Table) -> Rows:
    """The rows of one case."""
    agent, names = table.names("track_id", "agent_type")
    vx, vy = table.measured("vx"), table.measured("vy")
    speed, heading = np.hypot(vx, vy), table.measured("psi_rad")
    if np.isnan(heading).any():
        moving = np.where(speed >= MOVING_MPS, np.arctan2(vy, vx), np.nan)
        heading = np.where(np.isnan(heading), moving, heading)
    return Rows(
        agent, names, table.numbers("timestamp_ms", "ms"), table.stacked("x", "y"), heading, speed,
        table.kinds("agent_type", agent, TYPES),
        first_sizes(agent, table.stacked("length", "width")),
    )  # fmt: skip


def _joined(parts: list[Rows]) -> Rows:
    """Vehicles and pedestrians together; an id of both is two agents, named by their kinds."""
    if len(parts) == 1:
        return parts[0]
    one, other = parts
    shared = set(one.names) & set(other.names)
    names = [
        f"{name}-{kind}" if name in shared else name
        for part in parts
        for name, kind in zip(part.names, part.kinds or (), strict=True)
    ]
    agent = np.concatenate([one.agent, other.agent + len(one.names)])
    time_s, xy, heading, speed, sizes = (
        np.concatenate([getattr(part, key) for part in parts])
        for key in ("time_s", "xy", "heading", "speed", "sizes")
    )
    kinds = [kind for part in parts for kind in part.kinds or ()]
    return Rows(agent, names, time_s, xy, heading, speed, kinds, sizes)
