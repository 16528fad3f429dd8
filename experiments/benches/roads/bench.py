"""Does everybody get through any map? Both engines on a folder of maps, or on odd ones made here.

    graphrqi bench roads --maps FOLDER --json roads.json

Each map is surveyed; then some vehicles enter and drive until all of them have left. A map that is
refused is refused in one line, which is shown; a traceback, a jump, and a vehicle that never leaves
are failures.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from behaviors.errors import InputError, lookup
from experiments.benches.contract import Bench, option
from experiments.benches.roads.odd_maps import write_odd_maps
from experiments.benches.roads.trip import Trip, look, ride
from experiments.data.parallel import in_parallel
from experiments.score.rows import Cell, Row, tidy_row
from sim.engines import ENGINES

ENDINGS: Final = (".net.xml", ".osm", ".xodr", ".xml", ".json")
"""How the names of maps end; each may be packed (``.gz``)."""

NOT_MAPS: Final = (".rou.xml", ".trips.xml", ".add.xml", ".fcd.xml", ".types.xml")
"""How the names of files end that lie beside maps."""

MOST_NAMED: Final = 3
"""So many defects of a map are named in the table; the rows of ``--json`` have all of them."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Which maps are driven on, by how many, with which engines."""

    maps: str = option("", "Folder of maps; without it odd ones are made.", "FOLDER")
    engines: tuple[str, ...] = option(("sumo", "highway"), "Engines.")
    vehicles: int = option(20, "Vehicles on each map.")
    seed: int = option(0, "Of the drivers.")
    jobs: int = option(0, "Processes; 0 for one per core.")
    only: str = option("", "Only maps whose name contains this.", "TEXT")


def measure(settings: Settings) -> Iterator[list[Row]]:
    """What happened on each map with each engine.

    Yields:
        The rows of each map and engine; for the survey, engine "" and a row for every defect.

    Raises:
        InputError: if there is no map, or an engine is unknown.
    """
    for engine in settings.engines:
        lookup(ENGINES, engine, "engine")
    if settings.vehicles < 1:
        raise InputError(f"vehicles: found {settings.vehicles}, expected at least 1")
    with tempfile.TemporaryDirectory(prefix="graphrqi-roads-") as scratch:
        paths = maps_in(Path(settings.maps)) if settings.maps else write_odd_maps(Path(scratch))
        paths = [path for path in paths if settings.only in path.name]
        calls = [
            (path, engine, settings.vehicles, settings.seed)
            for path in paths
            for engine in ("", *settings.engines)
        ]
        for trip in in_parallel(_trip, calls, settings.jobs or None):
            yield _rows(trip)


def _trip(path: Path, engine: str, vehicles: int, seed: int) -> Trip:
    return ride(path, engine, vehicles, seed) if engine else look(path)


def maps_in(folder: Path) -> list[Path]:
    """The files in a folder that are named like maps, and in the folders in it.

    Args:
        folder: where; a single map will do.

    Raises:
        InputError: if there is none.
    """
    if folder.is_file():
        return [folder]
    found = [
        path
        for path in sorted(folder.rglob("*"))
        if (name := path.name.lower().removesuffix(".gz")).endswith(ENDINGS)
        and not name.endswith(NOT_MAPS)
        and path.is_file()
    ]
    if not found:
        raise InputError(f"--maps: found no map in {folder}, expected {', '.join(ENDINGS)}")
    return found


def _rows(trip: Trip) -> list[Row]:
    keys: dict[str, Cell] = {"map": trip.map, "kind": trip.kind, "engine": trip.engine}
    n = trip.vehicles
    figures: list[tuple[str, float, str]] = [
        ("refused", float(bool(trip.refused)), trip.refused),
        ("tracebacks", float(bool(trip.crashed)), trip.crashed),
        ("wall_s", round(trip.wall_s, 2), ""),
    ]
    if trip.engine and not trip.refused:
        figures += [
            ("entered", float(trip.entered), ""),
            ("stayed", float(len(trip.stayed)), ", ".join(map(str, trip.stayed))),
            ("teleports", float(trip.teleports), ""),
            ("collisions", float(trip.collisions), ""),
            ("last_left_s", trip.lasted_s, ""),
        ]
    elif not trip.engine:
        n = len(trip.defects)
        figures += [("defects", float(len(trip.defects)), "")]
        figures += [("defect", 1.0, f"{kind}: {place}") for kind, place in trip.defects]
    return [tidy_row({**keys, "what": what}, name, value, None, None, n)
            for name, value, what in figures]  # fmt: skip


COLUMNS: Final = ("entered", "stayed", "teleports", "collisions", "last_left_s", "wall_s")
"""Figures of a drive that the table shows."""


def _table(rows: Sequence[Row]) -> list[Row]:
    """One line per map and engine; the map's own line names what is wrong with it."""
    lines: dict[tuple[Cell, Cell], dict[str, Cell]] = {}
    said: dict[tuple[Cell, Cell], list[str]] = {}
    for row in rows:
        key = row["map"], row["engine"]
        line = lines.setdefault(
            key, {"map": row["map"], "kind": row["kind"], "engine": row["engine"] or "survey"}
        )
        line |= dict.fromkeys(COLUMNS) | {k: v for k, v in line.items() if k in COLUMNS}
        if row["metric"] in COLUMNS:
            line[str(row["metric"])] = row["value"]
        if row["metric"] in ("refused", "tracebacks", "defect") and row["what"]:
            said.setdefault(key, []).append(str(row["what"]))
    for key, line in lines.items():
        named = said.get(key, [])
        more = [f"and {len(named) - MOST_NAMED} more"] if len(named) > MOST_NAMED else []
        line["found"] = "; ".join([*named[:MOST_NAMED], *more])
    return list(lines.values())


BENCH: Final = Bench(
    name="roads",
    summary="Both engines on every map of a folder: who leaves, who stays, what is wrong there.",
    keys=("map", "kind", "engine", "what"),
    full=Settings(),
    quick=Settings(only="grid.net", vehicles=5, jobs=1),
    measure=measure,
    table=_table,
)
