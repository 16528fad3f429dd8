"""Statistics that only benches need: areas under curves, and the majority class of training."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.score.metrics import RESAMPLES, RESAMPLING_SEED, FloatArray, IntArray
from experiments.score.rows import Cell
from graphrqi.samples import Samples


def majority_of(samples: Samples) -> int:
    """The most frequent class among samples (of the training episodes, to be a fair rival)."""
    return int(np.bincount(samples.codes, minlength=len(BEHAVIORS)).argmax())


def prediction_keys(
    scenario: str, predictor: str, horizon_s: float, split: str, behavior: str = "all"
) -> dict[str, Cell]:
    """What the rows of prediction say was measured."""
    return {
        "scenario": scenario, "predictor": predictor, "horizon_s": horizon_s,
        "behavior": behavior, "split": split,
    }  # fmt: skip


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
