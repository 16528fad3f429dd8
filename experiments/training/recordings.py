"""Recordings for a benchmark of prediction: datasets, recording sites, instants, scored agents.

Scored vehicles move (at least `MOVING_MPS`, or `MOVED_M` within the last `PAST_S`), and are seen
for `PAST_S` and the next `AHEAD_S`. Constant velocity, by which all errors are divided, goes on
with the mean velocity of the last `VELOCITY_S`. Instants are samples of the recording: between
samples the future would leak into an interpolated past.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from experiments.score.predictions import HISTORY_S, future
from graphrqi.predict.networks.futures import TIME_S
from graphrqi.predict.recorded.gaps import inferred_leaders
from sim.formats import get_reader, recognise, recording_files
from sim.formats.common.recording import Recording
from sim.frames import PEDESTRIAN, BoolArray, FloatArray, IntArray, Tracks
from sim.road import Road
from sim.road.files import read_road_file
from sim.store.catalogue import is_dataset
from sim.store.dataset import open_dataset

PAST_S: Final = 3.0
"""Least past of a scored agent, s."""

AHEAD_S: Final = float(TIME_S[-1])
"""How far ahead is predicted, s."""

MOVING_MPS, MOVED_M = 1.0, 1.0
"""Agents that count as moving have at least this speed, m/s, or moved by this distance within the
last `PAST_S`, m."""

CLASSES: Final = ("standing", "slow", "free", "following")
"""Classes of vehicles by their past."""

STANDING_MPS, SLOW_MPS = 0.5, 5.0
"""A standing vehicle is slower than the first and has moved by less than half a metre; a slow one
is below the second, m/s."""

FOLLOWING_S, FOLLOWING_M = 3.0, 15.0
"""A follower has a leader within this time or distance."""

VELOCITY_S: Final = 0.5
"""Past over which constant velocity averages, s."""

FAMILIES: Final[tuple[tuple[str, str], ...]] = (
    ("roundabout", "roundabout"), ("round", "roundabout"), ("merging", "ramp"), ("exid", "ramp"),
    ("ramp", "ramp"), ("us101", "motorway"), ("us_101", "motorway"), ("i80", "motorway"),
    ("i_80", "motorway"), ("highd", "motorway"), ("motorway", "motorway"),
    ("freeway", "motorway"), ("kitti", "urban from a car"), ("av2", "urban from a car"),
    ("argoverse", "urban from a car"), ("waymo", "urban from a car"), ("womd", "urban from a car"),
    ("nuplan", "urban from a car"), ("nuscenes", "urban from a car"),
    ("lanker", "junction"), ("peach", "junction"), ("sind", "junction"), ("fzi", "junction"),
    ("ind", "junction"), ("intersection", "junction"), ("junction", "junction"),
)  # fmt: skip
"""Families by what the name of a dataset or place holds, the first that fits; else `OTHER`."""

OTHER: Final = "other"

MOST_NOISE_M: Final = 0.2
"""Episodes that say that they are shakier are left out."""

FAMILY_FILE: Final = "family.txt"
"""A dataset's folder may name its family in this file."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPlace:
    """One recording.

    Attributes:
        dataset: name of the folder it is from.
        family: what kind of place it is.
        place: where it was recorded: the subfolder, or the dataset where there is none.
        name: its own.
        tracks: what was recorded.
        road: the map that came with it, or None.
    """

    dataset: str
    family: str
    place: str
    name: str
    tracks: Tracks
    road: Road | None


def family_of(name: str, folder: Path | None = None) -> str:
    """The family of a dataset or place by its name, or as its folder says.

    Examples:
        >>> family_of("ngsim_us101"), family_of("DR_USA_Roundabout_FT"), family_of("elsewhere")
        ('motorway', 'roundabout', 'other')
    """
    if folder is not None and (folder / FAMILY_FILE).is_file():
        return (folder / FAMILY_FILE).read_text(encoding="utf-8").strip() or OTHER
    lower = name.lower()
    return next((family for part, family in FAMILIES if part in lower), OTHER)


def read_sources(sources: Sequence[Path], maps: bool = True) -> Iterator[RecordedPlace]:
    """The recordings of datasets, files and folders.

    A folder that holds no recordings itself is a folder of datasets, one in each subfolder.
    Unknown formats and broken files are left out, each with a line on stderr.

    Args:
        sources: datasets of ours, recordings, folders of them, or folders of such folders.
        maps: whether the roads are wanted.

    Yields:
        Recordings, in order of the files' names.

    Raises:
        InputError: if there is nothing at a path.
    """
    for source in sources:
        if not source.exists():
            raise InputError(f"{source}: found nothing there, expected a dataset or a recording")
        for folder in _datasets_in(source):
            yield from read_place_folder(folder, maps)


def _datasets_in(source: Path) -> list[Path]:
    if source.is_file() or is_dataset(source):
        return [source]
    below = sorted(path for path in source.iterdir() if path.is_dir())
    own_files = any(path.is_file() and path.suffix in (".csv", ".gz", ".xml", ".parquet")
                    for path in source.iterdir())  # fmt: skip
    return [source] if own_files or not below else below


