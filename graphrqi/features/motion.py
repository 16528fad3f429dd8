"""Motion of agents from positions, frame by frame.

`RawMotion` differences positions over fractions of a second, because recorded positions are rounded
and noisy. `graphrqi.features.smooth_motion` fits parabolas where they are noisier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.row_index import find_sorted
from graphrqi.arrays import BoolArray, FloatArray, IntArray

SPAN_S: Final = 0.4
"""Span over which positions are differenced for velocity (four frames at 10 Hz)."""

DIRECTION_SPAN_S: Final = 2.0
"""Span over which the direction of travel is measured: longer than the sideways part of a lane
change, shorter than a turn."""

MIN_TRAVEL_M: Final = 1.0
"""Displacement below which the last known direction is kept; larger than position noise."""

FORGET_S: Final = 3.0
"""An agent that was absent for longer than this counts as a new one when it returns."""


@dataclass(frozen=True, slots=True)
class Motion:
    """How agents move at one moment; NaN where it is not known.

    Attributes:
        time_s: the moment, s.
        ids: (n,) ascending agent ids.
        drives: (n,) whether each drives; the others are pedestrians.
        xy: (n, 2) m.
        velocity: (n, 2) m/s.
        direction: (n, 2) unit vectors of travel.
        speed: (n,) m/s along the direction.
        acceleration: (n,) m/s2 along the direction.
        sideways: (n,) to the left: raw motion's displacement over the last second, m, or smoothed
            motion's acceleration, m/s2.
    """

    time_s: float
    ids: IntArray
    drives: BoolArray
    xy: FloatArray
    velocity: FloatArray
    direction: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    sideways: FloatArray


def align(old_ids: IntArray, new_ids: IntArray) -> tuple[IntArray, IntArray]:
    """Where two ascending id arrays share ids: positions in the new one, and in the old one.

    Examples:
        >>> align(np.array([2, 5, 9]), np.array([5, 7, 9]))
        (array([0, 2]), array([1, 2]))
    """
    at, there = find_sorted(old_ids, new_ids)
    into = np.flatnonzero(there)
    return into, at[into]


def merge(known: IntArray, ids: IntArray) -> tuple[IntArray, IntArray]:
    """Union of two sorted id arrays, and the positions of the second one's ids in it.

    Examples:
        >>> merge(np.array([2, 5, 9]), np.array([5, 7, 9]))
        (array([2, 5, 7, 9]), array([1, 2, 3]))
    """
    rows, there = find_sorted(known, ids)
    if there.all():
        return known, rows
    merged = np.sort(np.concatenate((known, ids[~there])), kind="stable")
    return merged, np.searchsorted(merged, ids)


class RawMotion:
    """Estimates the motion of every agent from differences of positions.

    Memory is bounded: the last two seconds of the agents that were present in the last three.
    """

    def __init__(self) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._times: list[float] = []
        self._trail: FloatArray = np.empty((0, 0, 2))
        self._direction: FloatArray = np.empty((0, 2))
        self._velocity: FloatArray = np.empty((0, 0, 2))
        self._seen_s: FloatArray = np.empty(0)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> Motion:
        """Take the next positions (n, 2), m, of ascending ids; motion of exactly these agents."""
        from graphrqi.features.kernels import change_within

        rows = self._remember(time_s, ids, xy)
        times = np.array(self._times)

        def change(values: FloatArray, span_s: float) -> tuple[FloatArray, FloatArray]:
            """Difference of values now from the oldest known ones within a span, and its time."""
            first = int(np.searchsorted(times, time_s - span_s - 1e-6))
            out, elapsed_s = np.empty((rows.size, 2)), np.empty((rows.size, 1))
            change_within(values, rows, times, first, out, elapsed_s)
            return out, elapsed_s

        difference, elapsed_s = change(self._trail, SPAN_S)
        velocity = difference / elapsed_s
        self._velocity[rows, -1] = velocity
        travel, _ = change(self._trail, DIRECTION_SPAN_S)
        distance = np.hypot(travel[:, 0], travel[:, 1])
        moved = distance > MIN_TRAVEL_M
        self._direction[rows[moved]] = travel[moved] / distance[moved, None]
        direction = self._direction[rows]
        difference, elapsed_s = change(self._velocity, SPAN_S)
        last_second, _ = change(self._trail, 1.0)
        return Motion(
            time_s=time_s,
            ids=ids,
            drives=drives,
            xy=xy,
            velocity=velocity,
            direction=direction,
            speed=along(direction, velocity),
            acceleration=along(direction, difference / elapsed_s),
            sideways=leftward(direction, last_second),
        )

    def _remember(self, time_s: float, ids: IntArray, xy: FloatArray) -> IntArray:
        """Store the positions, forget old ones, and return the agents' rows."""
        known = self._ids[self._seen_s >= time_s - FORGET_S]
        merged, rows = merge(known, ids)
        into: IntArray | slice = slice(None)
        source: IntArray | slice = slice(None)
        if not merged.size == known.size == self._ids.size:
            into, source = align(self._ids, merged)
        first = int(np.searchsorted(self._times, time_s - DIRECTION_SPAN_S - 1e-6))
        self._times = [*self._times[first:], time_s]

        trail, velocity = np.full((2, merged.size, len(self._times), 2), np.nan)
        trail[into, :-1], velocity[into, :-1] = (
            old[source, first:] for old in (self._trail, self._velocity)
        )
        direction, seen = np.full((merged.size, 2), np.nan), np.empty(merged.size)
        direction[into], seen[into] = self._direction[source], self._seen_s[source]
        trail[rows, -1], seen[rows] = xy, time_s
        self._ids, self._trail, self._velocity = merged, trail, velocity
        self._direction, self._seen_s = direction, seen
        return rows


def along(direction: FloatArray, values: FloatArray) -> FloatArray:
    """(n,) components of vectors (n, 2) along unit vectors (n, 2)."""
    return np.asarray(values[:, 0] * direction[:, 0] + values[:, 1] * direction[:, 1])


def leftward(direction: FloatArray, values: FloatArray) -> FloatArray:
    """(n,) components of vectors (n, 2) to the left of unit vectors (n, 2)."""
    return np.asarray(direction[:, 0] * values[:, 1] - direction[:, 1] * values[:, 0])
