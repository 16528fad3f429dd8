"""Drives of recorded vehicles: who follows whom, and which moments show how a driver follows.

Left out are moments in which something else than the leader rules: bends, a stop line or crossing
nearer than the leader, and lanes without a leader unless the road ahead is known to be clear.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from graphrqi.calibrate.drives import MOST_HALF_S, Drive, Stretch, make_drive, noise_of
from graphrqi.predict.recorded.gaps import inferred_leaders
from sim.episode.observables import observe
from sim.episode.rows import TrajectoryRows
from sim.frames import KINDS, AgentKind, Tracks
from sim.road import Road

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FARTHEST_M: Final = 100.0
"""A vehicle farther ahead is no leader, m (our choice)."""

TURNING_RADPS: Final = 0.1
"""From this yaw rate on, the bend rules the speed, rad/s (our choice: 20 m/s at a radius of 200 m,
where the lateral acceleration reaches 2 m/s2)."""

MOVING_MPS: Final = 1.0
"""Slower vehicles keep the direction that they had, m/s."""

LONGEST_GAP: Final = 1.6
"""A longer time between two frames is a break, in frames."""

JUMPS_MPS: Final = 5.0
"""A leader that seems to be so much faster or slower than just before and after has jumped, m/s
(our choice: who brakes at 10 m/s2 changes by half of it in a quarter of a second). So has one that
seems to move so much faster or slower than its own track does: a gap is not known where a map
begins after the follower."""

DRIVES: Final = (AgentKind.CAR, AgentKind.BUS, AgentKind.TRUCK, AgentKind.MOTORCYCLE)
"""Kinds whose drivers are calibrated."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDriver:
    """One driver of a recording.

    Attributes:
        agent: its id.
        name: the source's own id.
        drive: what is known of it.
    """

    agent: int
    name: str
    drive: Drive


def recorded_drivers(tracks: Tracks, road: Road | None = None) -> list[RecordedDriver]:
    """Every driver that is seen to follow or to drive freely for at least `drives.LEAST_S`.

    Args:
        tracks: a recording, in metres.
        road: its map; without one, leaders are the vehicles straight ahead.

    Returns:
        In the order of ids.
    """
    made = ((i, make_drive(parts)) for i, parts in recorded_stretches(tracks, road))
    return [
        RecordedDriver(int(tracks.ids[i]), tracks.names[i], drive)
        for i, drive in made
        if drive is not None
    ]


def recorded_stretches(
    tracks: Tracks, road: Road | None = None
) -> Iterator[tuple[int, list[Stretch]]]:
    """Row in the recording and stretches of every driver; arguments as `recorded_drivers`."""
    if tracks.time_s.size < 4:
        return
    leader, gap, counts = _leaders(tracks, road)
    wanted = {KINDS.index(kind) for kind in DRIVES}
    for i in range(tracks.ids.size):
        if int(tracks.kind[i]) in wanted:
            yield i, _stretches(tracks, i, leader[i], gap[i], counts[i])


def _leaders(tracks: Tracks, road: Road | None) -> tuple[IntArray, FloatArray, BoolArray]:
    """(N, T) row of each leader, gap to it, m, and whether the moment counts."""
    n, t = tracks.valid.shape
    leader, gap = np.full((n, t), -1), np.full((n, t), np.inf)
    if road is None:
        for column in range(t):
            leader[:, column], gap[:, column] = inferred_leaders(tracks, column)
        return leader, gap, tracks.valid & (leader >= 0)
    rows = TrajectoryRows.of(tracks)
    seen = observe(rows, road)
    at = rows.row_index.agent, rows.row_index.step
    has = (seen.leader >= 0) & (seen.gap < FARTHEST_M)
    leader[at] = np.where(has, rows.row_index.agent[seen.leader], -1)
    gap[at] = np.where(has, seen.gap, np.inf)
    clear = (seen.stop_distance > FARTHEST_M) & (seen.crossing_distance > FARTHEST_M)
    inside = seen.stop_distance < 0.0
    nearer = (seen.gap <= seen.stop_distance) & (seen.gap <= seen.crossing_distance)
    counts = np.zeros((n, t), dtype=bool)
    counts[at] = seen.on_road & np.where(has, clear | inside | nearer, clear & road.knows.limits)
    return leader, gap, counts


