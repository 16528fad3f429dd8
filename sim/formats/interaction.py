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

import pandas

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import by_word, codes_in, read_table, rows_of, words_in
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

COLUMNS: Final = {
    "id": "track_id", "t": "timestamp_ms", "x": "x", "y": "y", "heading": "psi_rad", "vx": "vx",
    "vy": "vy", "length": "length", "width": "width", "kind": "agent_type",
}  # fmt: skip
NUMBERS: Final = ("timestamp_ms", "x", "y", "psi_rad", "vx", "vy", "length", "width")
WORDS: Final = ("track_id", "agent_type", "case_id")
OPTIONAL: Final = ("psi_rad", "length", "width", "case_id")
"""Columns of both files, and those that may be missing."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of one file of vehicles, with the pedestrians recorded with them.

    A file of the multi-agent challenge, ``..._train.csv``, has a recording for each case.
    """
    walkers = beside(path, plain_name(path).replace("vehicle_tracks", "pedestrian_tracks"))
    files = [path] if walkers is None else [path, walkers]
    tables = [read_table(file, NUMBERS, WORDS, OPTIONAL) for file in files]
    table = tables[0] if walkers is None else pandas.concat(tables, ignore_index=True)
    found, origin = map_beside(path), _origin(path)
    road = None if found is None else read_road_file(found, origin=origin)
    for case, part in by_word(table, "case_id"):
        rows = rows_of(part, COLUMNS, TYPES, {"t": "ms"})
        rows["id"] = _told_apart(part)
        notes = []
        sizes = rows.reindex(columns=["length", "width"])
        if walkers is not None or sizes.isna().any(axis=None):
            notes.append("those without a size have the one usual for their kind")
        name = f"{stem(path)}-{case}" if case else stem(path)
        yield recorded(name, rows, notes, road, origin)


def _told_apart(table: pandas.DataFrame) -> pandas.Categorical:
    """Names of agents; those of one id and two types are two agents."""
    agent, ids = codes_in(table["track_id"])
    kind, _ = codes_in(table["agent_type"])
    several = pandas.Series(kind).groupby(agent).transform("nunique").to_numpy() > 1
    if not several.any():
        return pandas.Categorical.from_codes(agent, ids)
    names = words_in(table["track_id"])
    both = zip(names, words_in(table["agent_type"]), several, strict=True)
    return pandas.Categorical([f"{name}-{word}" if two else name for name, word, two in both])


def map_beside(path: Path) -> Path | None:
    """The map of a recording, by its name.

    It is ``map_NNN.xml`` beside ``vehicle_tracks_NNN.csv`` (SinD), the only
    ``log_map_archive_*.json`` there (Argoverse 2 sensor logs), the only ``.osm`` there, or the
    ``.osm`` in a folder ``maps`` nearby that is called like the recording's folder (INTERACTION).
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
    names = ["originlat", "originlon"]
    table = read_table(facts, names, optional=names)
    if not set(names) <= set(table):
        return None
    latitude, longitude = table[names].iloc[0].tolist()
    if not (abs(latitude) <= 89 and abs(longitude) <= 180):
        raise InputError(f"{facts}: found origin {latitude:g}, {longitude:g}, expected degrees")
    return latitude, longitude
