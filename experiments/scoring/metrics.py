"""Scores of classifiers from confusion matrices, with intervals over episodes.

Everything is computed from one confusion matrix per episode, so that a bootstrap resamples
episodes (windows of one episode are not independent) and costs next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS, Style

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

RESAMPLES: Final = 2000
"""Bootstrap resamples (enough for two digits of a 95 % interval)."""

RESAMPLING_SEED: Final = 0
"""Of every bootstrap, so that the same data have the same interval."""

_STYLE: Final = np.array([0 if b.style is Style.AGGRESSIVE else 1 for b in BEHAVIORS])


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its 95 % interval.

    Attributes:
        value: over all episodes together.
        low: 2.5 % quantile of the bootstrap over episodes.
        high: 97.5 % quantile.
        n: how many samples it rests on.
        split: which part of the data it was measured on.
    """

    value: float
    low: float
    high: float
    n: int
    split: str

    def as_dict(self) -> dict[str, float | int | str | None]:
        """For JSON, which has no NaN: what is unknown is None."""
        return {name: None if x != x else x for name, x in asdict(self).items()}


def _numbered(episode: IntArray) -> tuple[IntArray, int]:
    """(n,) which of the episodes each belongs to, counted from 0, and how many there are."""
    known, number = np.unique(episode, return_inverse=True)
    return number, known.size


def confusion(
    truth: NDArray[np.int8], answer: IntArray, episode: IntArray, k: int = len(BEHAVIORS)
) -> FloatArray:
    """Count answers.

    Args:
        truth: (n,) true codes.
        answer: (n,) codes answered.
        episode: (n,) episode numbers.
        k: how many classes there are.

    Returns:
        (E, k, k) one matrix per episode; rows are true classes.
    """
    number, count = _numbered(episode)
    flat = (number * k + truth.astype(np.int64)) * k + answer
    return np.bincount(flat, minlength=count * k * k).reshape(count, k, k).astype(np.float64)


def _recall(matrix: FloatArray) -> FloatArray:
    """(..., K) recall of each class; NaN where the class does not occur."""
    total = matrix.sum(axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.diagonal(matrix, axis1=-2, axis2=-1) / np.where(total, total, np.nan))


def weighted_accuracy(matrix: FloatArray) -> FloatArray:
    """The paper's A_w = sum of class share times class recall, which is plain accuracy."""
    return np.asarray(np.trace(matrix, axis1=-2, axis2=-1) / matrix.sum(axis=(-2, -1)))


def balanced_accuracy(matrix: FloatArray) -> FloatArray:
    """Mean recall of the classes that occur.

    Examples:
        >>> float(balanced_accuracy(np.array([[8.0, 2.0], [0.0, 2.0]])))
        0.9
    """
    return np.asarray(np.nanmean(_recall(matrix), axis=-1))


def macro_f1(matrix: FloatArray) -> FloatArray:
    """Mean F1 of the classes that occur."""
    hit = np.diagonal(matrix, axis1=-2, axis2=-1)
    occurs = matrix.sum(axis=-1) > 0
    whole = matrix.sum(axis=-1) + matrix.sum(axis=-2)
    f1 = 2.0 * hit / np.where(whole > 0, whole, 1.0)
    return np.asarray(np.where(occurs, f1, 0.0).sum(axis=-1) / occurs.sum(axis=-1))


def style_balanced_accuracy(matrix: FloatArray) -> FloatArray:
    """Mean recall of aggressive and conservative, of answers as from `of_likelier_style`."""
    to_style = np.eye(2)[_STYLE]
    return balanced_accuracy(np.asarray(to_style.T @ matrix @ to_style))


def likeliest(probability: FloatArray) -> IntArray:
    """(n,) the most likely class, from posteriors (n, 6)."""
    return np.asarray(probability.argmax(axis=1), dtype=np.int64)


def of_likelier_style(probability: FloatArray) -> IntArray:
    """(n,) the most likely class of the more likely style, from posteriors (n, 6).

    Three conservative classes may be likely together, none of them alone.

    Examples:
        >>> p = np.array([[0.4, 0.0, 0.0, 0.35, 0.25, 0.0]])
        >>> likeliest(p).tolist(), of_likelier_style(p).tolist()
        ([0], [3])
    """
    by_style = probability @ np.eye(2)[_STYLE]
    style = by_style.argmax(axis=1)
    return likeliest(np.where(style[:, None] == _STYLE, probability, -1.0))


def recall_of(code: int) -> Callable[[FloatArray], FloatArray]:
    """The recall of one class; NaN where it does not occur.

    Examples:
        >>> float(recall_of(1)(np.array([[8.0, 2.0], [1.0, 3.0]])))
        0.75
    """
    return lambda matrix: np.asarray(_recall(matrix)[..., code])


