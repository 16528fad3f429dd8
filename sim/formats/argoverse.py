"""Argoverse's scenarios of motion forecasting, 2 and 1.

Motion forecasting 2 has ``scenario_<id>.parquet`` with 11 s of tracks, box centres in m. There are
10 steps a second, of which the first 50 are observed. ``log_map_archive_<id>.json`` has the map
(`sim.road.maps.argoverse2`). What we write is read by the official ``av2`` package; the behaviours
go into ``behavior_<id>.parquet`` beside it, and are read from there.

Motion forecasting 1 has a CSV for each 5 s at 10 Hz, ``TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,
CITY_NAME``: centres in metres, times in seconds, neither headings nor speeds nor sizes nor kinds.
Behaviours are in a ``.behavior`` file of ours beside it.

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks. Chang et al. (2019),
    Argoverse: 3D tracking and forecasting with rich maps, CVPR.
"""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pandas
import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.errors import InputError
from sim.files import whole_folder, write_whole
from sim.formats.common.recording import CARS_ASSUMED, Recording, left_out, recorded
from sim.formats.common.tables import among, read_columns, read_table, rows_of, words_in
from sim.frames import KINDS, PEDESTRIAN, AgentKind, Tracks
from sim.input_files import stem
from sim.road import Road
from sim.road.maps.argoverse2 import MAP_NOTE, read_map, static_map

# --- windows at 10 Hz, and labels beside them -----------------------------------------------------

PERIOD_S: Final = 0.1
"""Time between two steps of the forecasting formats, s."""

TOLERANCE_S: Final = 1e-3
"""How far two steps may be from 0.1 s apart, s (the rounding of clocks)."""


class NoWindowError(InputError):
    """An episode that has no window of the format's length: it may be skipped."""


def windows(tracks: Tracks, steps: int) -> Iterator[Tracks]:
    """Consecutive windows of so many times 0.1 s apart, with the agents seen in each.

    A new window begins after a gap; the incomplete windows before a gap and at the end are dropped.

    Raises:
        InputError: if the step of the tracks is not a divisor of 0.1 s.
    """
    if tracks.time_s.size < 2:
        return  # too short for a window, and without a step
    stride = PERIOD_S / tracks.step_s
    if stride < 0.999 or abs(stride - round(stride)) > 1e-3:
        raise InputError(
            f"step_s: found {tracks.step_s:g}, expected a divisor of {PERIOD_S} for this format"
        )
    time_s, wanted = tracks.time_s, tracks.time_s + PERIOD_S
    nearest = np.searchsorted((time_s[1:] + time_s[:-1]) / 2, wanted)
    follows = np.abs(time_s[nearest] - wanted) <= TOLERANCE_S
    column, window = 0, list[int]()
    while column < time_s.size:
        window.append(column)
        if len(window) == steps:
            rows = np.concatenate([tracks.index.at(step) for step in window])
            yield tracks.part(np.unique(tracks.index.agent[rows]), np.array(window))
        if len(window) == steps or not follows[column]:
            window = []
        column = int(nearest[column]) if follows[column] else column + 1


def focal_windows(name: str, tracks: Tracks, steps: int) -> Iterator[tuple[int, Tracks, list[int]]]:
    """The windows of an episode in which a vehicle is seen in every step, with their numbers.

    Those vehicles come with each, the one that travels farthest first.

    Raises:
        NoWindowError: if there is none.
    """
    found = False
    for number, window in enumerate(windows(tracks, steps)):
        rows = np.flatnonzero(window.valid.all(axis=1) & (window.kind != PEDESTRIAN))
        way = np.hypot(*np.moveaxis(window.xy[rows, -1] - window.xy[rows, 0], -1, 0))
        if rows.size:
            found = True
            yield number, window, rows[np.argsort(-way, kind="stable")].tolist()
    if not found:
        raise NoWindowError(
            f"{name}: found no {steps / 10:g} s with an agent seen all the time, expected some"
        )


def labels_beside(path: Path) -> dict[str, str | None]:
    """Behaviours by an agent's name, from the table of labels beside a recording.

    It has the columns ``track_id`` and ``behavior``, and may be missing.
    """
    if not path.is_file():
        return {}
    table = read_table(path, (), ("track_id", "behavior"), ("behavior",))
    names = map(str, words_in(table["track_id"]))
    return dict(zip(names, words_in(table["behavior"]), strict=True))


def labels_of(tracks: Tracks) -> dict[str, list[str | None]]:
    """The columns of a table of labels: each agent's name, kind and behaviour, if it has one."""
    codes = [-1] * len(tracks.names) if tracks.behavior is None else tracks.behavior
    return {
        "track_id": [*tracks.names],
        "kind": [KINDS[kind].value for kind in tracks.kind],
        "behavior": [str(tracks.classes[code]) if code >= 0 else None for code in codes],
    }


# --- motion forecasting 2 -------------------------------------------------------------------------

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

WRITTEN_TYPES: Final[dict[AgentKind, str]] = {kind: word for word, kind in OBJECT_TYPES.items()} | {
    AgentKind.TRUCK: "vehicle"
}
"""The object type of each kind; the format has no trucks."""

FRAGMENT, UNSCORED, SCORED, FOCAL = range(4)
"""Object categories."""

COLUMNS: Final = {
    "id": "track_id", "t": "timestep", "x": "position_x", "y": "position_y", "heading": "heading",
    "vx": "velocity_x", "vy": "velocity_y", "kind": "object_type",
}  # fmt: skip
"""Columns that are read."""


