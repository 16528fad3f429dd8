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
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from sim.files import whole_folder
from sim.formats.common.recording import Recording, left_out, recorded
from sim.formats.common.tables import among, read_table, rows_of
from sim.formats.common.windows import behavior_words, focal_windows, labels_beside
from sim.frames import KINDS, AgentKind, FloatArray, Tracks
from sim.geometry import borders
from sim.input_files import stem
from sim.road import Road
from sim.road.maps.argoverse2 import read_map

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

COLUMNS: Final = {
    "id": "track_id", "t": "timestep", "x": "position_x", "y": "position_y", "heading": "heading",
    "vx": "velocity_x", "vy": "velocity_y", "kind": "object_type",
}  # fmt: skip
NUMBERS: Final = ("timestep", "position_x", "position_y", "heading", "velocity_x", "velocity_y")
"""Columns that are read."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of one scenario, with the map and the labels beside it."""
    table = read_table(path, NUMBERS, ("track_id", "object_type"))
    table, others = among(table, "object_type", OBJECT_TYPES)
    rows = rows_of(table, COLUMNS, OBJECT_TYPES)
    rows["t"] /= 10.0
    name = stem(path).removeprefix("scenario_")
    notes = ["sizes are not in this format: those usual for each kind are assumed"]
    notes += left_out(others)
    archive = path.with_name(f"log_map_archive_{name}.json")
    road = archive if archive.is_file() and read_map(archive) is not None else None
    if road is not None:
        notes.append("limits, signals and who has priority are not in this format: unknown")
    labels = labels_beside(path.with_name(f"behavior_{name}.parquet"))
    yield recorded(name, rows, notes, road, own_road=True).with_codes(labels)


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
    for number, window, focal in focal_windows(name, tracks, STEPS):
        identity = str(uuid.uuid5(uuid.NAMESPACE_URL, f"{name}/{number}"))
        with whole_folder(folder / identity) as partial:
            scenario = _scenario(window, focal[0], identity, city)
            pq.write_table(scenario, partial / f"scenario_{identity}.parquet")
            pq.write_table(_labels(window, identity), partial / f"behavior_{identity}.parquet")
            (partial / f"log_map_archive_{identity}.json").write_bytes(archive)
        written.append(folder / identity)
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
    columns = {
        "scenario_id": [identity] * len(window.names),
        "track_id": list(window.names),
        "kind": [KINDS[k].value for k in window.kind],
        "behavior": behavior_words(window),
        "length_m": window.length,
        "width_m": window.width,
    }
    return pa.table(columns, schema=BEHAVIOR_SCHEMA)


def static_map(road: Road | None) -> dict[str, Any]:
    """The map of a road as the official package reads it; an empty one of none."""
    segments, areas, crossings = dict[str, Any](), dict[str, Any](), dict[str, Any]()
    written = {
        "drivable_areas": areas,
        "lane_segments": segments,
        "pedestrian_crossings": crossings,
    }
    if road is None:
        return written
    number = {lane.id: i + 1 for i, lane in enumerate(road.lanes) if not lane.walking}
    chains = [(c.from_lane, *c.via, c.to_lane) for c in road.connections]
    follows = [p for chain in chains for p in pairwise(chain) if number.keys() >= {*p}]
    by_place = {(lane.edge, lane.index): lane.id for lane in road.lanes if not lane.walking}
    for lane in road.lanes:
        if lane.walking:
            continue
        identity = number[lane.id]
        left, right = borders(lane.centerline, lane.width_m)
        segment = {
            "id": identity,
            "is_intersection": lane.internal,
            "lane_type": "VEHICLE",
            "centerline": _points(lane.centerline),
            "left_lane_boundary": _points(left),
            "right_lane_boundary": _points(right),
        }
        beside = {
            side: by_place.get((lane.edge, lane.index + step))
            for side, step in (("left", 1), ("right", -1))
        }
        for side, other in beside.items():
            segment[f"{side}_neighbor_id"] = None if other is None else number[other]
        for side, other in beside.items():
            line = "SOLID_WHITE" if other is None else "DASHED_WHITE"
            segment[f"{side}_lane_mark_type"] = "NONE" if lane.internal else line
        segment["predecessors"] = sorted({number[a] for a, b in follows if b == lane.id})
        segment["successors"] = sorted({number[b] for a, b in follows if a == lane.id})
        segments[str(identity)] = segment
        boundary = np.concatenate([left, right[::-1]])
        areas[str(identity)] = {"id": identity, "area_boundary": _points(boundary)}
    for identity, crossing in enumerate(road.crossings, len(road.lanes) + 1):
        left, right = borders(crossing.centerline[[0, -1]], crossing.width_m)
        edges = {"edge1": _points(left), "edge2": _points(right)}
        crossings[str(identity)] = {"id": identity, **edges}
    return written


def _points(line: FloatArray) -> list[dict[str, float]]:
    return [{"x": float(x), "y": float(y), "z": 0.0} for x, y in line]
