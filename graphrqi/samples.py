"""Labelled feature vectors of recordings, on which classifiers are trained and scored.

Every sample carries the episode, agent and time it comes from, so that data can be split by
episode and never by row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.features.kinematics import align
from graphrqi.features.observer import Observation, Observer
from sim.frames import Tracks

FloatArray = NDArray[np.float64]

WINDOWS_S: Final = (1.0, 2.0, 3.0, 5.0, 10.0, 15.0, 30.0, 60.0, float("inf"))
"""Lengths of the observation windows for training; the infinite one is a driver's life so far,
which is what a stream knows."""

SNAPSHOT_S: Final = 1.0
"""Time between snapshots of an observer's evidence: a window is the difference of two snapshots, so
its length is a multiple of this."""

MOVED_M: Final = 2.0
"""A driver counts as moving in a window if it moved farther than this."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Feature vectors with their labels and origins.

    Attributes:
        features: (n, F) float32.
        codes: (n,) true classes, codes into ``BEHAVIORS``.
        episode: (n,) number of the episode.
        agent: (n,) agent id within the episode.
        time_s: (n,) end of the observation, s.
        seconds: (n,) length of the observation, s.
        window_s: (n,) length requested, s; inf for a driver's life so far.
        moving: (n,) whether the driver moved in it.
    """

    features: NDArray[np.float32]
    codes: NDArray[np.int8]
    episode: NDArray[np.int64]
    agent: NDArray[np.int64]
    time_s: FloatArray
    seconds: FloatArray
    window_s: FloatArray
    moving: NDArray[np.bool_]

    def __len__(self) -> int:
        """The number of samples."""
        return int(self.codes.size)

    def where(self, chosen: NDArray[np.bool_]) -> Samples:
        """The samples for which ``chosen`` holds."""
        return Samples(*(getattr(self, f.name)[chosen] for f in fields(self)))

    @staticmethod
    def join(parts: Sequence[Samples]) -> Samples:
        """All samples of several collections.

        Raises:
            InputError: if there is nothing to join.
        """
        if not parts:
            raise InputError("samples: found no episode, expected at least one")
        return Samples(
            *(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Samples))
        )


class NoSamplesError(InputError):
    """A recording without any sample; callers may skip it."""


@dataclass(frozen=True, slots=True)
class _Snapshot:
    """An observer's evidence at one time, and the drivers' positions (n, 2), m."""

    time_s: float
    seen: Observation
    xy: FloatArray


@dataclass(frozen=True, slots=True)
class _Window:
    """Observations of one length that end now, of the drivers in ``rows`` of the last snapshot."""

    rows: NDArray[np.int64]
    features: FloatArray
    seconds: FloatArray
    moving: NDArray[np.bool_]


def collect(
    tracks: Tracks,
    observer: Observer,
    episode: int = 0,
    windows_s: Sequence[float] = WINDOWS_S,
    every_s: float = 1.0,
    per_moment: int | None = None,
    seed: int = 0,
) -> Samples:
    """Run an observer over a recording and cut windows out of its evidence.

    Args:
        tracks: with labels in ``tracks.behavior``.
        observer: a fresh one.
        episode: the samples' episode number.
        windows_s: requested lengths of observation; ``inf`` is a driver's life so far.
        every_s: time between the ends of windows.
        per_moment: number of lengths drawn for each driver and moment; None takes all.
        seed: of that draw.

    Returns:
        One sample per labelled driver, moment and window that fits into its life.

    Raises:
        NoSamplesError: if the recording has no labels, or shows no driver for long enough.
    """
    if tracks.behavior is None:
        raise NoSamplesError("tracks.behavior: found no labels, expected one per agent")
    rng = np.random.default_rng(seed)
    snapshot_s = min(SNAPSHOT_S, every_s)
    longest_s = max((w for w in windows_s if np.isfinite(w)), default=0.0)
    snapshots: list[_Snapshot] = []
    parts: list[Samples] = []
    for frame in tracks.frames():
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        passed_s = frame.time_s - float(tracks.time_s[0])
        if not _due(passed_s, snapshot_s, tracks.step_s):
            continue
        seen = observer.observation()
        xy = frame.xy[np.searchsorted(frame.ids, seen.ids)]
        snapshots.append(_Snapshot(frame.time_s, seen, xy))
        while snapshots[0].time_s < frame.time_s - longest_s - 1e-6:
            snapshots.pop(0)
        if not _due(passed_s, every_s, tracks.step_s):
            continue
        codes = tracks.behavior[np.searchsorted(tracks.ids, seen.ids)]
        rank = rng.random((seen.ids.size, len(windows_s))).argsort(axis=1).argsort(axis=1)
        for column, window_s in enumerate(windows_s):
            window = _cut(snapshots, window_s, observer, snapshot_s)
            if window is None:
                continue
            kept = codes[window.rows] >= 0
            if per_moment is not None:
                kept &= rank[window.rows, column] < per_moment
            rows, n = window.rows[kept], int(kept.sum())
            parts.append(
                Samples(
                    features=window.features[kept].astype(np.float32),
                    codes=codes[rows],
                    episode=np.full(n, episode, dtype=np.int64),
                    agent=seen.ids[rows],
                    time_s=np.full(n, frame.time_s),
                    seconds=window.seconds[kept],
                    window_s=np.full(n, window_s),
                    moving=window.moving[kept],
                )
            )
    if not parts:
        raise NoSamplesError(
            f"tracks: found no driver observed for {min(windows_s):g} s, expected at least one"
        )
    return Samples.join(parts)


def _due(passed_s: float, every_s: float, step_s: float) -> bool:
    """Whether this frame is the nearest one to a whole number of intervals, at least one."""
    due = passed_s / every_s
    return round(due) >= 1 and abs(due - round(due)) <= 0.25 * step_s / every_s


def _cut(
    snapshots: list[_Snapshot], window_s: float, observer: Observer, snapshot_s: float
) -> _Window | None:
    """The window of one length that ends at the last snapshot; None before it fits anybody."""
    last = snapshots[-1]
    now = last.seen
    if not np.isfinite(window_s):
        long_enough = now.seconds >= snapshot_s - 1e-6
        rows, life = np.flatnonzero(long_enough), now.where(long_enough)
        features = observer.features(life.seconds, life.sums, life.instant)
        return _Window(rows, features, life.seconds, np.ones(rows.size, dtype=bool))
    start_s = last.time_s - window_s
    first = next((s for s in snapshots if abs(s.time_s - start_s) < 0.25 * snapshot_s), None)
    if first is None:
        return None
    past = first.seen
    rows, before = align(past.ids, now.ids)
    if rows.size == 0:
        return None
    seconds = now.seconds[rows] - past.seconds[before]
    whole = seconds > window_s - 0.5 * snapshot_s  # a driver that returned is a new one
    rows, before, seconds = rows[whole], before[whole], seconds[whole]
    sums = now.sums[rows] - past.sums[before]
    features = observer.features(seconds, sums, now.instant[rows])
    moving = np.hypot(*(last.xy[rows] - first.xy[before]).T) > MOVED_M
    return _Window(rows, features, seconds, moving)
