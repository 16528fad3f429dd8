"""Recorded drivers: stretches of their tracks in which car following decides the motion.

Moments in bends and before a stop line or crossing nearer than the leader are left out. Moments
without a leader count only where the road ahead is known to be clear.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_filter

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.predict.recorded.features import inferred_leaders
from sim.episode.observables import observe
from sim.frames import KINDS, AgentKind, Tracks
from sim.road import Road

STEP_S: Final = 0.1
"""Time between the rows of a stretch, s."""

LEAST_S: Final = 4.0
"""Shorter stretches are left out, s (they show no reaction from beginning to end)."""

SMOOTHED_S: Final = 2.4
"""Time over which speeds and paths are smoothed, s (NGSIM's errors last for about a second)."""

FARTHEST_M: Final = 100.0
"""Largest distance to a leader, m."""

TURNING_RADPS: Final = 0.1
"""From this yaw rate on, the bend decides the speed, rad/s (20 m/s at a radius of 200 m)."""

MOVING_MPS: Final = 1.0
"""Slower vehicles keep the direction that they had, m/s."""

LONGEST_GAP: Final = 1.6
"""A longer time between two frames is a break, in frames."""

JUMPS_MPS: Final = 5.0
"""A leader whose speed seems to change by more between two frames is another vehicle, m/s."""

DRIVEN: Final = (AgentKind.CAR, AgentKind.BUS, AgentKind.TRUCK, AgentKind.MOTORCYCLE)
"""Kinds whose drivers are calibrated."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Part of a drive without a break, in steps of `STEP_S`, behind one leader or behind none.

    Attributes:
        place: (T,) position of the front bumper, m.
        speed: (T,) smoothed speed, m/s.
        leader: (T,) the leader's rear bumper, m; +inf without one.
        leader_speed: (T,) its smoothed speed, m/s; 0 without one.
    """

    place: FloatArray
    speed: FloatArray
    leader: FloatArray
    leader_speed: FloatArray

    @classmethod
    def of(cls, time_s: FloatArray, place: FloatArray, leader: FloatArray) -> Stretch:
        """Resample and smooth positions of a front bumper and of the leader's rear bumper, m.

        The leader's are +inf without one. Times increase, s.

        Examples:
            >>> t = np.arange(0.0, 10.0, 0.2)
            >>> one = Stretch.of(t, 10.0 * t, 30.0 + 10.0 * t)
            >>> one.speed.size, one.speed[5].round(3), one.leader[5].round(3)
            (99, np.float64(10.0), np.float64(35.0))
        """
        at_s = np.arange(time_s[0], time_s[-1] + 1e-9, STEP_S)
        own = np.interp(at_s, time_s, place)
        ahead, ahead_speed = np.full(at_s.size, np.inf), np.zeros(at_s.size)
        if np.isfinite(leader).all():
            measured = np.interp(at_s, time_s, leader)
            ahead = _smooth(measured, STEP_S)
            ahead_speed = np.maximum(_smooth(measured, STEP_S, 1), 0.0)
        return cls(own, np.maximum(_smooth(own, STEP_S, 1), 0.0), ahead, ahead_speed)

    @property
    def seconds(self) -> float:
        """How long it is, s."""
        return (self.place.size - 1) * STEP_S

    def part(self, first: int, last: int) -> Stretch:
        """Its rows from one to before another."""
        return Stretch(
            self.place[first:last],
            self.speed[first:last],
            self.leader[first:last],
            self.leader_speed[first:last],
        )


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDriver:
    """One driver of a recording.

    Attributes:
        agent: its id.
        name: the source's own id.
        stretches: where it follows, or drives freely, for at least `LEAST_S`.
    """

    agent: int
    name: str
    stretches: tuple[Stretch, ...]

    @property
    def seconds(self) -> float:
        """How long the driver is known, s."""
        return sum(stretch.seconds for stretch in self.stretches)


def recorded_drivers(tracks: Tracks, road: Road | None = None) -> list[RecordedDriver]:
    """Every driver that is seen to follow or to drive freely for at least `LEAST_S`.

    Args:
        tracks: a recording, in metres.
        road: its map; without one, leaders are the vehicles straight ahead.

    Returns:
        In the order of ids.
    """
    if tracks.time_s.size < 4:
        return []
    leader, gap, counts = _leaders(tracks, road)
    wanted = {KINDS.index(kind) for kind in DRIVEN}
    found = []
    for i in range(tracks.ids.size):
        if int(tracks.kind[i]) in wanted:
            parts = tuple(_stretches(tracks, i, leader[i], gap[i], counts[i]))
            if parts:
                found.append(RecordedDriver(int(tracks.ids[i]), tracks.names[i], parts))
    return found


def _leaders(tracks: Tracks, road: Road | None) -> tuple[IntArray, FloatArray, BoolArray]:
    """(N, T) row of each leader, gap to it, m, and whether the moment counts."""
    n, t = tracks.valid.shape
    leader, gap = np.full((n, t), -1), np.full((n, t), np.inf)
    if road is None:
        for column in range(t):
            leader[:, column], gap[:, column] = inferred_leaders(tracks, column)
        return leader, gap, tracks.valid & (leader >= 0)
    index, seen = tracks.index, observe(tracks, road)
    at = index.agent, index.step
    has = (seen.leader >= 0) & (seen.gap < FARTHEST_M)
    leader[at] = np.where(has, index.agent[seen.leader], -1)
    gap[at] = np.where(has, seen.gap, np.inf)
    clear = (seen.stop_distance > FARTHEST_M) & (seen.crossing_distance > FARTHEST_M)
    inside = seen.stop_distance < 0.0
    nearer = (seen.gap <= seen.stop_distance) & (seen.gap <= seen.crossing_distance)
    counts = np.zeros((n, t), dtype=bool)
    counts[at] = (seen.lane >= 0) & np.where(
        has, clear | inside | nearer, clear & road.knows.limits
    )
    return leader, gap, counts


def _stretches(
    tracks: Tracks, i: int, leader: IntArray, gap: FloatArray, counts: BoolArray
) -> Iterator[Stretch]:
    """The parts of one vehicle's drive that count."""
    columns = np.flatnonzero(tracks.valid[i])
    if columns.size < 4:
        return
    frame_s = float(np.median(np.diff(tracks.time_s[columns])))
    late = np.diff(tracks.time_s[columns]) > LONGEST_GAP * frame_s
    for seen in np.split(columns, np.flatnonzero(late) + 1):
        time_s = tracks.time_s[seen]
        if frame_s > 1.0 or time_s[-1] - time_s[0] < LEAST_S:
            continue
        place, turning = _along(tracks.xy[i, seen], frame_s)
        rear = place + gap[seen]
        who = np.where(counts[seen] & (turning < TURNING_RADPS), leader[seen], -2)
        breaks = (np.diff(who) != 0) | _jumps(rear, _moved(tracks, leader[seen], seen), frame_s)
        edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), seen.size]
        for first, last in pairwise(edges):
            if who[first] != -2 and time_s[last - 1] - time_s[first] >= LEAST_S:
                here = slice(first, last)
                yield Stretch.of(time_s[here], place[here], rear[here])


