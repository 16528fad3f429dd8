"""Recorded people are compared with one another: nobody knows the level of their place."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.places.drivers import PlaceDrivers

FloatArray = NDArray[np.float64]

FARTHEST_ODDS: Final = 9.2
"""Log-odds beyond this count as this: 1 in 10,000."""

LEAST_DEVIATION: Final = 0.3
"""Log-odds that lie closer together than this do not tell drivers apart."""

CONFIDENCE: Final = 1.5
"""Log-odds of a driver at a recorded place that lies a mean deviation from the median, watched for
long. Answers of two halves of a track rank drivers of a place alike with Spearman .3 to .6, so that
only the outer third of the drivers is told (our choice)."""

HALF_CONFIDENCE_S: Final = 5.0
"""Time watched at which half of that confidence is reached, s."""

HALF_CONFIDENCE_DRIVERS: Final = 5.0
"""Drivers seen at the place at which half of it is reached: few show no level."""


def beside_others(log_odds: FloatArray, seconds: FloatArray, place: PlaceDrivers) -> FloatArray:
    """Log-odds of drivers of a place whose level nobody knows.

    A driver's distance from the place's median is taken in mean deviations of those on its side of
    it, so that few far ones do not make everybody else look alike.

    Args:
        log_odds: (n,) of the aggressive style, as a classifier gives them.
        seconds: (n,) for how long each was watched, s.
        place: log-odds of the drivers of the place so far; at least one must be known.

    Returns:
        (n,) 0 at the median.
    """
    known = place.values[:, 0]
    order = np.argsort(known, kind="stable")
    odds, weight = known[order], place.weights[order]
    share = np.cumsum(weight) / weight.sum()
    median = odds[min(int(np.searchsorted(share, 0.5)), odds.size - 1)]
    off, total = odds - median, weight.sum()
    above, below = (2.0 * (weight @ np.maximum(s * off, 0.0)) / total for s in (1.0, -1.0))
    far = log_odds - median
    scale = np.maximum(np.where(far > 0.0, above, below), LEAST_DEVIATION)
    worth = CONFIDENCE * seconds / (seconds + HALF_CONFIDENCE_S)
    worth *= odds.size / (odds.size + HALF_CONFIDENCE_DRIVERS)
    return np.asarray(np.clip(worth * far / scale, -FARTHEST_ODDS, FARTHEST_ODDS))


def log_odds_of(probability: FloatArray) -> FloatArray:
    """(...) log-odds of shares (...) of the aggressive style, at most `FARTHEST_ODDS`.

    Examples:
        >>> log_odds_of(np.array([0.5, 1.0]))
        array([0. , 9.2])
    """
    low = 1.0 / (1.0 + np.exp(FARTHEST_ODDS))
    held = np.clip(probability, low, 1.0 - low)
    return np.asarray(np.log(held / (1.0 - held)))


def restyled(
    probability: FloatArray, aggressive: FloatArray, style: NDArray[np.bool_]
) -> FloatArray:
    """Behaviours of given probability, with another probability of the aggressive style.

    Args:
        probability: (n, C) that sum to one.
        aggressive: (n,) probability of the aggressive style.
        style: (C,) which behaviours are aggressive.

    Returns:
        (n, C) with the odds within each style as they were.

    Examples:
        >>> restyled(np.array([[0.6, 0.2, 0.2]]), np.array([0.4]), np.array([True, True, False]))
        array([[0.3, 0.1, 0.6]])
    """
    share = np.where(style, aggressive[:, None], 1.0 - aggressive[:, None])
    held = np.maximum(probability, 1e-9)
    total = np.stack([held[:, ~style].sum(axis=1), held[:, style].sum(axis=1)], axis=1)
    return np.asarray(held / total[:, style.astype(np.int64)] * share)
