"""Observers, and the running sums that they keep for each driver.

An observer takes positions frame by frame and gives a feature vector for every driver. Live frames
and recordings go through the same observer, so training and streaming cannot differ.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.motion import FORGET_S, align, merge


class Observation(NamedTuple):
    """The evidence of an observer on the drivers present now.

    Attributes:
        ids: (n,) ascending.
        seconds: (n,) time observed, s.
        sums: (n, S) additive evidence since each driver appeared.
        instant: (n, I) quantities of this moment only.
    """

    ids: IntArray
    seconds: FloatArray
    sums: FloatArray
    instant: FloatArray

    def where(self, chosen: BoolArray) -> Observation:
        """The drivers for which ``chosen`` (n,) holds."""
        return Observation._make(column[chosen] for column in self)


class Observer:
    """Measures how long each driver is present; others derive from it and add features.

    Args:
        solver: a key of ``SOLVERS``; only observers of the spectrum use it.
        width: columns of the additive evidence.

    Attributes:
        feature_names: names of the columns of `features`.
    """

    feature_names: tuple[str, ...] = ()

    def __init__(self, solver: str = "graphrqi", width: int = 0) -> None:
        self._sums = RunningSums(width)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> bool:
        """Take the next positions.

        Args:
            time_s: later than at the call before.
            ids: (n,) ascending agent ids.
            xy: (n, 2) m.
            drives: (n,) whether each drives; the others are pedestrians.

        Returns:
            Whether anything was measured, so that evidence changed.
        """
        self._sums.add(time_s, ids[drives], self._moment(time_s, ids, xy, drives)[drives])
        return True

    def _moment(
        self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray
    ) -> FloatArray:
        """(n, width) evidence of one moment on all agents."""
        return np.zeros((ids.size, 0))

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._sums.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """Turn evidence over any stretch of time into feature vectors (n, F)."""
        return instant


class RunningSums:
    """Sums over time for each driver, kept while it is present and ``FORGET_S`` longer.

    A driver's sums stay in one row of a larger array while others come and go.
    """

    def __init__(self, width: int) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._row: IntArray = np.empty(0, dtype=np.int64)
        self._sums: FloatArray = np.zeros((0, width))
        self._seconds: FloatArray = np.zeros(0)
        self._seen_s: FloatArray = np.zeros(0)
        self._time_s: float | None = None

    def add(self, time_s: float, ids: IntArray, moment: FloatArray) -> None:
        """Add a moment's values (n, S) of each driver, times the seconds since the last moment."""
        sums, rows, step_s = self.advance(time_s, ids)
        sums[rows] += moment * step_s

    def advance(self, time_s: float, ids: IntArray) -> tuple[FloatArray, IntArray, float]:
        """Go to the next moment, at which these drivers are present.

        Returns:
            (m, S) the sums, to be added to; (n,) the drivers' rows in them; and the time since the
            last moment, s.
        """
        step_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        merged, at = merge(self._ids[self._seen_s >= time_s - FORGET_S], ids)
        fresh = self._keep(merged, time_s)
        self._seconds[at] += np.where(fresh[at], 0.0, step_s)
        self._seen_s[at] = time_s
        return self._sums, self._row[at], step_s

    def _keep(self, merged: IntArray, time_s: float) -> BoolArray:
        """Forget all but these agents, give the new ones a row, and return which are new."""
        if np.array_equal(merged, self._ids):
            return np.zeros(merged.size, dtype=bool)
        into, source = align(self._ids, merged)
        fresh = np.ones(merged.size, dtype=bool)
        fresh[into] = False
        row, seconds, seen = np.empty_like(merged), np.zeros(merged.size), np.empty(merged.size)
        row[into], seconds[into] = self._row[source], self._seconds[source]
        seen[into], seen[fresh] = self._seen_s[source], time_s
        if not merged.size <= len(self._sums) <= 4 * merged.size:
            sums = np.zeros((2 * merged.size, self._sums.shape[1]))
            sums[: into.size], row[into] = self._sums[row[into]], np.arange(into.size)
            self._sums = sums
        free = np.ones(len(self._sums), dtype=bool)
        free[row[into]] = False
        row[fresh] = np.flatnonzero(free)[: merged.size - into.size]
        self._sums[row[fresh]] = 0.0
        self._ids, self._row, self._seconds, self._seen_s = merged, row, seconds, seen
        return fresh

    def observation(self) -> Observation:
        """A copy of the sums of the drivers present at the last moment."""
        here = self._seen_s == (np.inf if self._time_s is None else self._time_s)
        ids = self._ids[here]
        sums = self._sums[self._row[here]]
        return Observation(ids, self._seconds[here], sums, np.zeros((ids.size, 0)))

    def of(self, ids: IntArray) -> FloatArray:
        """(n, S) sums of the given drivers, ascending; zero for those without any."""
        out = np.zeros((ids.size, self._sums.shape[1]))
        into, source = align(self._ids, ids)
        out[into] = self._sums[self._row[source]]
        return out
