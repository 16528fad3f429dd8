"""Running sums per driver: evidence that adds up for as long as the driver is in sight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.kinematic import FORGET_S, align, merge
from graphrqi.features.observer import Observation

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Evidence:
    """Sums kept while a driver is in sight and ``FORGET_S`` longer.

    Args:
        width: columns of evidence.
    """

    def __init__(self, width: int) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._sums: FloatArray = np.zeros((0, width))
        self._seconds: FloatArray = np.zeros(0)
        self._seen_s: FloatArray = np.zeros(0)
        self._time_s: float | None = None

    def add(self, time_s: float, ids: IntArray, moment: FloatArray) -> None:
        """Add one moment (n, S) of each driver, for as long as the time since the last."""
        from graphrqi.features.statistics_kernel import accumulate

        step_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        merged, rows = merge(self._ids[self._seen_s >= time_s - FORGET_S], ids)
        fresh = self._keep(merged, time_s)
        accumulate(self._sums, rows, moment, step_s)
        self._seconds[rows] += np.where(fresh[rows], 0.0, step_s)
        self._seen_s[rows] = time_s

    def _keep(self, merged: IntArray, time_s: float) -> NDArray[np.bool_]:
        """Make room for exactly these agents; which of them are new."""
        if np.array_equal(merged, self._ids):
            return np.zeros(merged.size, dtype=bool)
        sums = np.zeros((merged.size, self._sums.shape[1]))
        seconds = np.zeros(merged.size)
        seen = np.full(merged.size, time_s)
        into, source = align(self._ids, merged)
        sums[into], seconds[into] = self._sums[source], self._seconds[source]
        seen[into] = self._seen_s[source]
        fresh = np.ones(merged.size, dtype=bool)
        fresh[into] = False
        self._ids, self._sums, self._seconds, self._seen_s = merged, sums, seconds, seen
        return fresh

    def observation(self) -> Observation:
        """A copy of the evidence on those seen at the last moment."""
        here = self._seen_s == (np.inf if self._time_s is None else self._time_s)
        ids = self._ids[here]
        return Observation(ids, self._seconds[here], self._sums[here], np.zeros((ids.size, 0)))
