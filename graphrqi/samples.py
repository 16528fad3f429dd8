"""Labelled feature vectors from recordings: what classifiers are trained and scored on.

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
"""Lengths of the stretches of observation that are trained on (our choice); the last is a driver's
life so far, which is what a stream knows."""

LOOK_S: Final = 1.0
"""Time between looks at what an observer has gathered: windows are differences of two looks, so
their lengths are multiples of it (our choice)."""

MOVED_M: Final = 2.0
"""A driver counts as moving in a window if it moved farther than this (our choice)."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Feature vectors with their labels and where they come from.

    Attributes:
        features: (n, F) float32.
        codes: (n,) true classes, codes into ``BEHAVIORS``.
        episode: (n,) number of the episode.
        agent: (n,) agent id within the episode.
        time_s: (n,) when the observation ended, s.
        seconds: (n,) length of the observation, s.
        window_s: (n,) length asked for, s; inf for a driver's life so far.
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
        """How many samples."""
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
    """A recording that nothing can be learned from or scored on: it may be left out."""


def collect(
    tracks: Tracks,
    observer: Observer,
    episode: int = 0,
    windows_s: Sequence[float] = WINDOWS_S,
    every_s: float = 1.0,
    per_moment: int | None = None,
    seed: int = 0,
) -> Samples:
    """Run an observer over a recording and cut windows out of what it saw.

    Args:
        tracks: with labels in ``tracks.behavior``.
        observer: a fresh one.
        episode: number to put on the samples.
        windows_s: lengths of observation wanted; ``inf`` means a driver's life so far.
        every_s: time between the ends of windows.
        per_moment: how many of the lengths to draw for each driver and moment; None takes all.
        seed: of that draw.

    Returns:
        One sample per labelled driver, moment and window that fits into its life.

    Raises:
        NoSamplesError: if the recording has no labels, or shows nobody for long enough.
    """
    if tracks.behavior is None:
        raise NoSamplesError("tracks.behavior: found no labels, expected one per agent")
    rng = np.random.default_rng(seed)
    look_s = min(LOOK_S, every_s)
    snapshots: list[tuple[float, Observation, FloatArray]] = []
    parts: list[Samples] = []
    begin = float(tracks.time_s[0]) if tracks.time_s.size else 0.0
    for frame in tracks.frames():
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        passed_s = frame.time_s - begin
        if not _due(passed_s, look_s, tracks.step_s):
            continue
        seen = observer.observation()
        xy = frame.xy[np.searchsorted(frame.ids, seen.ids)]
        snapshots.append((frame.time_s, seen, xy))
        longest = max((w for w in windows_s if np.isfinite(w)), default=0.0)
        while snapshots and snapshots[0][0] < frame.time_s - longest - 1e-6:
            snapshots.pop(0)
        if not _due(passed_s, every_s, tracks.step_s):
            continue
        drawn = rng.random((seen.ids.size, len(windows_s)))
        rank = drawn.argsort(axis=1).argsort(axis=1)
        for column, window_s in enumerate(windows_s):
            part = _cut(snapshots, window_s, observer, look_s)
            if part is None:
                continue
            rows, features, seconds, moved = part
            if per_moment is not None:
                keep = rank[rows, column] < per_moment
                rows, features, seconds, moved = (
                    rows[keep],
                    features[keep],
                    seconds[keep],
                    moved[keep],
                )
            ids = seen.ids[rows]
            codes = tracks.behavior[np.searchsorted(tracks.ids, ids)]
            known = codes >= 0
            n = int(known.sum())
            parts.append(
                Samples(
                    features=features[known].astype(np.float32),
                    codes=codes[known],
                    episode=np.full(n, episode, dtype=np.int64),
                    agent=ids[known],
                    time_s=np.full(n, frame.time_s),
                    seconds=seconds[known],
                    window_s=np.full(n, window_s),
                    moving=moved[known],
                )
            )
    if not parts:
        raise NoSamplesError(
            f"tracks: found no driver observed for {min(windows_s):g} s, expected at least one"
        )
    return Samples.join(parts)


def _due(passed_s: float, every_s: float, step_s: float) -> bool:
    """Whether this frame is the nearest to a whole number of intervals (at least one)."""
    due = passed_s / every_s
    return round(due) >= 1 and abs(due - round(due)) <= 0.25 * step_s / every_s


def _cut(
    snapshots: list[tuple[float, Observation, FloatArray]],
    window_s: float,
    observer: Observer,
    look_s: float,
) -> tuple[NDArray[np.int64], FloatArray, FloatArray, NDArray[np.bool_]] | None:
    """Rows of the newest snapshot with a whole window, their features, seconds and movement."""
    time_s, now, xy = snapshots[-1]
    if not np.isfinite(window_s):
        rows = np.flatnonzero(now.seconds >= look_s - 1e-6)
        features = observer.features(now.seconds[rows], now.sums[rows], now.instant[rows])
        return rows, features, now.seconds[rows], np.ones(rows.size, dtype=bool)
    earlier = [s for s in snapshots if abs(s[0] - (time_s - window_s)) < 0.25 * look_s]
    if not earlier:
        return None
    _, past, past_xy = earlier[0]
    rows, before = align(past.ids, now.ids)
    if rows.size == 0:
        return None
    seconds = now.seconds[rows] - past.seconds[before]
    whole = seconds > window_s - 0.5 * look_s  # a driver that left and came back is a new one
    rows, before, seconds = rows[whole], before[whole], seconds[whole]
    sums = now.sums[rows] - past.sums[before]
    features = observer.features(seconds, sums, now.instant[rows])
    moved = np.hypot(*(xy[rows] - past_xy[before]).T) > MOVED_M
    return rows, features, seconds, moved
