"""Argoverse 2 motion forecasting: a Parquet file and a map per 11 s at 10 Hz.

``scenario_<id>.parquet`` holds the tracks (box centres, m), ``log_map_archive_<id>.json`` the map
(`sim.road.maps.argoverse2`); 50 steps are observed, 60 to predict. What we write is read by the
official ``av2`` package; the behaviours go into ``behavior_<id>.parquet`` beside it, and are read
from there.

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.arrow.budget import Layout, check_budget, check_number
from sim.arrow.parquet import opened, read_packed
from sim.files import whole_folder
from sim.formats.common.recording import (
    MAX_NAMES,
    Recording,
    Rows,
    check_size,
    default_size,
    kind_codes,
    recordings,
)
from sim.formats.common.windows import NoWindowError, behavior_codes, focal_agents, windows
from sim.frames import KINDS, AgentKind, Tracks
from sim.road import Road
from sim.road.maps.argoverse2 import read_map, static_map

OBSERVED_STEPS: Final = 50
STEPS: Final = 110
SPAN_NS: Final = 10.9e9
"""Time from the first to the last step, ns."""

OBJECT_TYPES: Final[dict[str, AgentKind]] = {
    "vehicle": AgentKind.CAR,
    "bus": AgentKind.BUS,
    "motorcyclist": AgentKind.MOTORCYCLE,
    "cyclist": AgentKind.BICYCLE,
    "pedestrian": AgentKind.PEDESTRIAN,
}
"""Object types that are road-agents; the others (static, background, ...) are left out."""

WRITTEN_TYPES: Final[dict[AgentKind, str]] = {
    AgentKind.CAR: "vehicle",
    AgentKind.TRUCK: "vehicle",
    **{kind: word for word, kind in OBJECT_TYPES.items() if kind is not AgentKind.CAR},
}
"""The object type of each kind; the format has no trucks."""

FRAGMENT, UNSCORED, SCORED, FOCAL = range(4)
"""Object categories."""

SCHEMA: Final = pa.schema(
    [
        ("observed", pa.bool_()),
        ("track_id", pa.string()),
        ("object_type", pa.string()),
        ("object_category", pa.int64()),
        ("timestep", pa.int64()),
        ("position_x", pa.float64()),
        ("position_y", pa.float64()),
        ("heading", pa.float64()),
        ("velocity_x", pa.float64()),
        ("velocity_y", pa.float64()),
        ("scenario_id", pa.string()),
        ("start_timestamp", pa.float64()),
        ("end_timestamp", pa.float64()),
        ("num_timestamps", pa.int64()),
        ("focal_track_id", pa.string()),
        ("city", pa.string()),
        ("map_id", pa.uint64()),
        ("slice_id", pa.string()),
    ]
)
"""The official columns."""

BEHAVIOR_SCHEMA: Final = pa.schema(
    [
        ("scenario_id", pa.string()),
        ("track_id", pa.string()),
        ("kind", pa.string()),
        ("behavior", pa.string()),
        ("length_m", pa.float64()),
        ("width_m", pa.float64()),
    ]
)
"""Columns of the file beside the official ones that holds the behaviours, which the format cannot
hold."""

MAX_ROWS: Final = 5 * 10**6
"""Most rows of a scenario (45 000 agents seen in all of its 11 s)."""

MAX_TEXT_BYTES: Final = 1000
"""Longest track id, object type or behaviour (a UUID has 36)."""

_TEXT_TYPES: Final = ("BYTE_ARRAY", "INT32", "INT64")
_NUMBER_TYPES: Final = ("INT32", "INT64", "FLOAT", "DOUBLE")
"""How Parquet stores what is read as texts and as numbers."""

_TEXTS: Final = ("track_id", "object_type")
_NUMBERS: Final = (
    "timestep", "position_x", "position_y", "heading", "velocity_x", "velocity_y",
)  # fmt: skip


def read(path: Path) -> Iterator[Recording]:
    """Read one scenario file; numbers are kept to the last digit.

    Args:
        path: ``scenario_<id>.parquet``; its map and its labels are looked for beside it.

    Yields:
        One recording, labelled where there are labels.

    Raises:
        InputError: if a file is broken; the message names file and column.
    """
    table = _read_columns(path, _TEXTS, _NUMBERS, MAX_ROWS)
    types, type_words = text_codes(path, table, "object_type")
    ids, id_words = text_codes(path, table, "track_id")
    road_agent = np.isin(type_words, list(OBJECT_TYPES))[types]
    left_out = sorted({type_words[code] for code in np.unique(types)} - set(OBJECT_TYPES))
    kept, agent = np.unique(ids[road_agent], return_inverse=True)
    _, first = np.unique(agent, return_index=True)
    kinds = [OBJECT_TYPES[type_words[code]] for code in types[road_agent][first]]
    sizes = np.array([default_size(kind) for kind in kinds]).reshape(-1, 2)
    name = path.stem.removeprefix("scenario_")
    names = tuple(id_words[code] for code in kept)

    def column(name: str) -> NDArray[np.float64]:
        return np.asarray(table.column(name).to_numpy()[road_agent], dtype=np.float64)

    rows = Rows(
        agent=agent,
        names=names,
        time_s=column("timestep") / 10.0,
        x=column("position_x"),
        y=column("position_y"),
        heading=column("heading"),
        speed=np.hypot(column("velocity_x"), column("velocity_y")),
        length=sizes[:, 0],
        width=sizes[:, 1],
        kind=kind_codes(kinds),
        behavior=_labels_beside(path.with_name(f"behavior_{name}.parquet"), names),
    )
    notes = ["sizes are not in this format: those usual for each kind are assumed"]
    if left_out:
        notes.append(f"left out, because they are not road-agents: {', '.join(left_out)}")
    archive = path.with_name(f"log_map_archive_{name}.json")
    road = archive if archive.is_file() and read_map(archive) is not None else None
    if road is not None:
        notes.append("limits, signals and who has priority are not in this format: unknown")
    yield from recordings(path, name, rows, notes, road)


def _labels_beside(path: Path, names: tuple[str, ...]) -> NDArray[np.int8] | None:
    if not path.is_file():
        return None
    table = _read_columns(path, ("track_id", "behavior"), (), MAX_NAMES, optional="behavior")
    ids, id_words = text_codes(path, table, "track_id")
    codes, words = text_codes(path, table, "behavior")
    labels = [None if code < 0 else words[code] for code in codes]
    return behavior_codes(path, names, [id_words[i] for i in ids], labels)


def _read_columns(
    path: Path,
    texts: Sequence[str],
    numbers: Sequence[str],
    max_rows: int,
    optional: str | None = None,
) -> pa.Table:
    """Some columns of a Parquet file; none but the optional one may have empty fields.

    Texts stay dictionaries: a small file can repeat a long text for millions of rows.
    """
    check_size(path)
    with opened(path) as (layout, source):
        types = {name: _checked_type(path, layout, name, _TEXT_TYPES) for name in texts}
        for name in numbers:
            _checked_type(path, layout, name, _NUMBER_TYPES)
        check_budget(path, layout, (*texts, *numbers), max_rows)
        packed = [name for name in texts if types[name] == "BYTE_ARRAY"]
        table = read_packed(source, packed, [*texts, *numbers])
        for name in numbers:
            check_number(path, table.schema.field(name))
        columns = {name: table.column(name).cast(SCHEMA.field(name).type) for name in numbers}
        for name in texts:
            encoded = table.column(name).combine_chunks().dictionary_encode()
            words = encoded.dictionary.cast(pa.string())
            columns[name] = pa.DictionaryArray.from_arrays(encoded.indices, words)
    for name, column in columns.items():
        if column.null_count and name != optional:
            raise InputError(f"{path}: column {name}: found an empty field, expected a value")
    return pa.table(columns)


def _checked_type(path: Path, layout: Layout, name: str, allowed: Sequence[str]) -> str:
    """How a column is stored, once it is known to be there."""
    columns = [column for column in layout.columns if column.name == name]
    if not columns:
        raise InputError(f"{path}: found no column {name}, expected it")
    if len(columns) > 1:
        raise InputError(f"{path}: found column {name} {len(columns)} times, expected once")
    (column,) = columns
    if column.physical not in allowed or column.repeated:
        kind = f"lists of {column.physical}" if column.repeated else column.physical
        raise InputError(f"{path}: column {name}: found {kind}, expected {' or '.join(allowed)}")
    return column.physical


def text_codes(path: Path, table: pa.Table, name: str) -> tuple[NDArray[np.int64], list[str]]:
    """Texts of a column as codes.

    Args:
        path: the file that they come from, for messages.
        table: its columns.
        name: a column that is a dictionary of texts.

    Returns:
        (rows,) place among the different texts (-1: empty), and those texts.

    Raises:
        InputError: if a text is too long, or there are too many different ones.
    """
    column = table.column(name).combine_chunks()
    longest = pc.max(pc.binary_length(column.dictionary)).as_py() or 0
    if longest > MAX_TEXT_BYTES:
        raise InputError(
            f"{path}: column {name}: found a text of {longest} bytes, expected at most "
            f"{MAX_TEXT_BYTES}"
        )
    if len(column.dictionary) > MAX_NAMES:
        raise InputError(
            f"{path}: column {name}: found {len(column.dictionary)} different texts, expected at "
            f"most {MAX_NAMES}"
        )
    different = column.dictionary.dictionary_encode()  # a file's own may have a text twice
    places = np.append(different.indices.to_numpy(), -1)
    return places[column.indices.fill_null(-1).to_numpy()], different.dictionary.to_pylist()


# --- writing ------------------------------------------------------------------------------------


def write(folder: Path, name: str, tracks: Tracks, road: Road | None = None) -> list[Path]:
    """Write an episode as scenarios of 11 s.

    The vehicle that travels farthest of those seen all the time is the focal track; others seen
    all the time are scored.

    Args:
        folder: where; it must exist.
        name: of the episode; decides the scenarios' ids.
        tracks: the episode, its step a divisor of 0.1 s.
        road: where it happened; without it the map is empty.

    Returns:
        The folders written, one per scenario.

    Raises:
        NoWindowError: if no 11 s without a gap have a vehicle that is seen all the time.
        InputError: if the step does not fit.
    """
    written: list[Path] = []
    city = "simulated" if road is None else road.name.replace("_", "-")
    archive = json.dumps(static_map(road), allow_nan=False).encode()
    for number, window in enumerate(windows(tracks, STEPS)):
        focal = focal_agents(window)
        if not focal:
            continue
        identity = str(uuid.uuid5(uuid.NAMESPACE_URL, f"{name}/{number}"))
        with whole_folder(folder / identity) as partial:
            scenario = _scenario(window, focal[0], identity, city)
            pq.write_table(scenario, partial / f"scenario_{identity}.parquet")
            pq.write_table(_labels(window, identity), partial / f"behavior_{identity}.parquet")
            (partial / f"log_map_archive_{identity}.json").write_bytes(archive)
        written.append(folder / identity)
    if not written:
        raise NoWindowError(f"{name}: found no 11 s with an agent seen all the time, expected some")
    return written


def _scenario(window: Tracks, focal: int, identity: str, city: str) -> pa.Table:
    row, step = np.nonzero(window.valid)
    complete = window.valid.all(axis=1)
    observed = window.valid[:, OBSERVED_STEPS - 1]
    category = np.where(complete, SCORED, np.where(observed, UNSCORED, FRAGMENT))
    category[focal] = FOCAL
    types = np.array([WRITTEN_TYPES[KINDS[k]] for k in window.kind])
    names = np.array(window.names)
    heading, speed = window.heading[row, step], window.speed[row, step]
    start_ns = float(np.round(window.time_s[0] * 1e9))
    m = row.size
    columns: dict[str, Any] = {
        "observed": step < OBSERVED_STEPS,
        "track_id": names[row],
        "object_type": types[row],
        "object_category": category[row],
        "timestep": step,
        "position_x": window.xy[row, step, 0],
        "position_y": window.xy[row, step, 1],
        "heading": heading,
        "velocity_x": speed * np.cos(heading),
        "velocity_y": speed * np.sin(heading),
        "scenario_id": [identity] * m,
        "start_timestamp": np.full(m, start_ns),
        "end_timestamp": np.full(m, start_ns + SPAN_NS),
        "num_timestamps": np.full(m, STEPS),
        "focal_track_id": [window.names[focal]] * m,
        "city": [city] * m,
        "map_id": np.zeros(m, dtype=np.uint64),
        "slice_id": [identity] * m,
    }
    return pa.table({k: pa.array(v, type=SCHEMA.field(k).type) for k, v in columns.items()})


def _labels(window: Tracks, identity: str) -> pa.Table:
    codes = np.full(len(window.names), -1) if window.behavior is None else window.behavior
    columns = {
        "scenario_id": [identity] * len(window.names),
        "track_id": list(window.names),
        "kind": [KINDS[k].value for k in window.kind],
        "behavior": [BEHAVIORS[c].value if c >= 0 else None for c in codes],
        "length_m": window.length,
        "width_m": window.width,
    }
    return pa.table(columns, schema=BEHAVIOR_SCHEMA)
