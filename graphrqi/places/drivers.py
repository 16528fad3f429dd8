"""The drivers of a recording site so far, and how each compares with the others.

Recorded drivers are compared with one another, since the average of their site is unknown.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray, IntArray

MEMORY_S: Final = 300.0
"""A driver counts for this time after it was last seen, s; scenes average over the same time."""

LEAST_WEIGHT_S, FULL_WEIGHT_S = 0.1, 20.0
"""A driver's weight is the time it was watched, between these, s."""


class PlaceDrivers:
    """The drivers of a recording site so far, with their last ``width`` numbers."""

    def __init__(self, width: int) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._seen_s: FloatArray = np.empty(0)
        self._seconds: FloatArray = np.empty(0)
        self.values: FloatArray = np.empty((0, width))

    def observe(
        self, time_s: float, ids: IntArray, values: FloatArray, seconds: FloatArray
    ) -> None:
        """Add or update drivers: (n, width) numbers of each, and the time watched (n,), s."""
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


FARTHEST_ODDS: Final = 9.2
"""Log-odds are limited to this."""

USUAL_DEVIATION: Final = 3.5
"""Mean deviation of log-odds from the median on either side, where few drivers are known."""

LEAST_DEVIATION: Final = 1.0
"""Log-odds that lie closer together than this do not distinguish drivers."""

CONFIDENCE: Final = 1.75
"""Log-odds of a recorded driver one mean deviation from the median, watched for long (our choice).
About the outer third of the drivers gets a label."""

MOST_CONFIDENCE: Final = 3.0
"""Log-odds that the farthest driver approaches, a probability of 0.95."""

HALF_CONFIDENCE_S: Final = 2.0
"""Time watched at which half of that confidence is reached, s."""

HALF_CONFIDENCE_DRIVERS: Final = 5.0
"""Drivers seen at which half of the confidence is reached, and the site's own median and deviations
count half."""


def beside_others(log_odds: FloatArray, seconds: FloatArray, place: PlaceDrivers) -> FloatArray:
    """(n,) log-odds of the aggressive style relative to the other drivers of the site.

    The distance from the site's median is divided by the mean deviation on the driver's side of it.
    Where few drivers are known, median and deviation stay near their usual values.
    """
    known = place.values[:, 0]
    order = np.argsort(known, kind="stable")
    odds, weight = known[order], place.weights[order]
    share = np.cumsum(weight) / weight.sum()
    shown = level_shown(odds.size)
    median = odds[min(int(np.searchsorted(share, 0.5)), odds.size - 1)] * shown
    off, total = odds - median, weight.sum()
    above, below = (2.0 * (weight @ np.maximum(s * off, 0.0)) / total for s in (1.0, -1.0))
    far = log_odds - median
    scale = shown * np.where(far > 0.0, above, below) + (1.0 - shown) * USUAL_DEVIATION
    scale = np.maximum(scale, LEAST_DEVIATION)
    worth = MOST_CONFIDENCE * shown * seconds / (seconds + HALF_CONFIDENCE_S)
    return np.asarray(worth * np.tanh(CONFIDENCE / MOST_CONFIDENCE * far / scale))


def level_shown(drivers: int) -> float:
    """How far a number of drivers shows the average of their site, from 0 to 1."""
    return drivers / (drivers + HALF_CONFIDENCE_DRIVERS)


def log_odds_of(probability: FloatArray) -> FloatArray:
    """(...) log-odds of shares (...) of the aggressive style, at most `FARTHEST_ODDS`."""
    low = 1.0 / (1.0 + np.exp(FARTHEST_ODDS))
    held = np.clip(probability, low, 1.0 - low)
    return np.asarray(np.log(held / (1.0 - held)))


def restyled(
    probability: FloatArray, aggressive: FloatArray, style: NDArray[np.bool_]
) -> FloatArray:
    """(n, C) behaviours with another probability (n,) of the aggressive style (C,).

    The odds within each style stay.

    Examples:
        >>> restyled(np.array([[0.6, 0.2, 0.2]]), np.array([0.4]), np.array([True, True, False]))
        array([[0.3, 0.1, 0.6]])
    """
    share = np.where(style, aggressive[:, None], 1.0 - aggressive[:, None])
    held = np.maximum(probability, 1e-9)
    total = np.stack([held[:, ~style].sum(axis=1), held[:, style].sum(axis=1)], axis=1)
    return np.asarray(held / total[:, style.astype(np.int64)] * share)
