"""Labelled feature vectors of recordings, on which classifiers are trained and scored.

Every sample carries the episode, agent and time it comes from, so that data can be split by
episode and never by row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import BoolArray, FloatArray
from graphrqi.features.motion import align
from graphrqi.features.observer import Observation, Observer
from sim.frames import Tracks

WINDOWS_S: Final = (1.0, 2.0, 3.0, 5.0, 10.0, 15.0, 30.0, 60.0, float("inf"))
"""Lengths of the observation windows for training, s; the infinite one is a driver's whole track so
far, as in a stream."""

SHORTEST_LIFE_S: Final = 1.0
"""Least length of a track that is a sample, and least time from the first frame to a window, s;
earlier velocities are uncertain."""

NEAR_S: Final = 0.25
"""Largest distance of a window's begin and end from the times asked for, s; half a frame step if
that is longer."""

RETURNED_S: Final = 0.5
"""A driver that is missing for longer than this within a window has no sample of it, s."""

SAME_TIME_S: Final = 1e-6
"""Times that differ by less are the same, s (rounding of sums of steps)."""

MOVED_M: Final = 2.0
"""A driver counts as moving in a window if it moved farther than this."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Feature vectors with their labels and origins.

    Attributes:
        features: (n, F) float32.
        codes: (n,) true classes, codes into ``BEHAVIORS``.
        episode: (n,) its number.
        agent: (n,) agent id.
        time_s: (n,) end of the observation, s.
        seconds: (n,) length of the observation, s.
        window_s: (n,) length requested, s; inf for the whole track.
        moving: (n,) whether the driver moved.
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


class _Snapshot(NamedTuple):
    """An observer's evidence at one time, and the drivers' positions (n, 2), m."""

    time_s: float
    seen: Observation
    xy: FloatArray


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

    A window is the difference between the evidence at two frames, those nearest to the times asked
    for (`NEAR_S`). Frames may come at any times.

    Args:
        tracks: with labels in ``tracks.behavior``.
        observer: a fresh one.
        episode: the episode's number.
        windows_s: requested lengths, s; ``inf`` is the whole track.
        every_s: time between the ends of windows.
        per_moment: lengths drawn for each driver and moment; None for all.
        seed: of that draw.

    Returns:
        One sample per labelled driver, moment and window that fits into its track.

    Raises:
        NoSamplesError: if the recording has no labels, or shows no driver for long enough.
    """
    if tracks.behavior is None:
        raise NoSamplesError("tracks.behavior: found no labels, expected one per agent")
    rng = np.random.default_rng(seed)
    begins = _begins(tracks.time_s, windows_s, every_s)
    needed = {end: end for end in begins}  # the last frame that needs each snapshot
    for end, frames in begins.items():
        needed.update((frame, end) for frame in frames if frame is not None)
    snapshots: dict[int, _Snapshot] = {}
    parts: list[Samples] = []
    for number, frame in enumerate(tracks.frames()):
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        if number not in needed:
            continue
        seen = observer.observation()
        last = _Snapshot(frame.time_s, seen, frame.xy[np.searchsorted(frame.ids, seen.ids)])
        snapshots[number] = last
        if number not in begins:
            continue
        codes = tracks.behavior[np.searchsorted(tracks.ids, seen.ids)]
        rank = rng.random((seen.ids.size, len(windows_s))).argsort(axis=1).argsort(axis=1)
        for column, (window_s, begin) in enumerate(zip(windows_s, begins[number], strict=True)):
            wanted = codes >= 0
            if per_moment is not None:
                wanted &= rank[:, column] < per_moment
            if not np.isfinite(window_s):
                wanted &= seen.seconds >= min(SHORTEST_LIFE_S, every_s) - SAME_TIME_S
                window, moving = seen.where(wanted), np.ones(int(wanted.sum()), dtype=bool)
            elif begin is None:
                continue
            else:
                window, moving = _cut(snapshots[begin], last, wanted)
            features = observer.features(window.seconds, window.sums, window.instant)
            n, rows = window.ids.size, np.searchsorted(seen.ids, window.ids)
            one = Samples(
                features.astype(np.float32), codes[rows], np.full(n, episode), window.ids,
                np.full(n, frame.time_s), window.seconds, np.full(n, window_s), moving,
            )  # fmt: skip
            parts.append(one)
        snapshots = {at: kept for at, kept in snapshots.items() if needed[at] > number}
    if not any(map(len, parts)):
        raise NoSamplesError(
            f"tracks: found no driver observed for {min(windows_s):g} s, expected at least one"
        )
    return Samples.join(parts)


def _cut(first: _Snapshot, last: _Snapshot, wanted: BoolArray) -> tuple[Observation, BoolArray]:
    """The evidence between two snapshots on wanted drivers present all the time; who moved."""
    past, now = first.seen, last.seen
    rows, before = align(past.ids, now.ids)
    seconds = now.seconds[rows] - past.seconds[before]
    # a driver that returned is a new one
    whole = wanted[rows] & (seconds > last.time_s - first.time_s - RETURNED_S)
    rows, before = rows[whole], before[whole]
    sums = now.sums[rows] - past.sums[before]
    moved = np.hypot(*(last.xy[rows] - first.xy[before]).T) > MOVED_M
    return Observation(now.ids[rows], seconds[whole], sums, now.instant[rows]), moved


def _begins(
    time_s: FloatArray, windows_s: Sequence[float], every_s: float
) -> dict[int, tuple[int | None, ...]]:
    """Frames at which windows end, with those at which each length begins; None: does not fit."""
    if time_s.size < 2:
        return {}
    half_step_s = 0.5 * float(np.median(np.diff(time_s)))
    near_s = max(NEAR_S, half_step_s)
    first_s = float(time_s[0])
    count = int((time_s[-1] - first_s + half_step_s) / every_s)
    wanted = first_s + every_s * np.arange(1.0, count + 1.0)
    ends = [int(end) for end in np.unique(_nearest(time_s, wanted, near_s)) if end > 0]
    earliest_s = first_s + min(SHORTEST_LIFE_S, every_s) - near_s - SAME_TIME_S
    columns: list[list[int | None]] = []
    for window_s in windows_s:
        begin_s = time_s[ends] - window_s
        found = _nearest(time_s, np.maximum(begin_s, first_s), near_s)
        fits = (begin_s >= earliest_s) & (found >= 0) & (found < np.array(ends))
        columns.append([int(at) if ok else None for at, ok in zip(found, fits, strict=True)])
    return dict(zip(ends, zip(*columns, strict=True), strict=True))


def _nearest(time_s: FloatArray, wanted_s: FloatArray, near_s: float) -> NDArray[np.int64]:
    """(n,) the frame nearest to each time, the earlier of two; -1 where none is near enough."""
    after = np.clip(np.searchsorted(time_s, wanted_s), 1, time_s.size - 1)
    later = time_s[after] - wanted_s < wanted_s - time_s[after - 1] - SAME_TIME_S
    nearest = np.where(later, after, after - 1)
    near = np.abs(time_s[nearest] - wanted_s) <= near_s + SAME_TIME_S
    return np.where(near, nearest, -1)
