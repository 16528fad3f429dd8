"""The level of a place: how aggressive everybody there looks.

Answers in foreign traffic rank the drivers of a place well, and are offset as a whole. What a
classifier says of all the drivers of a place (`PlaceDrivers`) shows part of that offset: two groups
of drivers far apart are likely the two styles, wherever zero lies between them. In simulated
worlds, where styles are known, another classifier learns from a driver's log-odds and the place's
numbers what they are worth (`level_inputs`). At a recorded place nothing says how people there
compare with simulated ones; only the differences between drivers count there (`beside_others`).

References:
    Platt (1999), Probabilistic outputs for support vector machines: calibration of scores.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MEMORY_S: Final = 300.0
"""A driver counts for so long after it was last seen, s: as long as scenes remember what is
usual."""

FULL_WEIGHT_S: Final = 20.0
"""Time watched from which a driver has full weight, s."""

FARTHEST_ODDS: Final = 9.2
"""Log-odds beyond this count as this: 1 in 10,000."""

QUANTILES: Final = (0.1, 0.25, 0.5, 0.75, 0.9)
"""Quantiles of the drivers' log-odds."""

NUMBERS: Final = (
    "mean", "deviation", *(f"{q:.0%} quantile" for q in QUANTILES), "cut", "separation",
    "mean below cut", "mean above cut", "log drivers", "share aggressive",
)  # fmt: skip
"""Numbers of a place; the cut splits its drivers into the two groups with the least variance within
(Otsu 1979), and the separation is the share of the variance between them."""

LEVEL_INPUTS: Final = 2 + len(NUMBERS) + 3
"""Columns of `level_inputs`."""

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


class PlaceDrivers:
    """What is believed of the drivers of a place so far.

    Each driver counts once, with its last log-odds of the aggressive style.

    Examples:
        >>> place = PlaceDrivers()
        >>> place.observe(0.0, np.arange(4), np.array([-1.0, -1.0, 3.0, 3.0]), np.full(4, 20.0))
        >>> numbers = dict(zip(NUMBERS, place.numbers().round(2).tolist()))
        >>> numbers["mean"], numbers["cut"], numbers["separation"]
        (1.0, 1.0, 1.0)
    """

    def __init__(self) -> None:
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._seen_s: FloatArray = np.empty(0)
        self.log_odds: FloatArray = np.empty(0)
        self._seconds: FloatArray = np.empty(0)

    def observe(
        self, time_s: float, ids: IntArray, log_odds: FloatArray, seconds: FloatArray
    ) -> None:
        """Take what is believed now.

        Args:
            time_s: not earlier than at the call before.
            ids: (n,) drivers, each once.
            log_odds: (n,) of the aggressive style.
            seconds: (n,) for how long each was watched, s.
        """
        kept = ~np.isin(self._ids, ids) & (self._seen_s >= time_s - MEMORY_S)
        self._ids = np.concatenate([self._ids[kept], ids])
        self._seen_s = np.concatenate([self._seen_s[kept], np.full(ids.size, time_s)])
        self.log_odds = np.concatenate([self.log_odds[kept], log_odds])
        self._seconds = np.concatenate([self._seconds[kept], seconds])

    def _sorted(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log-odds ascending, their weights, and the cumulated share of the weights."""
        order = np.argsort(self.log_odds, kind="stable")
        weight = np.clip(self._seconds[order], 0.1, FULL_WEIGHT_S)
        below = np.cumsum(weight)
        return self.log_odds[order], weight, below / below[-1]

    def numbers(self) -> FloatArray:
        """(len(NUMBERS),) what the drivers look like; at least one of them must be known."""
        odds, weight, share = self._sorted()
        weight = weight / weight.sum()
        mean = float(weight @ odds)
        variance = float(weight @ (odds - mean) ** 2)
        quantiles = odds[np.minimum(np.searchsorted(share, QUANTILES), odds.size - 1)]
        cut, separation, low, high = mean, 0.0, mean, mean
        if odds.size > 2:
            under = share[:-1]
            moment = np.cumsum(weight * odds)[:-1]
            lows, highs = moment / under, (mean - moment) / np.maximum(1.0 - under, 1e-9)
            between = under * (1.0 - under) * (highs - lows) ** 2
            at = int(between.argmax())
            cut, low, high = 0.5 * (odds[at] + odds[at + 1]), lows[at], highs[at]
            separation = float(between[at]) / max(variance, 1e-6)
        split = [cut, separation, low, high, np.log(odds.size), float(weight[odds > 0.0].sum())]
        return np.array([mean, np.sqrt(variance), *quantiles, *split])

    def beside_others(self, log_odds: FloatArray, seconds: FloatArray) -> FloatArray:
        """Log-odds of drivers of a place whose level nobody knows.

        A driver's distance from the place's median is taken in mean deviations of those on its side
        of it, so that few far ones do not make everybody else look alike.

        Args:
            log_odds: (n,) of the aggressive style, as the classifier gives them.
            seconds: (n,) for how long each was watched, s.

        Returns:
            (n,) 0 at the median.
        """
        odds, weight, share = self._sorted()
        median = odds[min(int(np.searchsorted(share, 0.5)), odds.size - 1)]
        off, total = odds - median, weight.sum()
        above, below = (2.0 * (weight @ np.maximum(s * off, 0.0)) / total for s in (1.0, -1.0))
        far = log_odds - median
        scale = np.maximum(np.where(far > 0.0, above, below), LEAST_DEVIATION)
        worth = CONFIDENCE * seconds / (seconds + HALF_CONFIDENCE_S)
        worth *= odds.size / (odds.size + HALF_CONFIDENCE_DRIVERS)
        return np.asarray(np.clip(worth * far / scale, -FARTHEST_ODDS, FARTHEST_ODDS))


def level_inputs(log_odds: FloatArray, seconds: FloatArray, numbers: FloatArray) -> FloatArray:
    """(n, LEVEL_INPUTS) a driver's log-odds and time, the place's numbers, and it beside these.

    Args:
        log_odds: (n,) of the aggressive style.
        seconds: (n,) for how long each was watched, s.
        numbers: what `PlaceDrivers.numbers` gives.
    """
    mean, deviation, cut = (numbers[NUMBERS.index(name)] for name in ("mean", "deviation", "cut"))
    over = log_odds - mean
    parts = [log_odds, seconds, over, over / max(deviation, LEAST_DEVIATION), log_odds - cut]
    own = np.stack(parts, axis=1)
    return np.concatenate([own, np.broadcast_to(numbers, (log_odds.size, numbers.size))], axis=1)


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