def _stretches(
    tracks: Tracks, i: int, leader: IntArray, gap: FloatArray, counts: BoolArray
) -> list[Stretch]:
    """The parts of one vehicle's drive that count."""
    columns = np.flatnonzero(tracks.valid[i])
    if columns.size < 4:
        return []
    time_s = tracks.time_s[columns]
    frame_s = float(np.median(np.diff(time_s)))
    if not 0.0 < frame_s <= 1.0:
        return []
    place, turning = _along(time_s, tracks.xy[i, columns], frame_s)
    good = counts[columns] & (turning < TURNING_RADPS)
    who = np.where(good, leader[columns], -2)
    breaks = (np.diff(who) != 0) | (np.diff(time_s) > LONGEST_GAP * frame_s)
    breaks |= _jumps(place + gap[columns], _moved(tracks, leader[columns], columns), frame_s)
    edges = np.concatenate([[0], np.flatnonzero(breaks) + 1, [columns.size]])
    parts: list[Stretch] = []
    for first, last in pairwise(edges.tolist()):
        if who[first] != -2:
            here = slice(first, last)
            rear = place[here] + gap[columns[here]]
            parts.append(Stretch(time_s[here], place[here], rear))
    return parts


def _moved(tracks: Tracks, leader: IntArray, columns: IntArray) -> FloatArray:
    """(n - 1,) how far the leader at each moment moves until the next one, m; nan if unknown."""
    now, then = columns[:-1], columns[1:]
    who = leader[:-1]
    seen = (who >= 0) & tracks.valid[who, now] & tracks.valid[who, then]
    moved = np.linalg.norm(tracks.xy[who, then] - tracks.xy[who, now], axis=1)
    return np.where(seen, moved, np.nan)


def _jumps(rear: FloatArray, moved: FloatArray, frame_s: float) -> BoolArray:
    """(n - 1,) whether a leader jumps between two frames; see `JUMPS_MPS`.

    Args:
        rear: (n,) its rear, m; infinite without a leader.
        moved: (n - 1,) how far its own track moves from each frame to the next, m; nan if unknown.
        frame_s: time between frames, s.
    """
    steps = np.diff(np.where(np.isfinite(rear), rear, 0.0))
    away = np.abs(steps - median_filter(steps, 5, mode="nearest"))
    off = np.where(np.isnan(moved), 0.0, np.abs(np.abs(steps) - moved))
    most = JUMPS_MPS * frame_s + 6.0 * noise_of(rear[np.isfinite(rear)])
    return np.asarray(np.maximum(away, off) > most)


def _along(time_s: FloatArray, xy: FloatArray, frame_s: float) -> tuple[FloatArray, FloatArray]:
    """(n,) measured distance along a vehicle's own smoothed path, m, and yaw rate, rad/s.

    The smoothed path gives the direction; the measured places are projected on it, so that their
    errors stay what they are. It is always smoothed over the longest stretch: a yaw rate that three
    places tell trembles far beyond `TURNING_RADPS`, however smooth a recording is along the lane.
    """
    from graphrqi.calibrate.kernels import local_parabolas

    half_s = max(MOST_HALF_S, frame_s)
    fitted = np.empty((2, 4, time_s.size))
    for axis in range(2):
        local_parabolas(time_s, np.ascontiguousarray(xy[:, axis]), time_s, half_s, fitted[axis])
    smooth, velocity, change = fitted[:, 0].T, fitted[:, 1].T, fitted[:, 2].T
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