def read_place_folder(folder: Path, maps: bool = True) -> Iterator[RecordedPlace]:
    """The recordings of one dataset; see `read_sources`."""
    dataset = folder.name
    family = family_of(dataset, folder if folder.is_dir() else None)
    if is_dataset(folder):
        stored = open_dataset(folder)
        for entry in stored.episodes():
            if _unfit(entry.options):
                continue
            road = stored.road(entry) if maps else None
            name = str(entry.options.get("recording", entry.id))
            tracks = stored.read(entry).tracks
            yield RecordedPlace(dataset, family, f"{dataset}/{entry.id}", name, tracks, road)
        return
    try:
        form = recognise(folder)
    except InputError as error:
        sys.stderr.write(f"graphrqi: left out: {error}\n")
        return
    roads: dict[Path, Road] = {}
    for file in recording_files(folder, form):
        place = dataset
        if folder.is_dir() and file.parent != folder:
            place = f"{dataset}/{file.parent.relative_to(folder).parts[0]}"
        try:
            for recording in get_reader(form)(file):
                road = _road_of(recording, roads) if maps else None
                known = family if family != OTHER else family_of(f"{place}/{recording.name}")
                yield RecordedPlace(dataset, known, place, recording.name, recording.tracks, road)
        except InputError as error:
            sys.stderr.write(f"graphrqi: left out: {error}\n")


def _road_of(recording: Recording, roads: dict[Path, Road]) -> Road | None:
    """The map that came with a recording; the last one read is kept in ``roads``."""
    if recording.road is None or isinstance(recording.road, Road):
        return recording.road
    if recording.road not in roads:
        roads.clear()
        roads[recording.road] = read_road_file(recording.road)
    return roads[recording.road]


def _unfit(options: Mapping[str, Any]) -> bool:
    """Whether an episode is in pixels, or so shaky that its future is not known."""
    return (
        float(options.get("pixels_per_m") or 0.0) > 0.0
        or float(options.get("noise_m") or 0.0) > MOST_NOISE_M
    )


def recorded_instants(tracks: Tracks, every_s: float) -> list[int]:
    """Indices one past each present, `PAST_S` after the start and `AHEAD_S` before the end."""
    time_s = tracks.time_s
    if time_s.size < 2:
        return []
    due, found = time_s[0] + PAST_S, []
    for column, now in enumerate(time_s):
        if now + AHEAD_S > time_s[-1] + 1e-3:
            break
        if now >= due - 1e-3:
            found.append(column + 1)
            due = now + every_s
    return found


def history_of(tracks: Tracks, stop: int) -> Tracks:
    """Input of a predictor at an instant: the last `HISTORY_S`."""
    return tracks.window(stop, round(HISTORY_S / tracks.step_s) + 1)


def scored(history: Tracks) -> BoolArray:
    """(n,) agents that the past admits to scoring: vehicles seen for `PAST_S`."""
    ago = history.time_s - history.time_s[-1]
    first = history.valid.argmax(axis=1)
    return np.asarray((history.kind != PEDESTRIAN) & (-ago[first] >= PAST_S - 1e-2))


def moved_m(history: Tracks) -> FloatArray:
    """(n,) how far each is from where it was `PAST_S` ago, m."""
    ago = history.time_s - history.time_s[-1]
    first = history.valid.argmax(axis=1)
    column = np.maximum(first, int(np.searchsorted(ago, -PAST_S - 1e-3)))
    then = history.xy[np.arange(first.size), column]
    return np.asarray(np.linalg.norm(history.xy[:, -1] - then, axis=1))


def moving(history: Tracks) -> BoolArray:
    """(n,) moving agents among the scored ones."""
    return scored(history) & ((moved_m(history) > MOVED_M) | (history.speed[:, -1] >= MOVING_MPS))


def classes_of(history: Tracks) -> IntArray:
    """(n,) codes into `CLASSES`, as recorded."""
    speed = history.speed[:, -1]
    leader, gap = inferred_leaders(history)
    follows = (leader >= 0) & (gap < np.maximum(FOLLOWING_S * speed, FOLLOWING_M))
    stands = (speed < STANDING_MPS) & (moved_m(history) < STANDING_MPS)
    code = np.where(follows, 3, 2)
    return np.where(stands, 0, np.where(speed < SLOW_MPS, 1, code))


def steady_motion(history: Tracks, time_s: FloatArray) -> FloatArray:
    """(n, H, 2) positions at the mean velocity of the last `VELOCITY_S`, m."""
    ago = history.time_s - history.time_s[-1]
    n = history.ids.size
    if ago.size < 2:
        still = np.zeros((n, 1, 2))
    else:
        latest = min(int(np.searchsorted(ago, -VELOCITY_S - 1e-2)), ago.size - 2)
        seen = history.valid[:, : latest + 1]
        column = np.where(seen, np.arange(latest + 1), -1).max(axis=1)
        column = np.where(column < 0, history.valid.argmax(axis=1), column)
        passed = np.maximum(-ago[column], 1e-3)
        moved = history.xy[:, -1] - history.xy[np.arange(n), column]
        still = (moved / passed[:, None])[:, None]
    return np.asarray(history.xy[:, -1][:, None] + still * time_s[:, None])


def happened(tracks: Tracks, history: Tracks, stop: int) -> FloatArray:
    """(n, KNOTS, 2) where a history's agents went, m; NaN where that was not seen."""
    return future(tracks, np.searchsorted(tracks.ids, history.ids), stop, TIME_S)
