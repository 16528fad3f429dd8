"""INTERACTION: ``vehicle_tracks_NNN.csv`` with ``pedestrian_tracks_NNN.csv`` beside it, 10 Hz.

Box centres in metres, headings in radians, times in milliseconds. Pedestrians and bicycles have
neither heading nor size. A file with a column ``case_id`` holds many short recordings, each with
ids and times of its own.

References:
    Zhan et al. (2019), INTERACTION dataset, arXiv:1910.03088.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.motion import MOVING_MPS
from sim.formats.common.recording import Recording, Rows, assemble
from sim.formats.common.tables import Table, read_csv
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

MAX_REPEATED: Final = 0.02
"""Share of rows that may repeat an agent at one time (a tracker that splits vehicles makes some .5
%): the first counts. A file with more is refused: its ids or times are wrong."""

_COMMON: Final = ("timestamp_ms", "x", "y", "vx", "vy")
_BOX: Final = ("psi_rad", "length", "width")


def read(path: Path) -> Iterator[Recording]:
    """Read one file of vehicles, and the pedestrians recorded with them.

    Args:
        path: ``vehicle_tracks_NNN.csv`` (or pedestrians alone).

    Yields:
        One recording, or one for each case.

    Raises:
        InputError: if a file is broken; the message names file and column or row.
    """
    walkers = beside(path, plain_name(path).replace("vehicle_tracks", "pedestrian_tracks"))
    cases, walking = _cases(path), {} if walkers is None else _cases(walkers)
    found, origin = map_beside(path), _origin(path)
    road = None if found is None else read_road_file(found, origin=origin)
    for case in cases | walking:
        parts = [part[case] for part in (cases, walking) if case in part]
        rows, repeated = _once(_joined(parts, path, walkers or path))
        notes = []
        if walkers is not None:
            notes.append("those without a size have the one usual for their kind")
        if repeated:
            notes.append(f"{repeated} rows left out that have an agent twice at one time")
        name = f"{stem(path)}-{case}" if case else stem(path)
        yield Recording(name, assemble(path, rows), tuple(notes), road, origin)


def _once(rows: Rows) -> tuple[Rows, int]:
    """The rows without an agent's second row at one time, and how many were left out."""
    order = np.lexsort((rows.time_s, rows.agent))
    agent, time_s = rows.agent[order], rows.time_s[order]
    again = np.flatnonzero((agent[1:] == agent[:-1]) & (time_s[1:] == time_s[:-1])) + 1
    if not 0 < again.size <= MAX_REPEATED * agent.size:
        return rows, 0
    kept = np.ones(agent.size, dtype=bool)
    kept[order[again]] = False
    names = ("agent", "time_s", "x", "y", "heading", "speed")
    return replace(rows, **{name: getattr(rows, name)[kept] for name in names}), again.size


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
    table = read_csv(facts, names, optional=names)
    if not all(name in table for name in names):
        return None
    latitude, longitude = (float(table.numbers(name)[0]) for name in names)
    if abs(latitude) > 89 or abs(longitude) > 180:
        raise InputError(f"{facts}: found origin {latitude:g}, {longitude:g}, expected degrees")
    return latitude, longitude


def _joined(parts: list[Rows], path: Path, walkers: Path) -> Rows:
    """Vehicles and pedestrians together."""
    if len(parts) == 1:
        return parts[0]
    one, other = parts
    names = (*one.names, *other.names)
    if len(set(names)) != len(names):
        raise InputError(f"{walkers}: found an agent that {path.name} has too, expected others")

    def both(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(part, name) for part in parts])

    return Rows(
        np.concatenate([one.agent, other.agent + len(one.names)]), names, both("time_s"),
        both("x"), both("y"), both("heading"), both("speed"), both("length"), both("width"),
        both("kind"),
    )  # fmt: skip


def _cases(path: Path) -> dict[str, Rows]:
    """The rows of each case, by its name; of a file without cases, under no name."""
    words = ["track_id", "agent_type", "case_id"]
    table = read_csv(path, [*_COMMON, *_BOX], words, optional=[*_BOX, "case_id"])
    if "case_id" not in table:
        return {"": _rows(table)}
    code, cases = table.codes("case_id")
    order = np.argsort(code, kind="stable")
    ends = np.cumsum(np.bincount(code)).tolist()
    return {
        case: _rows(table.part(order[begin:end]))
        for case, (begin, end) in zip(cases, itertools.pairwise([0, *ends]), strict=True)
    }


def _rows(table: Table) -> Rows:
    """The rows of one case."""
    agent, names = table.names("track_id")
    kinds = []
    for word in table.only("agent_type", agent):
        kind = TYPES.get(word.lower())
        if kind is None:
            raise InputError(
                f"{table.path}: column agent_type: found {word!r:.60}, expected one of "
                f"{', '.join(TYPES)}"
            )
        kinds.append(kind)
    vx, vy = table.numbers("vx"), table.numbers("vy")
    speed = np.hypot(vx, vy)
    if "psi_rad" in table:
        heading = table.numbers("psi_rad")
    else:
        heading = np.where(speed >= MOVING_MPS, np.arctan2(vy, vx), np.nan)
    _, first = np.unique(agent, return_index=True)
    sides = [
        table.numbers(side)[first] if side in table else np.zeros(len(names))
        for side in ("length", "width")
    ]
    return Rows.of(
        agent,
        names,
        table.numbers("timestamp_ms", "ms"),
        np.stack([table.numbers("x"), table.numbers("y")], axis=1),
        heading,
        speed,
        kinds,
        np.stack(sides, axis=1),
    )
