"""Argoverse: scenarios of motion forecasting (2 and 1), and sensor logs (2).

Motion forecasting 2 has ``scenario_<id>.parquet`` with 11 s of tracks, box centres in m. There are
10 steps a second, of which the first 50 are observed. ``log_map_archive_<id>.json`` has the map
(`sim.road.maps.argoverse2`). What we write is read by the official ``av2`` package; the behaviours
go into ``behavior_<id>.parquet`` beside it, and are read from there.

Motion forecasting 1 has a CSV for each 5 s at 10 Hz, ``TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,
CITY_NAME``: centres in metres, times in seconds, neither headings nor speeds nor sizes nor kinds.
Behaviours are in a ``.behavior`` file of ours beside it.

A sensor log is a folder. ``annotations.feather`` holds the boxes of each lidar sweep (10 Hz, ns) in
the frame of the recording car, ``city_SE3_egovehicle.feather`` the car's poses in the city, and
``map/log_map_archive_*.json`` the map. The car itself is the agent ``AV``.

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks; the sensor dataset's
    overview in ``av2-api`` (columns, frames, taxonomy). Chang et al. (2019), Argoverse: 3D tracking
    and forecasting with rich maps, CVPR.
"""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.files import whole_folder, write_whole
from sim.formats.common.recording import CARS_ASSUMED, Recording, left_out, recorded
from sim.formats.common.tables import (
    among,
    kinds_in,
    read_columns,
    read_table,
    rows_of,
    whole,
    words_in,
)  # fmt: skip
from sim.frames import KINDS, PEDESTRIAN, AgentKind, FloatArray, Tracks
from sim.input_files import beside, broken_as_one_line, stem
from sim.road import Road
from sim.road.maps.argoverse2 import read_map, static_map

MAP_NOTE: Final = "limits, signals and who has priority are not in this format: unknown"

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
    time_s, index = tracks.time_s, tracks.index
    wanted = time_s + PERIOD_S
    after = np.minimum(np.searchsorted(time_s, wanted), time_s.size - 1)
    nearest = after - (wanted - time_s[after - 1] < time_s[after] - wanted)
    follows = np.abs(time_s[nearest] - wanted) <= TOLERANCE_S
    column, window = 0, list[int]()
    while column < time_s.size:
        window.append(column)
        if len(window) == steps:
            seen = np.unique(np.concatenate([index.agent[index.at(step)] for step in window]))
            yield tracks.part(seen, np.array(window))
            window = []
        if not follows[column]:  # a gap: the next time begins a new window
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


def labels_beside(path: Path) -> dict[str, int]:
    """Codes into ``BEHAVIORS`` by an agent's name, from the table of labels beside a recording.

    It has the columns ``track_id`` and ``behavior``, and may be missing.
    """
    if not path.is_file():
        return {}
    table = read_table(path, (), ("track_id", "behavior"), ("behavior",))
    codes: dict[str, int] = {}
    for name, word in zip(words_in(table["track_id"]), words_in(table["behavior"]), strict=True):
        if not name or name in codes or (word and word not in BEHAVIORS):
            found = f"behavior {word!r:.60}" if name not in codes else "it twice"
            raise InputError(
                f"{path}: agent {name!r:.60}: found {found}, expected one of {', '.join(BEHAVIORS)}"
            )
        codes[name] = BEHAVIORS.index(word) if word else -1
    return codes


def behavior_words(tracks: Tracks) -> list[str | None]:
    """The behaviour of each agent as a word; None where it has none."""
    codes = [-1] * len(tracks.names) if tracks.behavior is None else tracks.behavior
    return [str(tracks.classes[code]) if code >= 0 else None for code in codes]


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

SCHEMA: Final = pa.schema(
    [
        ("observed", pa.bool_()), ("track_id", pa.string()), ("object_type", pa.string()),
        ("object_category", pa.int64()), ("timestep", pa.int64()), ("position_x", pa.float64()),
        ("position_y", pa.float64()), ("heading", pa.float64()), ("velocity_x", pa.float64()),
        ("velocity_y", pa.float64()), ("scenario_id", pa.string()),
        ("start_timestamp", pa.float64()), ("end_timestamp", pa.float64()),
        ("num_timestamps", pa.int64()), ("focal_track_id", pa.string()), ("city", pa.string()),
        ("map_id", pa.uint64()), ("slice_id", pa.string()),
    ]
)  # fmt: skip
"""The official columns."""