def _smooth(values: FloatArray, frame_s: float, derivative: int = 0) -> FloatArray:
    """Values along the first axis, or a derivative, of parabolas over `SMOOTHED_S`."""
    window = 2 * max(1, round(0.5 * SMOOTHED_S / frame_s)) + 1
    smooth = savgol_filter(values, window, 2, derivative, frame_s, axis=0)
    return np.asarray(smooth, dtype=np.float64)


def _along(xy: FloatArray, frame_s: float) -> tuple[FloatArray, FloatArray]:
    """(n,) measured distance along a vehicle's own smoothed path, m, and yaw rate, rad/s.

    The smoothed path gives the direction; measured places are projected on it and keep their noise.
    """
    smooth, velocity, change = (_smooth(xy, frame_s, order) for order in range(3))
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    moves = speed > MOVING_MPS
    last = np.maximum.accumulate(np.where(moves, np.arange(speed.size), -1))
    last = np.where(last < 0, int(moves.argmax()), last)
    direction = velocity[last] / np.maximum(speed[last], 1e-6)[:, None]
    steps = (np.diff(smooth, axis=0) * 0.5 * (direction[1:] + direction[:-1])).sum(axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    across = velocity[:, 0] * change[:, 1] - velocity[:, 1] * change[:, 0]
    turning = np.where(moves, np.abs(across) / np.maximum(speed, MOVING_MPS) ** 2, 0.0)
    return way + ((xy - smooth) * direction).sum(axis=1), turning


def _moved(tracks: Tracks, leader: IntArray, columns: IntArray) -> FloatArray:
    """(n - 1,) how far the leader at each moment moves until the next one, m; nan if unknown."""
    now, then = columns[:-1], columns[1:]
    who = leader[:-1]
    seen = (who >= 0) & tracks.valid[who, now] & tracks.valid[who, then]
    moved = np.linalg.norm(tracks.xy[who, then] - tracks.xy[who, now], axis=1)
    return np.where(seen, moved, np.nan)


def _jumps(rear: FloatArray, moved: FloatArray, frame_s: float) -> BoolArray:
    """(n - 1,) whether a leader jumps between two frames, or moves otherwise than its own track."""
    steps = np.diff(np.where(np.isfinite(rear), rear, 0.0))
    away = np.abs(steps - median_filter(steps, 5, mode="nearest"))
    off = np.where(np.isnan(moved), 0.0, np.abs(np.abs(steps) - moved))
    third = np.diff(rear[np.isfinite(rear)], 3)
    noise_m = 1.4826 * np.median(np.abs(third)) / np.sqrt(20.0) if third.size else 0.0
    return np.asarray(np.maximum(away, off) > JUMPS_MPS * frame_s + 6.0 * noise_m)
