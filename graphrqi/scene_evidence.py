"""Evidence on a scene that gathers frame by frame, for `graphrqi.scene_check`."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.kinematics import FORGET_S, align, merge

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STILL_M: Final = 2.0
"""Vehicles that stay nearer to where they were first seen never moved, m."""


class RunningMean:
    """A running mean with its standard error."""

    def __init__(self) -> None:
        self.count, self._sum, self._squares = 0, 0.0, 0.0

    def add(self, value: float) -> None:
        """Take the next value."""
        self.count += 1
        self._sum += value
        self._squares += value * value

    @property
    def value(self) -> float:
        """The mean so far; NaN before the first value."""
        return self._sum / self.count if self.count else math.nan

    @property
    def error(self) -> float:
        """The standard error of the mean, as if values were independent."""
        if not self.count:
            return math.nan
        return math.sqrt(max(self._squares / self.count - self.value**2, 0.0) / self.count)


MOVED, JUMPED, OVERLAPS = range(3)


class Roll:
    """Which of the vehicles seen so far ever moved, jumped or overlapped another."""

    def __init__(self) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._first: FloatArray = np.zeros((0, 2))
        self._seen_s: FloatArray = np.zeros(0)
        self._did: NDArray[np.bool_] = np.zeros((0, 3), dtype=bool)
        self.count = 0
        self.of = [0, 0, 0]

    def call(self, time_s: float, ids: IntArray, xy: FloatArray) -> IntArray:
        """Note who is there, and return their rows."""
        if np.array_equal(ids, self._ids):
            self._seen_s[:] = time_s
            return np.arange(ids.size)
        merged, rows = merge(self._ids[self._seen_s >= time_s - FORGET_S], ids)
        if not np.array_equal(merged, self._ids):
            into, source = align(self._ids, merged)
            first, did = np.full((merged.size, 2), np.nan), np.zeros((merged.size, 3), dtype=bool)
            seen_s = np.full(merged.size, time_s)
            first[into], did[into] = self._first[source], self._did[source]
            seen_s[into] = self._seen_s[source]
            fresh = rows[np.isnan(first[rows, 0])]
            first[fresh] = xy[np.searchsorted(ids, merged[fresh])]
            self.count += fresh.size
            self._ids, self._first, self._did, self._seen_s = merged, first, did, seen_s
        self._seen_s[rows] = time_s
        return rows

    def mark(self, what: int, rows: IntArray) -> None:
        """Note that these did it."""
        fresh = rows[~self._did[rows, what]]
        self._did[fresh, what] = True
        self.of[what] += int(np.unique(fresh).size)

    def look(self, rows: IntArray, xy: FloatArray) -> None:
        """Note who has moved."""
        away = xy - self._first[rows]
        self.mark(MOVED, rows[np.hypot(away[:, 0], away[:, 1]) > STILL_M])

    def share(self, what: int) -> float:
        """Share of all vehicles so far that did it."""
        return self.of[what] / self.count if self.count else 0.0