BEHAVIOR_SCHEMA: Final = pa.schema(
    [
        ("scenario_id", pa.string()), ("track_id", pa.string()), ("kind", pa.string()),
        ("behavior", pa.string()), ("length_m", pa.float64()), ("width_m", pa.float64()),
    ]
)  # fmt: skip
"""Columns of the file beside it that holds the behaviours, which the format cannot hold."""

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
    yield recorded(name, rows, notes, road, own_road=True).with_codes(labels)


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
        labels = {
            "scenario_id": [identity] * len(window.names),
            "track_id": list(window.names),
            "kind": [KINDS[k].value for k in window.kind],
            "behavior": behavior_words(window),
            "length_m": window.length,
            "width_m": window.width,
        }
        with whole_folder(folder / identity) as partial:
            scenario = _scenario(window, focal[0], identity, city)
            pq.write_table(scenario, partial / f"scenario_{identity}.parquet")
            pq.write_table(
                pa.table(labels, schema=BEHAVIOR_SCHEMA), partial / f"behavior_{identity}.parquet"
            )
            (partial / f"log_map_archive_{identity}.json").write_bytes(archive)
        written.append(folder / identity)
    return written


def _scenario(window: Tracks, focal: int, identity: str, city: str) -> pa.Table:
    """The official columns of one window."""
    row, step = np.nonzero(window.valid)
    observed = window.valid[:, OBSERVED_STEPS - 1]
    category = np.where(observed, UNSCORED, FRAGMENT)
    category[window.valid.all(axis=1)] = SCORED
    category[focal] = FOCAL
    types = np.array([WRITTEN_TYPES[KINDS[k]] for k in window.kind])
    heading, speed = window.heading[row, step], window.speed[row, step]
    start_ns = float(np.round(window.time_s[0] * 1e9))
    m = row.size
    columns: dict[str, Any] = {
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
    return pa.table({k: pa.array(v, type=SCHEMA.field(k).type) for k, v in columns.items()})


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
    yield recorded(stem(path), rows, notes).with_codes(labels)


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
        labels = np.array(window.names, dtype=object)
        tables = {
            folder / f"{name}-{number:04d}.csv": {
                "TIMESTAMP": window.time_s[step], "TRACK_ID": labels[row], "OBJECT_TYPE": role[row],
                "X": x, "Y": y, "CITY_NAME": CITY,
            },
            folder / f"{name}-{number:04d}{LABELS_SUFFIX}": {
                "TRACK_ID": labels, "KIND": [KINDS[kind].value for kind in window.kind],
                "BEHAVIOR": behavior_words(window),
            },
        }  # fmt: skip
        for path, columns in tables.items():
            text = pandas.DataFrame(columns).to_csv(index=False, lineterminator="\n")
            write_whole(path, text.encode())
            written.append(path)
    return written


# --- sensor logs of Argoverse 2 -------------------------------------------------------------------

POSES: Final = "city_SE3_egovehicle.feather"
"""The name of the file of the recording car's poses, beside that of the boxes."""

CATEGORIES: Final[dict[str, AgentKind]] = {
    "REGULAR_VEHICLE": AgentKind.CAR,
    **dict.fromkeys(("LARGE_VEHICLE", "TRUCK", "BOX_TRUCK", "TRUCK_CAB"), AgentKind.TRUCK),
    **dict.fromkeys(("BUS", "SCHOOL_BUS", "ARTICULATED_BUS", "RAILED_VEHICLE"), AgentKind.BUS),
    "MOTORCYCLIST": AgentKind.MOTORCYCLE,
    **dict.fromkeys(("BICYCLIST", "WHEELED_RIDER"), AgentKind.BICYCLE),
    **dict.fromkeys(("PEDESTRIAN", "OFFICIAL_SIGNALER"), AgentKind.PEDESTRIAN),
}
"""Categories that are road-agents. The others are left out: things, animals, trailers, and
two-wheelers and devices, whose riders have boxes of their own."""

EGO_NAME: Final = "AV"
EGO_CATEGORY: Final = "EGO_VEHICLE"
"""Category under which some copies of a log list the recording car, whose poses are read anyway."""

EGO_SIZE_M: Final = (4.87, 1.85)
"""Length and width of the recording car, a Ford Fusion Hybrid (191.8 by 72.9 inches by its maker);
the format does not tell them."""

EGO_CENTRE_M: Final = 1.34
"""How far the car's centre is ahead of its frame's origin, which is the rear axle's centre (an
estimate, since the format does not tell: py123d takes 1.339 m for this car)."""

UNIT_TOLERANCE: Final = 0.01
"""How far the length of a quaternion may be from one (rounding to six digits stays far below)."""

_TURN: Final = ["qw", "qx", "qy", "qz"]
_PLACE: Final = ["tx_m", "ty_m", "tz_m"]


def read_log(path: Path) -> Iterator[Recording]:
    """The recording of one log in the city's frame, called like the log's folder.

    Its times are those of the sweeps that have boxes, s from the first.
    """
    numbers = ("timestamp_ns", *_TURN, *_PLACE, "length_m", "width_m")
    boxes = read_table(path, numbers, ("track_uuid", "category"))
    poses = beside(path, POSES)
    if poses is None:
        raise InputError(
            f"{path}: found no {POSES} beside it, expected it: without it the recording car's "
            "motion cannot be undone"
        )
    sweeps, boxes["sweep"] = np.unique(whole(boxes, "timestamp_ns"), return_inverse=True)
    turn, place = _poses_at(poses, sweeps)
    time_s = (sweeps - sweeps[0]) / 1e9

    boxes, others = among(boxes, "category", CATEGORIES)
    at = boxes["sweep"].to_numpy()
    xy = np.einsum("nij,nj->ni", turn[at, :2], boxes[_PLACE].to_numpy()) + place[at, :2]
    ahead = np.einsum("nij,nj->ni", turn[at, :2], _rotations(path, boxes)[:, :, 0])
    centre = place[:, :2] + EGO_CENTRE_M * turn[:, :2, 0]
    agents = pandas.DataFrame(
        {"id": boxes["track_uuid"], "t": time_s[at], "x": xy[:, 0], "y": xy[:, 1],
         "heading": np.arctan2(ahead[:, 1], ahead[:, 0]), "length": boxes["length_m"],
         "width": boxes["width_m"], "kind": kinds_in(boxes["category"], CATEGORIES)}
    )  # fmt: skip
    ego = pandas.DataFrame(
        {"id": EGO_NAME, "t": time_s, "x": centre[:, 0], "y": centre[:, 1],
         "heading": np.arctan2(turn[:, 1, 0], turn[:, 0, 0]), "length": EGO_SIZE_M[0],
         "width": EGO_SIZE_M[1], "kind": AgentKind.CAR.code}
    )  # fmt: skip
    notes = [
        f"the recording car's motion is undone with its poses; it is the agent {EGO_NAME}, a Ford "
        f"Fusion of {EGO_SIZE_M[0]:g} by {EGO_SIZE_M[1]:g} m",
        "speeds are taken from the motion",
    ]
    notes += left_out(set(others) - {EGO_CATEGORY})
    home = path.absolute().parent
    maps = [*home.glob("map/log_map_archive_*.json"), *home.glob("log_map_archive_*.json")]
    if len(maps) > 1:
        notes.append(f"found {len(maps)} maps: none is used")
    road = maps[0] if len(maps) == 1 and read_map(maps[0]) is not None else None
    if road is not None:
        notes.append(MAP_NOTE)
    yield recorded(home.name, pandas.concat([agents, ego]), notes, road, own_road=True)


def _rotations(path: Path, table: pandas.DataFrame) -> FloatArray:
    """(rows, 3, 3) rotations of a table's unit quaternions."""
    quaternion = table[_TURN].to_numpy()
    length = np.sqrt((quaternion**2).sum(axis=1))
    bad = ~(np.abs(length - 1) <= UNIT_TOLERANCE)
    if bad.any():
        raise InputError(
            f"{path}: columns {', '.join(_TURN)}: found length {length[bad][0]:g} in row "
            f"{table.index[bad][0]}, expected 1"
        )
    return np.asarray(Rotation.from_quat(quaternion, scalar_first=True).as_matrix())


def _poses_at(path: Path, sweeps: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """(sweeps, 3, 3) rotation and (sweeps, 3) place of the recording car at each sweep, m."""
    poses = read_table(path, ("timestamp_ns", *_TURN, *_PLACE))
    with broken_as_one_line(path, "poses"):
        stamp = whole(poses, "timestamp_ns")
    unique, first, count = np.unique(stamp, return_index=True, return_counts=True)
    at = np.minimum(np.searchsorted(unique, sweeps), unique.size - 1)
    for wrong, found in ((unique[at] != sweeps, "no pose"), (count[at] > 1, "several poses")):
        if wrong.any():
            raise InputError(
                f"{path}: column timestamp_ns: found {found} at {sweeps[wrong.argmax()]}, expected "
                "one at each annotated sweep"
            )
    return _rotations(path, poses)[first[at]], poses[_PLACE].to_numpy()[first[at]]
