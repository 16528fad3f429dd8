"""Recorded people are compared with one another: nobody knows the level of their place."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.places.drivers import PlaceDrivers

FloatArray = NDArray[np.float64]

FARTHEST_ODDS: Final = 9.2
"""Log-odds beyond this count as this: 1 in 10,000."""

USUAL_DEVIATION: Final = 3.5
"""Mean deviation of log-odds from the median on either side, where few drivers are known. At eight
recorded places it is .9 to 6.6, and the median itself -1.0 to 2.9, so that 0 stands for that."""

LEAST_DEVIATION: Final = 1.0
"""Log-odds that lie closer together than this do not tell drivers apart."""

CONFIDENCE: Final = 1.75
"""Log-odds of a driver at a recorded place that lies a mean deviation from the median, watched for
long. Answers of two halves of a track rank drivers of a place alike with Spearman .3 to .8, so that
only the outer third of the drivers is told (our choice)."""

MOST_CONFIDENCE: Final = 3.0
"""Log-odds that the farthest one approaches: a probability of .95. Of those who stand out in the
first half of their track, .63 to .84 are on the same side of the median in the second one."""

HALF_CONFIDENCE_S: Final = 2.0
"""Time watched at which half of that confidence is reached, s. On US-101 halves of tracks agree
then as often as they claim."""

HALF_CONFIDENCE_DRIVERS: Final = 5.0
"""Drivers seen at the place at which half of it is reached, and at which its own median and
deviations count half: few show no level."""


def beside_others(log_odds: FloatArray, seconds: FloatArray, place: PlaceDrivers) -> FloatArray:
    """Log-odds of drivers of a place whose level nobody knows.

    A driver's distance from the place's median is taken in mean deviations of those on its side of
    it, so that few far ones do not make everybody else look alike. Where few drivers are known,
    median and deviation stay near what is usual.

    Args:
        log_odds: (n,) of the aggressive style, as a classifier gives them.
        seconds: (n,) for how long each was watched, s.
        place: log-odds of the drivers of the place so far; at least one must be known.

    Returns:
        (n,) near 0 at the median.
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
    """How far a number of drivers shows what is usual at their place, from 0 to 1.

    Examples:
        >>> level_shown(5)
        0.5
    """
    return drivers / (drivers + HALF_CONFIDENCE_DRIVERS)


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