CONFIDENCE_BINS: Final = 15
"""Bins of equal width for calibration (Guo et al., ICML 2017)."""


def reliability(truth: NDArray[np.int8], probability: FloatArray, episode: IntArray) -> FloatArray:
    """How often answers given with a certain confidence are right.

    Args:
        truth: (n,) true codes.
        probability: (n, k) posteriors; the answer is the most likely class.
        episode: (n,) episode numbers.

    Returns:
        (E, bins, 3) per episode and bin of confidence: answers, the sum of their confidences, and
        how many were right.
    """
    confidence = probability.max(axis=1)
    right = probability.argmax(axis=1) == truth
    number, count = _numbered(episode)
    number_of_bin = np.minimum((confidence * CONFIDENCE_BINS).astype(np.int64), CONFIDENCE_BINS - 1)
    flat = number * CONFIDENCE_BINS + number_of_bin
    columns = [
        np.bincount(flat, weights, minlength=count * CONFIDENCE_BINS)
        for weights in (np.ones(truth.size), confidence, right.astype(np.float64))
    ]
    bins = np.stack(columns, axis=1).reshape(count, CONFIDENCE_BINS, 3)
    return np.asarray(bins, dtype=np.float64)


def calibration_error(bins: FloatArray) -> FloatArray:
    """Expected calibration error: mean distance of confidence from accuracy, over the bins.

    Args:
        bins: (..., bins, 3) as from `reliability`.

    Returns:
        (...) between 0 and 1.

    Examples:
        >>> float(calibration_error(np.array([[4.0, 3.2, 2.0], [1.0, 0.9, 1.0]])).round(2))
        0.26
    """
    missed = np.abs(bins[..., 1] - bins[..., 2]).sum(axis=-1)
    return np.asarray(missed / bins[..., 0].sum(axis=-1))


def auc(score: FloatArray, positive: FloatArray) -> float:
    """Area under the ROC curve: the probability that a positive scores above a negative.

    Equal to scikit-learn's ``roc_auc_score``, which takes a hundred times as long: intervals need
    thousands of values.

    Examples:
        >>> auc(np.array([0.9, 0.4, 0.4]), np.array([1.0, 1.0, 0.0]))
        0.75
    """
    up, down = score[positive > 0.5], np.sort(score[positive <= 0.5])
    if not up.size or not down.size:
        return float("nan")
    below = np.searchsorted(down, up, side="left") + np.searchsorted(down, up, side="right")
    return float(below.mean() / (2 * down.size))


def brier(chance: FloatArray, happened: FloatArray) -> float:
    """Mean squared difference between chance and outcome."""
    return float(((chance - happened) ** 2).mean())


def pairs_won(up: FloatArray, down: FloatArray) -> FloatArray:
    """(n, m) 1 where a positive scores above a negative, 1/2 where both score the same."""
    return np.asarray((up[:, None] > down) + 0.5 * (up[:, None] == down))


def auc_within(
    score: FloatArray, positive: NDArray[np.bool_], group: IntArray
) -> tuple[float, float, float]:
    """Area under the ROC curve over pairs from the same group, with an interval over samples.

    Args:
        score: (n,) larger for positives.
        positive: (n,) truth.
        group: (n,) which video or episode each belongs to; only pairs inside one count.

    Returns:
        Value, low, high; NaN where no group has both kinds.

    Examples:
        >>> where = np.array([0, 0, 0, 1, 1])
        >>> truth = np.array([True, False, False, True, False])
        >>> auc_within(np.array([0.9, 0.1, 0.95, 0.2, 0.1]), truth, where)[0].__round__(3)
        0.667
    """
    rng = np.random.default_rng(RESAMPLING_SEED)
    won, pairs = np.zeros(RESAMPLES + 1), np.zeros(RESAMPLES + 1)
    for each in np.unique(group):
        here = group == each
        up, down = score[here & positive], score[here & ~positive]
        beats = pairs_won(up, down)
        weights = [np.ones((RESAMPLES + 1, part.size)) for part in (up, down)]
        for weight, part in zip(weights, (up, down), strict=True):
            if part.size:
                weight[1:] = rng.multinomial(
                    part.size, np.full(part.size, 1.0 / part.size), size=RESAMPLES
                )
        won += ((weights[0] @ beats) * weights[1]).sum(axis=1)
        pairs += weights[0].sum(axis=1) * weights[1].sum(axis=1)
    if pairs[0] == 0:
        return float("nan"), float("nan"), float("nan")
    area = won / pairs
    low, high = np.quantile(area[1:], [0.025, 0.975])
    return float(area[0]), float(low), float(high)


Answer = Callable[[FloatArray], IntArray]
Statistic = Callable[[FloatArray], FloatArray]

