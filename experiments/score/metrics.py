"""Statistics of counts that are summed by episode, with 95 % intervals over episodes.

Cases of one episode are not independent, so a bootstrap resamples episodes. Everything is computed
from sums by episode (such as one confusion matrix each), so that thousands of resamples cost next
to nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.score.rows import Cell, Row, tidy_row
from sim.frames import BoolArray, FloatArray, IntArray

Statistic = Callable[[FloatArray], FloatArray]

RESAMPLES, RESAMPLING_SEED, LEAST_EPISODES = 2000, 0, 3
"""Bootstrap resamples (enough for two digits of a 95 % interval), their seed, and the fewest
episodes that give an interval (two give their own figures as its ends)."""

CONFIDENCE_BINS: Final = 15
"""Bins of equal width for calibration (Guo et al., ICML 2017)."""


def bootstrap(statistic: Statistic, per_episode: FloatArray) -> tuple[float, float, float]:
    """A statistic of summed counts (E, ...) of each episode, with its 95 % interval over episodes.

    The statistic takes a stack of sums, too. The interval is NaN with fewer than `LEAST_EPISODES`.

    Examples:
        >>> right = np.array([[8.0, 10.0], [7.0, 10.0], [6.0, 10.0]])  # right answers, all answers
        >>> bootstrap(ratio, right)
        (0.7, 0.6, 0.8)
    """
    value = float(statistic(per_episode.sum(axis=0)))
    episodes = len(per_episode)
    if episodes < LEAST_EPISODES or not np.isfinite(value):
        return value, float("nan"), float("nan")
    rng = np.random.default_rng(RESAMPLING_SEED)
    drawn = rng.multinomial(episodes, np.full(episodes, 1.0 / episodes), size=RESAMPLES)
    values = statistic(np.tensordot(drawn.astype(np.float64), per_episode, axes=1))
    low, high = np.nanquantile(values, [0.025, 0.975])
    return value, float(low), float(high)


def row_of(
    keys: Mapping[str, Cell], metric: str, statistic: Statistic, per_episode: FloatArray, n: int
) -> Row:
    """The row of a statistic with its interval, see `bootstrap`."""
    return tidy_row(keys, metric, *bootstrap(statistic, per_episode), n)


def ratio(sums: FloatArray) -> FloatArray:
    """The first of two summed columns (..., 2) over the second: of a sum and a count, a mean."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(sums[..., 0] / sums[..., 1])


def root_ratio(sums: FloatArray) -> FloatArray:
    """The root of a `ratio`: of squares and a count, the root mean square."""
    return np.sqrt(ratio(sums))


def _totals(
    group: IntArray, code: NDArray[np.integer[Any]], size: int, weight: NDArray[Any] | None = None
) -> FloatArray:
    """(G, size) sums of a weight (n,) over each code in each group."""
    known, number = np.unique(group, return_inverse=True)
    found = np.bincount(number * size + code, weight, minlength=known.size * size)
    return found.reshape(known.size, size).astype(np.float64)


def summed(group: IntArray, above: NDArray[Any], below: NDArray[Any]) -> FloatArray:
    """(G, 2) sums of two columns (n,) over each group, of which `ratio` is the share."""
    none = np.zeros_like(group)
    return np.concatenate([_totals(group, none, 1, each) for each in (above, below)], axis=1)


def confusion(
    truth: NDArray[np.integer[Any]], answer: IntArray, episode: IntArray, k: int = len(BEHAVIORS)
) -> FloatArray:
    """(E, k, k) count of each answer (n,) to each true code (n,) by episode; rows are true."""
    return _totals(episode, truth.astype(np.int64) * k + answer, k * k).reshape(-1, k, k)


def recalls(matrix: FloatArray) -> FloatArray:
    """(..., k) recall of each class; NaN where the class does not occur."""
    total = matrix.sum(axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.diagonal(matrix, axis1=-2, axis2=-1) / np.where(total, total, np.nan))


def weighted_accuracy(matrix: FloatArray) -> FloatArray:
    """The paper's A_w = sum of class share times class recall, which is plain accuracy."""
    return np.asarray(np.trace(matrix, axis1=-2, axis2=-1) / matrix.sum(axis=(-2, -1)))


def balanced_accuracy(matrix: FloatArray) -> FloatArray:
    """Mean recall of the classes that occur."""
    return np.asarray(np.nanmean(recalls(matrix), axis=-1))


def macro_f1(matrix: FloatArray) -> FloatArray:
    """Mean F1 of the classes that occur."""
    hit = np.diagonal(matrix, axis1=-2, axis2=-1)
    occurs = matrix.sum(axis=-1) > 0
    whole = matrix.sum(axis=-1) + matrix.sum(axis=-2)
    f1 = 2.0 * hit / np.where(whole > 0, whole, 1.0)
    return np.asarray(np.where(occurs, f1, 0.0).sum(axis=-1) / occurs.sum(axis=-1))


def reliability(right: BoolArray, confidence: FloatArray, episode: IntArray) -> FloatArray:
    """(E, bins, 3) answers by episode and bin of confidence, their confidences' sum, and the right.

    Whether an answer is right, its confidence and its episode are (n,).
    """
    place = np.minimum((confidence * CONFIDENCE_BINS).astype(np.int64), CONFIDENCE_BINS - 1)
    weights = (np.ones(right.size), confidence, right)
    return np.stack([_totals(episode, place, CONFIDENCE_BINS, w) for w in weights], axis=2)


def calibration_error(bins: FloatArray) -> FloatArray:
    """(...) mean distance of confidence from accuracy over bins (..., bins, 3) of `reliability`."""
    missed = np.abs(bins[..., 1] - bins[..., 2]).sum(axis=-1)
    return np.asarray(missed / bins[..., 0].sum(axis=-1))


def auc_over_episodes(
    score: FloatArray, positive: BoolArray, episode: IntArray, group: IntArray | None = None
) -> tuple[float, float, float]:
    """Area under the ROC curve over all pairs (n,), and its 95 % interval over episodes.

    Equal to scikit-learn's ``roc_auc_score``; from the pairs won between any two episodes, all
    resamples follow at once. With groups (E,) of the episodes in ascending order, only pairs of
    one group count. NaN where there are no pairs.
    """
    known, number = np.unique(episode, return_inverse=True)
    count = known.size
    ups, downs = (np.bincount(number[side], minlength=count) for side in (positive, ~positive))
    won = np.zeros((count, count))
    for each in range(count):
        below = np.sort(score[~positive][number[~positive] == each])
        left, right = (np.searchsorted(below, score[positive], side=s) for s in ("left", "right"))
        won[:, each] = np.bincount(number[positive], 0.5 * (left + right), minlength=count)
    pairs = np.outer(ups, downs).astype(np.float64)
    if group is not None:
        won, pairs = (each * (group[:, None] == group) for each in (won, pairs))

    def area(drawn: FloatArray) -> FloatArray:
        sums = [((drawn @ each) * drawn).sum(axis=-1) for each in (won, pairs)]
        return ratio(np.stack(sums, axis=-1))

    return bootstrap(area, np.eye(count))
