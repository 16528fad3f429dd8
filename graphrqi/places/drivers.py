"""The drivers of a recording site so far: each once, with its last numbers."""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import FloatArray, IntArray

MEMORY_S: Final = 300.0
"""A driver counts for this time after it was last seen, s; scenes average over the same time."""

LEAST_WEIGHT_S, FULL_WEIGHT_S = 0.1, 20.0
"""A driver's weight is the time it was watched, between these, s."""


class PlaceDrivers:
    """The drivers of a recording site so far, with their last numbers.

    Args:
        width: numbers of a driver.

    Examples:
        >>> place = PlaceDrivers(1)
        >>> place.observe(0.0, np.array([3, 5]), np.array([[1.0], [2.0]]), np.full(2, 20.0))
        >>> place.observe(9.0, np.array([5]), np.array([[4.0]]), np.array([29.0]))
        >>> place.values.ravel(), place.weights
        (array([1., 4.]), array([20., 20.]))
    """

    def __init__(self, width: int) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._seen_s: FloatArray = np.empty(0)
        self._seconds: FloatArray = np.empty(0)
        self.values: FloatArray = np.empty((0, width))

    def observe(
        self, time_s: float, ids: IntArray, values: FloatArray, seconds: FloatArray
    ) -> None:
        """Add or update drivers.

        Args:
            time_s: not decreasing.
            ids: (n,) drivers, each once.
            values: (n, width) numbers of each.
            seconds: (n,) time each was watched, s.
        """
        kept = ~np.isin(self._ids, ids) & (self._seen_s >= time_s - MEMORY_S)
        self._ids = np.concatenate([self._ids[kept], ids])
        self._seen_s = np.concatenate([self._seen_s[kept], np.full(ids.size, time_s)])
        self._seconds = np.concatenate([self._seconds[kept], seconds])
        self.values = np.concatenate([self.values[kept], values])

    @property
    def weights(self) -> FloatArray:
        """(N,) how much each of the N drivers counts."""
        return weights_of(self._seconds)


def weights_of(seconds: FloatArray) -> FloatArray:
    """(n,) how much drivers count that were watched for so long (n,), s."""
    return np.asarray(np.clip(seconds, LEAST_WEIGHT_S, FULL_WEIGHT_S))
