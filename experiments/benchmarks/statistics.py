"""Areas under curves, for the benchmarks' own bootstraps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from experiments.score.metrics import RESAMPLES, RESAMPLING_SEED
from experiments.score.rows import Cell
from sim.frames import FloatArray, IntArray


def prediction_keys(
    scenario: str, predictor: str, horizon_s: float, split: str, behavior: str = "all"
) -> dict[str, Cell]:
    """Keys of the rows of prediction."""
    return {
        "scenario": scenario, "predictor": predictor, "horizon_s": horizon_s,
        "behavior": behavior, "split": split,
    }  # fmt: skip


def auc(score: FloatArray, positive: NDArray[np.bool_]) -> FloatArray:
    """(...) area under the ROC curve of each line of scores (..., n), by their ranks.

    References:
        Mann and Whitney (1947), On a test of whether one of two random variables is
        stochastically larger than the other, Ann. Math. Statist. 18.

    Examples:
        >>> float(auc(np.array([0.9, 0.4, 0.4]), np.array([True, True, False])))
        0.75
    """
    from scipy.stats import rankdata

    up = positive.sum(axis=-1)
    ranks = (rankdata(score, axis=-1) * positive).sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((ranks - up * (up + 1) / 2) / (up * (positive.shape[-1] - up)))


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
        beats = (up[:, None] > down) + 0.5 * (up[:, None] == down)
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
