"""Recordings for a benchmark of prediction: datasets, recording sites, instants, scored agents.

Scored vehicles move (at least `MOVING_MPS`, or `MOVED_M` within the last `PAST_S`), and are seen
for `PAST_S` and the next `AHEAD_S`. Constant velocity, by which all errors are divided, goes on
with the mean velocity of the last `VELOCITY_S`. Instants are samples of the recording: between
samples the future would leak into an interpolated past.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from experiments.console.notices import LOGGER
from experiments.console.progress import Progress
from experiments.score.predictions import HISTORY_S, future, spaced
from graphrqi.predict.networks import TIME_S
from graphrqi.predict.recorded.features import inferred_leaders
from sim.formats import get_reader, recognise, recording_files
from sim.frames import PEDESTRIAN, BoolArray, FloatArray, IntArray, Tracks
from sim.road import Road
from sim.road.road_files import read_road_file
from sim.store.dataset import is_dataset, open_dataset

PAST_S, AHEAD_S, VELOCITY_S = 3.0, float(TIME_S[-1]), 0.5
"""Least past of a scored agent, how far ahead is predicted, and the past over which constant
velocity averages, s."""

MOVING_MPS, MOVED_M = 1.0, 1.0
"""Agents that count as moving have at least this speed, m/s, or moved by this distance within the
last `PAST_S`, m."""

CLASSES: Final = ("standing", "slow", "free", "following")
STANDING_MPS, SLOW_MPS, FOLLOWING_S, FOLLOWING_M = 0.5, 5.0, 3.0, 15.0
"""Classes of vehicles by their past. A standing vehicle is slower than the first and has moved by
less than half a metre; a slow one is below the second, m/s. A follower has a leader within the
third, s, or the last, m."""

MOST_NOISE_M: Final = 0.2
"""Episodes that say that they are shakier are left out."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPlace:
    """One recording, the name of its dataset's folder, and the map that came with it, or None."""

    dataset: str
    tracks: Tracks
    road: Road | None


def by_dataset(
    sources: Sequence[Path], maps: bool = True, quiet: bool = True
) -> dict[str, list[RecordedPlace]]:
    """The recordings of datasets of ours, files and folders, by the names of their datasets.

    A folder that holds no recordings itself is a folder of datasets, one in each subfolder.
    Unknown formats and broken files are left out, each with a line on stderr. Roads are read only
    if ``maps`` are wanted.

    Raises:
        InputError: if there is nothing at a path.
    """
    found: dict[str, list[RecordedPlace]] = {}
    with Progress("reading recordings", 0, quiet) as progress:
        for source in sources:
            if not source.exists():
                raise InputError(f"{source}: found nothing, expected a dataset or a recording")
            for folder in _datasets_in(source):
                for one in (_stored if is_dataset(folder) else _read)(folder, maps):
                    found.setdefault(one.dataset, []).append(one)
                    progress.advance(one.tracks.ids.size, int(one.tracks.valid.sum()))
    return dict(sorted(found.items()))


def _datasets_in(source: Path) -> list[Path]:
    if source.is_file() or is_dataset(source):
        return [source]
    below = sorted(path for path in source.iterdir() if path.is_dir())
    own_files = any(path.is_file() and path.suffix in (".csv", ".gz", ".xml", ".parquet")
                    for path in source.iterdir())  # fmt: skip
    return [source] if own_files or not below else below


def _stored(folder: Path, maps: bool) -> Iterator[RecordedPlace]:
    """The episodes of a dataset but those in pixels, and those too shaky to know their future."""
    dataset = open_dataset(folder)
    for entry in dataset.episodes():
        names = ("pixels_per_m", "noise_m")
        scale, noise_m = (float(str(entry.options.get(name) or 0.0)) for name in names)
        if not scale and noise_m <= MOST_NOISE_M:
            road = dataset.road(entry) if maps else None
            yield RecordedPlace(folder.name, dataset.read(entry).tracks, road)