def read_scenario(path: Path) -> Iterator[Recording]:
    """The recording of one scenario, with the map and the labels beside it."""
    table, others = among(read_columns(path, COLUMNS), "object_type", OBJECT_TYPES)
    rows = rows_of(table, COLUMNS, kinds=OBJECT_TYPES)
    rows["t"] /= 10.0
    name = stem(path).removeprefix("scenario_")
    notes = ["sizes are not in this format: those usual for each kind are assumed"]
    notes += left_out(others)
    archive = path.with_name(f"log_map_archive_{name}.json")
    road = archive if archive.is_file() and read_map(archive) is not None else None
    if road is not None:
        notes.append(MAP_NOTE)
    labels = labels_beside(path.with_name(f"behavior_{name}.parquet"))
    yield recorded(name, rows, notes, road, own_road=True).with_behaviors(labels)


def write_scenarios(
    folder: Path, name: str, tracks: Tracks, road: Road | None = None
) -> list[Path]:
    """Write an episode as scenarios of 11 s, and give their folders.

    The vehicle that travels farthest of those seen all the time is the focal track; others seen
    all the time are scored.

    Args:
        folder: where; it must exist.
        name: of the episode; decides the scenarios' ids.
        tracks: the episode, its step a divisor of 0.1 s.
        road: where it happened; without it the map is empty.

    Raises:
        NoWindowError: if no 11 s without a gap have a vehicle that is seen all the time.
        InputError: if the step does not fit.
    """
    written: list[Path] = []
    city = "simulated" if road is None else road.name.replace("_", "-")
    archive = json.dumps(static_map(road), allow_nan=False).encode()
    for number, window, focal in focal_windows(name, tracks, STEPS):
        identity = str(uuid.uuid5(uuid.NAMESPACE_URL, f"{name}/{number}"))
        words = {key: pa.array(found, pa.string()) for key, found in labels_of(window).items()}
        sizes = {"length_m": window.length, "width_m": window.width}
        labels = pa.table({"scenario_id": [identity] * len(window.names), **words, **sizes})
        with whole_folder(folder / identity) as partial:
            scenario = _scenario(window, focal[0], identity, city)
            pq.write_table(scenario, partial / f"scenario_{identity}.parquet")
            pq.write_table(labels, partial / f"behavior_{identity}.parquet")
            (partial / f"log_map_archive_{identity}.json").write_bytes(archive)
        written.append(folder / identity)
    return written


def _scenario(window: Tracks, focal: int, identity: str, city: str) -> pa.Table:
    """The official columns of one window, of the official types."""
    row, step = np.nonzero(window.valid)
    category = np.where(window.valid[:, OBSERVED_STEPS - 1], UNSCORED, FRAGMENT)
    category[window.valid.all(axis=1)] = SCORED
    category[focal] = FOCAL
    types = np.array([WRITTEN_TYPES[KINDS[k]] for k in window.kind])
    heading, speed = window.heading[row, step], window.speed[row, step]
    start_ns = float(np.round(window.time_s[0] * 1e9))
    m = row.size
    return pa.table(
        {
            "observed": step < OBSERVED_STEPS,
            "track_id": np.array(window.names)[row],
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
    )


# --- motion forecasting 1 -------------------------------------------------------------------------

CSV_STEPS: Final = 50
"""Length of a recording: 20 steps observed, 30 to predict."""

LABELS_SUFFIX: Final = ".behavior"
"""Ending of the file beside each recording that holds the behaviours."""

FORMULA: Final = re.compile(r"[=+@]|-(?![\d.]+(?:e[-+]?\d+)?$)", re.IGNORECASE)
"""Beginning of what spreadsheets take for a formula; negative numbers are none."""

CITY: Final = "PIT"
"""The format allows Pittsburgh and Miami only; what we write is neither."""


def read_csv(path: Path) -> Iterator[Recording]:
    """The recording of one file, with the labels beside it; its first time is 0."""
    columns = {"id": "track_id", "t": "timestamp", "x": "x", "y": "y"}
    rows = rows_of(read_columns(path, columns), columns, from_zero=True)
    notes = (CARS_ASSUMED, "headings and speeds are taken from the motion")
    labels = labels_beside(path.with_suffix(LABELS_SUFFIX))
    yield recorded(stem(path), rows, notes).with_behaviors(labels)


def write_csv(folder: Path, name: str, tracks: Tracks, road: object = None) -> list[Path]:
    """Write an episode as files of 5 s; behaviours go into a file beside each.

    The vehicle that travels farthest of those seen all the time is the AGENT, the next one the AV.
    The format has no map.

    Raises:
        NoWindowError: if no 5 s without a gap have a vehicle that is seen all the time.
        InputError: if the step does not fit, or an agent has a name that CSV files should not hold.
    """
    for label in tracks.names:
        if not label.isprintable() or FORMULA.match(label):
            raise InputError(
                f"{name}: found agent {label!r:.60}, which a spreadsheet could run or a reader not "
                "read back, expected a plain id"
            )
    written: list[Path] = []
    for number, window, focal in focal_windows(name, tracks, CSV_STEPS):
        step, row = np.nonzero(window.valid.T)
        role = np.full(len(window.names), "OTHERS")
        role[focal[:2]] = ("AGENT", "AV")[: len(focal)]
        x, y = window.xy[row, step].T
        rows = {
            "timestamp": window.time_s[step],
            "track_id": np.array(window.names, dtype=object)[row],
            "object_type": role[row],
            "x": x,
            "y": y,
            "city_name": CITY,
        }
        for suffix, columns in ((".csv", rows), (LABELS_SUFFIX, labels_of(window))):
            path = folder / f"{name}-{number:04d}{suffix}"
            text = (
                pandas.DataFrame(columns)
                .rename(columns=str.upper)
                .to_csv(index=False, lineterminator="\n")
            )
            write_whole(path, text.encode())
            written.append(path)
    return written