METRICS: Final[dict[str, tuple[Answer, Statistic]]] = {
    "weighted_accuracy": (likeliest, weighted_accuracy),
    "balanced_accuracy": (likeliest, balanced_accuracy),
    "macro_f1": (likeliest, macro_f1),
    "style_balanced_accuracy": (of_likelier_style, style_balanced_accuracy),
}
"""What is answered, from posteriors (n, 6), and the score of the answers' confusion matrix (or a
stack of them); larger is better."""


def ratio(sums: FloatArray) -> FloatArray:
    """The first of two summed columns (..., 2) over the second: of a sum and a count, a mean."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(sums[..., 0] / sums[..., 1])


def summed(group: IntArray, above: NDArray[Any], below: NDArray[Any]) -> FloatArray:
    """(G, 2) sums of two columns (n,) over each group, of which `ratio` is the share.

    Examples:
        >>> where, right = np.array([4, 4, 7]), np.array([True, False, True])
        >>> summed(where, right, np.ones(3)).tolist()
        [[1.0, 2.0], [1.0, 1.0]]
    """
    number, _ = _numbered(group)
    columns = [np.bincount(number, each.astype(np.float64)) for each in (above, below)]
    return np.stack(columns, axis=1)


def bootstrap(statistic: Statistic, per_episode: FloatArray) -> tuple[float, float, float]:
    """A statistic of summed per-episode counts, with its 95 % interval over episodes.

    Args:
        statistic: of summed counts; takes a stack.
        per_episode: (E, ...) counts of each episode.

    Returns:
        Value, low, high; with a single episode nothing is known of the spread and low and high
        are NaN.
    """
    value = float(statistic(per_episode.sum(axis=0)))
    if len(per_episode) < 2:
        return value, float("nan"), float("nan")

    def weighted(weight: FloatArray) -> FloatArray:
        return statistic(np.tensordot(weight, per_episode, axes=1))

    return value, *_interval(weighted, len(per_episode))


def _interval(weighted: Statistic, episodes: int) -> tuple[float, float]:
    """The 95 % interval of a statistic of (RESAMPLES, E) how often each episode is drawn."""
    rng = np.random.default_rng(RESAMPLING_SEED)
    weight = rng.multinomial(episodes, np.full(episodes, 1.0 / episodes), size=RESAMPLES)
    low, high = np.nanquantile(weighted(weight.astype(np.float64)), [0.025, 0.975])
    return float(low), float(high)


def auc_over_episodes(
    score: FloatArray, positive: NDArray[np.bool_], episode: IntArray
) -> tuple[float, float, float]:
    """Area under the ROC curve over all pairs, with an interval over episodes.

    Args:
        score: (n,) larger for positives.
        positive: (n,) truth.
        episode: (n,) episode numbers.

    Returns:
        Value, low, high; NaN where there are no pairs, low and high with a single episode too.

    Examples:
        >>> truth, where = np.array([True, False, True]), np.array([0, 0, 1])
        >>> auc_over_episodes(np.array([0.9, 0.5, 0.4]), truth, where)[0]
        0.5
    """
    number, count = _numbered(episode)
    ups, downs = np.bincount(number[positive], minlength=count), number[~positive]
    won = np.zeros((count, count))
    for each in range(count):
        below = np.sort(score[~positive][downs == each])
        left, right = (np.searchsorted(below, score[positive], side=s) for s in ("left", "right"))
        won[:, each] = np.bincount(number[positive], 0.5 * (left + right), minlength=count)
    pairs = np.outer(ups, np.bincount(downs, minlength=count)).astype(np.float64)

    def area(weight: FloatArray) -> FloatArray:
        with np.errstate(invalid="ignore"):
            return np.asarray(
                ((weight @ won) * weight).sum(axis=-1) / ((weight @ pairs) * weight).sum(axis=-1)
            )

    value = float(area(np.ones(count))) if count else float("nan")
    if count < 2 or not np.isfinite(value):
        return value, float("nan"), float("nan")
    return value, *_interval(area, count)


def score(
    truth: NDArray[np.int8],
    probability: FloatArray,
    episode: IntArray,
    majority: int,
    split: str,
) -> dict[str, Estimate]:
    """All scores of a classifier, and the majority class beside them.

    Args:
        truth: (n,) true codes.
        probability: (n, 6) posteriors.
        episode: (n,) episode numbers.
        majority: the most frequent class of the training data.
        split: which part of the data this is.

    Returns:
        ``METRICS`` by name and ``majority_weighted_accuracy``.
    """
    constant = confusion(truth, np.full(truth.size, majority), episode)
    out = {
        name: Estimate(
            *bootstrap(metric, confusion(truth, answer(probability), episode)),
            n=int(truth.size),
            split=split,
        )
        for name, (answer, metric) in METRICS.items()
    }
    out["majority_weighted_accuracy"] = Estimate(
        *bootstrap(weighted_accuracy, constant), n=int(truth.size), split=split
    )
    return out
