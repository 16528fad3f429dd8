"""Recordings without labels: do beliefs about drivers say what they do later?

Each driver's track is halved. What a stream believes at the end of the first half is compared with
what the driver does in the second, and with what another stream, to which the driver is new then,
believes at the end of that. Nothing is true or false here: a belief that says something about a
driver is one that comes again and that goes with its driving.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.benches.classification.rows import keys_of
from experiments.data.admission import admitted
from experiments.data.parallel import in_parallel
from experiments.rows import Row, tidy_row
from experiments.scoring.second_half import MEASURES, halves, measured
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.posterior import aggressive_share
from graphrqi.stream import BehaviorStream
from sim.formats import FORMATS, formats_in, read_recordings, recording_files
from sim.formats.common.recording import Recording
from sim.frames import PEDESTRIAN, Tracks
from sim.store.catalogue import is_dataset

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PROTOCOL: Final = "recorded"

LEAST_SEEN_S: Final = 3.0
"""Drivers that are seen for less do not count in shares (what is believed of them is mostly the
prior)."""

LEAST_DRIVERS: Final = 10
"""Fewer drivers make no correlation."""

RESAMPLES: Final = 1000
"""Bootstrap resamples of drivers."""


@dataclass(frozen=True, slots=True)
class Drivers:
    """What is believed of the drivers of one or several recordings, and what they do.

    Attributes:
        halves: (n, 2, 6) beliefs at the end of each half; NaN where the stream gave none.
        does: (n, 2, 4) ``MEASURES`` in each half.
        life: (m, 6) beliefs about everyone seen for ``LEAST_SEEN_S`` at the end of its life.
        unknown: (m,) 1 for those of them who have no answer, else 0.
        doubted: how many of all recordings are no scene.
        recordings: how many there are.
    """

    halves: FloatArray
    does: FloatArray
    life: FloatArray
    unknown: FloatArray
    doubted: int
    recordings: int

    @staticmethod
    def join(parts: Sequence[Drivers]) -> Drivers:
        """All drivers of several recordings."""
        return Drivers(
            halves=np.concatenate([p.halves for p in parts]),
            does=np.concatenate([p.does for p in parts]),
            life=np.concatenate([p.life for p in parts]),
            unknown=np.concatenate([p.unknown for p in parts]),
            doubted=sum(p.doubted for p in parts),
            recordings=sum(p.recordings for p in parts),
        )


def cut_in_half(tracks: Tracks, rows: IntArray, middle: IntArray) -> Tracks:
    """The same scene, in which chosen drivers are new ones from a time of their own on.

    Args:
        tracks: any recording.
        rows: (n,) whose.
        middle: (n,) first column of the second half.

    Returns:
        Tracks in which the agent of row r has the id 2 r, and 2 r + 1 in its second half.
    """
    columns = np.arange(tracks.time_s.size)
    late = np.zeros(tracks.valid.shape, dtype=bool)
    late[rows] = columns >= middle[:, None]
    source = np.concatenate([np.arange(tracks.ids.size), rows])
    ids = np.concatenate([2 * np.arange(tracks.ids.size), 2 * rows + 1])
    valid = np.concatenate([tracks.valid & ~late, tracks.valid[rows] & late[rows]])
    order = np.argsort(ids)
    source, valid = source[order], valid[order]

    def seen(values: FloatArray) -> FloatArray:
        shape = valid.reshape(*valid.shape, *[1] * (values.ndim - 2))
        return np.where(shape, values[source], np.nan)

    return dataclasses.replace(
        tracks, ids=ids[order], names=tuple(tracks.names[r] for r in source),
        kind=tracks.kind[source], length=tracks.length[source], width=tracks.width[source],
        xy=seen(tracks.xy), heading=seen(tracks.heading), speed=seen(tracks.speed), valid=valid,
        behavior=None, events=(),
    )  # fmt: skip


def last_beliefs(
    tracks: Tracks, model: Model, is_scene: bool = True
) -> tuple[FloatArray, FloatArray]:
    """(N, 6) what a stream believes of each agent when it is last seen, and (N,) how unknown it is.

    NaN where it gives no answer. ``is_scene`` is that of `graphrqi.stream.BehaviorStream`.
    """
    stream = BehaviorStream(model, is_scene=is_scene, traffic="recorded")
    last = tracks.time_s.size - 1 - tracks.valid[:, ::-1].argmax(axis=1)
    leaving: dict[int, list[int]] = {}
    for row in np.flatnonzero(tracks.valid.any(axis=1) & (tracks.kind != PEDESTRIAN)).tolist():
        leaving.setdefault(int(last[row]), []).append(row)
    beliefs = np.full((tracks.ids.size, len(BEHAVIORS)), np.nan)
    unknown = np.ones(tracks.ids.size)
    for step, frame in enumerate(tracks.frames()):
        stream.push(frame)
        if step not in leaving:
            continue
        posterior = stream.posterior()
        for row in leaving[step]:
            at = int(np.searchsorted(posterior.ids, tracks.ids[row]))
            if at < posterior.ids.size and posterior.ids[at] == tracks.ids[row]:
                beliefs[row] = posterior.probability[at]
                unknown[row] = not posterior.told[at]
    return beliefs, unknown


@lru_cache(maxsize=1)
def _model(name: str) -> Model:
    return load_model(name)


def drivers_of(recording: Recording, unit: str, model: str) -> Drivers:
    """Beliefs about the drivers of one recording, and what they do.

    Args:
        recording: as read.
        unit: of its format.
        model: a shipped model's name or a folder.
    """
    recording, doubt = admitted(recording, unit)
    tracks = recording.tracks
    if tracks.time_s.size < 2:
        none = np.zeros((0, 2, len(BEHAVIORS)))
        return Drivers(none, np.zeros((0, 2, len(MEASURES))), none[:, 0], np.zeros(0), 0, 1)
    trained = _model(model)
    rows, begins, _ = halves(tracks)
    found = np.zeros((0, 2, len(BEHAVIORS)))
    if rows.size:
        cut = cut_in_half(tracks, rows, begins[:, 1])
        beliefs, _ = last_beliefs(cut, trained)
        at = np.searchsorted(cut.ids, np.stack([2 * rows, 2 * rows + 1], axis=1))
        found = beliefs[at]
    life, unknown = last_beliefs(tracks, trained, doubt is None)
    first = tracks.valid.argmax(axis=1)
    last = tracks.time_s.size - 1 - tracks.valid[:, ::-1].argmax(axis=1)
    seen_s = tracks.time_s[last] - tracks.time_s[first]
    shown = np.isfinite(life[:, 0]) & (seen_s >= LEAST_SEEN_S - 1e-6)
    return Drivers(found, measured(tracks), life[shown], unknown[shown], int(doubt is not None), 1)


def recordings_of(folder: Path, say: Callable[[str], None]) -> Iterator[tuple[Recording, str]]:
    """Every recording of a folder, with its format's unit.

    Args:
        folder: of recordings, of one or several formats.
        say: takes a line about each file that cannot be read, such as a map of nobody.

    Yields:
        Recording and unit.

    Raises:
        InputError: if there is no file of any format.
    """
    for name in formats_in(folder):
        for file in recording_files(folder, name)[0]:
            try:
                for recording in read_recordings(file, name):
                    yield recording, FORMATS[name].unit
            except InputError as reason:
                say(f"{PROTOCOL}: left out {reason}")


def places_in(folder: Path) -> dict[str, Path]:
    """Places by name: the folders in a folder, and its own files; itself if it has no folder.

    Raises:
        InputError: if there is nothing.
    """
    if not folder.exists():
        raise InputError(f"{folder}: found nothing, expected a folder of recordings")
    if folder.is_file() or not any(inner.is_dir() for inner in folder.iterdir()):
        return {folder.name: folder}
    return {inner.name: inner for inner in sorted(folder.iterdir()) if inner.is_dir()}


def spearman(one: FloatArray, other: FloatArray) -> tuple[float, float, float]:
    """Rank correlation with its 95 % interval over resampled drivers.

    Args:
        one: (n,) values.
        other: (n,) values.

    Returns:
        Value, low, high; NaN where one of both is constant.

    Examples:
        >>> spearman(np.arange(20.0), np.arange(20.0) ** 3)[0]
        1.0
    """
    from scipy.stats import rankdata

    def correlation(a: FloatArray, b: FloatArray) -> FloatArray:
        a, b = rankdata(a, axis=-1), rankdata(b, axis=-1)
        a, b = a - a.mean(axis=-1, keepdims=True), b - b.mean(axis=-1, keepdims=True)
        spread = np.sqrt((a * a).sum(axis=-1) * (b * b).sum(axis=-1))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.where(spread > 0.0, (a * b).sum(axis=-1) / spread, np.nan))

    value = round(float(correlation(one, other)), 12)
    if not np.isfinite(value):
        return value, float("nan"), float("nan")
    drawn = np.random.default_rng(0).integers(0, one.size, (RESAMPLES, one.size))
    low, high = np.nanquantile(correlation(one[drawn], other[drawn]), [0.025, 0.975])
    return value, float(low), float(high)


def log_odds(probability: FloatArray) -> FloatArray:
    """(...) log-odds of the aggressive style, from beliefs (..., 6)."""
    aggressive = np.clip(aggressive_share(probability), 1e-6, 1.0 - 1e-6)
    return np.asarray(np.log(aggressive / (1.0 - aggressive)))


def place_rows(place: str, drivers: Drivers, model: str) -> list[Row]:
    """One row for each quantity of a place."""
    keys = keys_of(PROTOCOL, place, model, None)
    rows = [
        tidy_row(keys, "share_no_scene", drivers.doubted / drivers.recordings, None, None,
                 drivers.recordings),
    ]  # fmt: skip
    rows += _shares(drivers, {**keys, "variation": "whole life"})
    belief = log_odds(drivers.halves)
    keys = {**keys, "variation": "first half against second"}

    def compared(metric: str, one: FloatArray, other: FloatArray) -> None:
        both = np.isfinite(one) & np.isfinite(other)
        n = int(both.sum())
        if n >= LEAST_DRIVERS:
            value, low, high = spearman(one[both], other[both])
            if np.isfinite(value):  # where nobody changes lanes, nothing goes with lane changes
                rows.append(tidy_row(keys, metric, value, low, high, n))

    compared("spearman_split_half", belief[:, 0], belief[:, 1])
    for number, measure in enumerate(MEASURES):
        compared(f"spearman_{measure}", belief[:, 0], drivers.does[:, 1, number])
    for number, measure in enumerate(MEASURES):
        does = drivers.does[:, :, number]
        compared(f"persistence_{measure}", does[:, 0], does[:, 1])
    return rows


def _shares(drivers: Drivers, keys: dict[str, str | int | float | bool | None]) -> list[Row]:
    """How many drivers are told to be what, among those with an answer."""
    answered = drivers.unknown <= 0.5
    life, n = drivers.life[answered], int(answered.sum())
    if not drivers.life.size:
        return []
    style = aggressive_share(life)
    values: dict[str, NDArray[np.generic]] = {"share_aggressive": style > 0.5}
    likeliest = life.argmax(axis=1)
    values |= {f"share_{b.value}": likeliest == b.code for b in BEHAVIORS}
    values["style_confidence"] = np.maximum(style, 1.0 - style)
    rows = [_mean_row(keys, "share_unknown", ~answered, drivers.unknown.size)]
    return rows + [_mean_row(keys, name, shown, n) for name, shown in values.items() if n]


def _mean_row(
    keys: dict[str, str | int | float | bool | None], metric: str, values: NDArray[np.generic],
    n: int,
) -> Row:  # fmt: skip
    """A mean with its interval over drivers."""
    numbers = values.astype(np.float64)
    error = 1.96 * float(numbers.std()) / np.sqrt(max(n, 1))
    mean = float(numbers.mean())
    return tidy_row(keys, metric, mean, max(mean - error, 0.0), min(mean + error, 1.0), n)


def recorded_rows(
    folder: Path,
    model: str,
    jobs: int | None = None,
    most: int | None = None,
    say: Callable[[str], None] = lambda said: print(said, file=sys.stderr),
) -> Iterator[list[Row]]:
    """Measure every place in a folder.

    Args:
        folder: of recordings; the folders in it are the places.
        model: a shipped model's name or a folder.
        jobs: processes; None for one per core.
        most: recordings of a place; None for all.
        say: takes a line about what is left out.

    Yields:
        The rows of each place.

    Raises:
        InputError: if the folder is not there, or the model does not load.
    """
    load_model(model)  # refuses an unknown name before anything is read
    for place, inside in places_in(folder).items():
        if is_dataset(inside):
            say(f"{PROTOCOL}: {place} skipped: found a dataset, expected recordings")
            continue
        try:
            found = list(islice(recordings_of(inside, say), most))
        except InputError as reason:
            say(f"{PROTOCOL}: {place} skipped: {reason}")
            continue
        if not found:
            continue
        arguments = [(recording, unit, model) for recording, unit in found]
        parts = list(in_parallel(drivers_of, arguments, jobs))
        yield place_rows(place, Drivers.join(parts), Path(model).name)