def _read(folder: Path, maps: bool) -> Iterator[RecordedPlace]:
    """The recordings of a file or folder."""
    read_road = lru_cache(maxsize=1)(read_road_file)
    try:
        form = recognise(folder)
        files = recording_files(folder, form)
    except InputError as error:
        LOGGER.warning("left out: %s", error)
        return
    for file in files:
        try:
            for recording in get_reader(form)(file):
                road = recording.road if maps else None
                road = read_road(road) if isinstance(road, Path) else road
                yield RecordedPlace(folder.name, recording.tracks, road)
        except InputError as error:
            LOGGER.warning("left out: %s", error)


def moving_s(places: Sequence[RecordedPlace]) -> float:
    """For how long vehicles move in recordings, all together, s."""
    tracks = [one.tracks for one in places if one.tracks.time_s.size > 1]
    return float(sum(each.step_s * (each.row_speed >= MOVING_MPS).sum() for each in tracks))


def history_of(tracks: Tracks, stop: int) -> Tracks:
    """Input of a predictor at an instant: the last `HISTORY_S`."""
    return tracks.window(stop, round(HISTORY_S / tracks.step_s) + 1)


def cases(tracks: Tracks, every_s: float) -> Iterator[tuple[int, Tracks, FloatArray, BoolArray]]:
    """Instants with vehicles that are scored: index, history, future and who counts.

    Counted (n,) are vehicles seen for `PAST_S` whose future (n, KNOTS, 2), m, is known.
    """
    known_s = tracks.time_s[tracks.time_s + AHEAD_S <= tracks.time_s[-1:] + 1e-3]
    for stop in spaced(known_s, PAST_S, every_s, 1e-3):
        history = history_of(tracks, stop)
        truth = future(tracks, np.searchsorted(tracks.ids, history.ids), stop, TIME_S)
        counts = _scored(history) & np.isfinite(truth).all(axis=(1, 2))
        if counts.any():
            yield stop, history, truth, counts


def _scored(history: Tracks) -> BoolArray:
    """(n,) agents that the past admits to scoring: vehicles seen for `PAST_S`."""
    ago = history.time_s - history.time_s[-1]
    first = history.valid.argmax(axis=1)
    return np.asarray((history.kind != PEDESTRIAN) & (-ago[first] >= PAST_S - 1e-2))


def _moved_m(history: Tracks) -> FloatArray:
    """(n,) how far each is from where it was `PAST_S` ago, m."""
    ago = history.time_s - history.time_s[-1]
    first = history.valid.argmax(axis=1)
    column = np.maximum(first, int(np.searchsorted(ago, -PAST_S - 1e-3)))
    then = history.xy[np.arange(first.size), column]
    return np.asarray(np.linalg.norm(history.xy[:, -1] - then, axis=1))


def moving(history: Tracks) -> BoolArray:
    """(n,) moving agents among the scored ones."""
    return _scored(history) & ((_moved_m(history) > MOVED_M) | (history.speed[:, -1] >= MOVING_MPS))


def classes_of(history: Tracks) -> IntArray:
    """(n,) codes into `CLASSES`, as recorded."""
    speed = history.speed[:, -1]
    leader, gap = inferred_leaders(history)
    follows = (leader >= 0) & (gap < np.maximum(FOLLOWING_S * speed, FOLLOWING_M))
    stands = (speed < STANDING_MPS) & (_moved_m(history) < STANDING_MPS)
    code = np.where(follows, 3, 2)
    return np.where(stands, 0, np.where(speed < SLOW_MPS, 1, code))


def steady_motion(history: Tracks, time_s: FloatArray) -> FloatArray:
    """(n, H, 2) positions at the mean velocity of the last `VELOCITY_S`, m."""
    ago, here = history.time_s - history.time_s[-1], history.xy[:, -1]
    velocity = np.zeros_like(here)
    if ago.size > 1:
        latest = min(int(np.searchsorted(ago, -VELOCITY_S - 1e-2)), ago.size - 2)
        seen = history.valid[:, : latest + 1]
        column = np.where(seen, np.arange(latest + 1), -1).max(axis=1)
        column = np.where(column < 0, history.valid.argmax(axis=1), column)
        passed = np.maximum(-ago[column], 1e-3)
        velocity = (here - history.xy[np.arange(column.size), column]) / passed[:, None]
    return np.asarray(here[:, None] + velocity[:, None] * time_s[:, None])
