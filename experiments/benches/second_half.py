"""What drivers of a recording do in each half of their tracks, told from positions alone.

No lanes are needed: whoever is ahead in the direction of motion within half a lane's width is the
leader. Speeds are displacements over a second, since positions are noisy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

LEAST_LIFE_S: Final = 10.0
"""Shorter tracks have no halves that tell anything (five seconds each)."""

SPAN_S: Final = 0.5
"""Speeds are taken over this time before and after each instant, s."""

EVERY_S: Final = 0.2
"""Time between the instants at which neighbours are looked at, s."""

MOVING_MPS: Final = 2.0
"""Slower ones have no time headway."""

AHEAD_M: Final = 100.0
BESIDE_M: Final = 1.75
"""A leader is nearer ahead than the one, and no farther beside than the other: half a lane."""

LONGEST_HEADWAY_S: Final = 10.0
"""A vehicle with a longer headway does not follow, s."""

NEAR_M: Final = 50.0
"""Radius of the local pace."""

SHIFT_S: Final = 4.0
SHIFT_M: Final = 1.8
"""A vehicle that is this far beside its former path after this time, with the same heading, has
changed lanes, s and m (half a lane's width and more; weaving within a lane stays below)."""

SAME_HEADING: Final = float(np.cos(np.radians(10.0)))
ALIKE: Final = float(np.cos(np.radians(30.0)))

MEASURES: Final = ("time_headway", "speed_over_pace", "lane_changes", "hard_braking")
"""Mean time headway, s; mean speed over that of others near by who go the same way; lane changes
per minute; the deceleration that is exceeded in one instant of fifty, m/s2."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Smoothed motion of all agents.

    Attributes:
        speed: (N, T) m/s; NaN where not known.
        direction: (N, T, 2) unit vectors; NaN where not known.
        braking: (N, T) deceleration, m/s2; NaN where not known.
    """

    speed: FloatArray
    direction: FloatArray
    braking: FloatArray


def halves(tracks: Tracks) -> tuple[IntArray, IntArray, IntArray]:
    """Drivers that are seen for long enough, and where their tracks are halved.

    Returns:
        Their rows, (n,); the columns at which each is first seen in its first and in its second
        half, (n, 2); and the last column of each, (n,).
    """
    any_seen = tracks.valid.any(axis=1) & (tracks.kind != PEDESTRIAN)
    first = tracks.valid.argmax(axis=1)
    last = tracks.time_s.size - 1 - tracks.valid[:, ::-1].argmax(axis=1)
    begin_s, end_s = tracks.time_s[first], tracks.time_s[last]
    rows = np.flatnonzero(any_seen & (end_s - begin_s >= LEAST_LIFE_S - 1e-6))
    middle = np.searchsorted(tracks.time_s, 0.5 * (begin_s + end_s)[rows])
    return rows, np.stack([first[rows], middle], axis=1), last[rows]


def motion_of(tracks: Tracks) -> Motion:
    """Speeds, directions and decelerations, each over ``SPAN_S`` before and after."""
    span = max(1, round(SPAN_S / tracks.step_s))
    xy = np.where(tracks.valid[..., None], tracks.xy, np.nan)
    moved, passed = _around(xy, span), _around(tracks.time_s[None], span)
    with np.errstate(invalid="ignore", divide="ignore"):
        velocity = moved / passed[..., None]
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        speed[:, passed[0] > 4.0 * SPAN_S] = np.nan  # frames are missing there
        stated = np.stack([np.cos(tracks.heading), np.sin(tracks.heading)], axis=2)
        direction = np.where((speed > 1.0)[..., None], velocity / speed[..., None], stated)
        braking = -_around(speed, span) / passed
    return Motion(speed, direction, braking)


def _around(values: FloatArray, span: int) -> FloatArray:
    """Differences between ``span`` columns later and earlier; NaN at the ends."""
    out = np.full(values.shape, np.nan)
    if values.shape[1] > 2 * span:
        out[:, span:-span] = values[:, 2 * span :] - values[:, : -2 * span]
    return out


def _neighbours(tracks: Tracks, motion: Motion) -> tuple[FloatArray, FloatArray]:
    """(N, T) time headway, s, and local pace, m/s; NaN where none is there or was looked for."""
    headway, pace = np.full(tracks.valid.shape, np.nan), np.full(tracks.valid.shape, np.nan)
    drives = tracks.valid & (tracks.kind != PEDESTRIAN)[:, None] & np.isfinite(motion.speed)
    stride = max(1, round(EVERY_S / tracks.step_s))
    for step in range(0, tracks.time_s.size, stride):
        rows = np.flatnonzero(drives[:, step])
        if rows.size < 2:
            continue
        away = tracks.xy[rows, step][None] - tracks.xy[rows, step][:, None]
        ahead = motion.direction[rows, step]
        speed = motion.speed[rows, step]
        along = (away * ahead[:, None]).sum(axis=2)
        across = ahead[:, None, 0] * away[..., 1] - ahead[:, None, 1] * away[..., 0]
        alike = ahead @ ahead.T > ALIKE
        np.fill_diagonal(alike, False)
        front = alike & (along > 0.0) & (along < AHEAD_M) & (np.abs(across) < BESIDE_M)
        gap = np.where(front, along, np.inf)
        leader = gap.argmin(axis=1)
        length = 0.5 * (tracks.length[rows] + tracks.length[rows][leader])
        free_m = np.maximum(gap[np.arange(rows.size), leader] - length, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            seconds = np.where(speed > MOVING_MPS, free_m / speed, np.inf)
            near = alike & (along**2 + across**2 < NEAR_M**2)
            headway[rows, step] = np.where(seconds < LONGEST_HEADWAY_S, seconds, np.nan)
            pace[rows, step] = (near @ speed) / near.sum(axis=1)
    return headway, pace


def _shifts(tracks: Tracks, motion: Motion) -> tuple[BoolArray, int]:
    """(N, T) where someone begins to move into another lane, and how many columns that takes."""
    ahead = max(1, round(SHIFT_S / tracks.step_s))
    out = np.zeros(tracks.valid.shape, dtype=bool)
    if tracks.time_s.size <= ahead:
        return out, ahead
    begin, end = motion.direction[:, :-ahead], motion.direction[:, ahead:]
    mean = begin + end
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = mean / np.hypot(mean[..., 0], mean[..., 1])[..., None]
        away = tracks.xy[:, ahead:] - tracks.xy[:, :-ahead]
        across = np.abs(mean[..., 0] * away[..., 1] - mean[..., 1] * away[..., 0])
        along = (mean * away).sum(axis=2)
        same = (begin * end).sum(axis=2) > SAME_HEADING
        out[:, :-ahead] = same & (across > SHIFT_M) & (along > 3.0 * across)
    return out, ahead


@dataclass(frozen=True, slots=True)
class Doings:
    """What can be told at each instant of what the drivers of a recording do.

    Attributes:
        time_s: (T,) of the instants.
        motion: smoothed.
        headway: (N, T) time headway, s; NaN where there is none or nobody looked.
        pace: (N, T) mean speed of others near by, m/s; NaN likewise.
        shifts: (N, T) where someone begins to move into another lane.
        takes: how many columns after that it is seen.
    """

    time_s: FloatArray
    motion: Motion
    headway: FloatArray
    pace: FloatArray
    shifts: BoolArray
    takes: int

    @staticmethod
    def of(tracks: Tracks) -> Doings:
        """From a recording, in metres."""
        motion = motion_of(tracks)
        headway, pace = _neighbours(tracks, motion)
        shifts, takes = _shifts(tracks, motion)
        return Doings(tracks.time_s, motion, headway, pace, shifts, takes)

    def measures(self, row: int, start: int, stop: int) -> FloatArray:
        """(4,) the ``MEASURES`` of one driver over some columns; NaN where one cannot be told.

        A column's values rest on positions up to ``SPAN_S`` later.
        """
        out = np.full(len(MEASURES), np.nan)
        here = slice(start, max(stop, start + 1))
        followed = self.headway[row, here]
        if np.count_nonzero(np.isfinite(followed)) >= 3:
            out[0] = np.nanmean(followed)
        pace = self.pace[row, here]
        with_others = np.isfinite(pace)
        if np.count_nonzero(with_others) >= 3 and pace[with_others].sum() > 0.0:
            speed = self.motion.speed[row, here]
            out[1] = speed[with_others].sum() / pace[with_others].sum()
        shifted = np.flatnonzero(self.shifts[row, start : max(start, here.stop - self.takes)])
        seconds = self.time_s[here.stop - 1] - self.time_s[start]
        begun = np.count_nonzero(np.diff(shifted) > self.takes) + (shifted.size > 0)
        out[2] = 60.0 * begun / max(seconds, 1.0)
        braking = self.motion.braking[row, here]
        if np.count_nonzero(np.isfinite(braking)) >= 3:
            out[3] = np.nanquantile(braking, 0.98)
        return out


def measured(tracks: Tracks) -> FloatArray:
    """What everyone with two halves does in each of them.

    Args:
        tracks: a recording, in metres.

    Returns:
        (n, 2, 4) the ``MEASURES`` of the drivers of `halves` in their first and second half; NaN
        where one cannot be told.
    """
    rows, begins, last = halves(tracks)
    out = np.full((rows.size, 2, len(MEASURES)), np.nan)
    if not rows.size:
        return out
    doings = Doings.of(tracks)
    apart = 2 * max(1, round(SPAN_S / tracks.step_s))  # no instant rests on both halves
    for i, row in enumerate(rows.tolist()):
        first, second = begins[i].tolist()
        out[i, 0] = doings.measures(row, first, second - apart)
        out[i, 1] = doings.measures(row, second + apart, int(last[i]) + 1)
    return out
