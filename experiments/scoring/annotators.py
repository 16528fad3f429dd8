"""How far annotators agree beyond chance: Cohen's kappa for two, Fleiss's for any number."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError


def cohen_kappa(first: Sequence[Hashable], second: Sequence[Hashable]) -> float:
    """Agreement of two annotators.

    Args:
        first: the first annotator's answers.
        second: the second annotator's answers on the same agents.

    Returns:
        1 for perfect agreement, 0 for chance, negative below it; NaN where both always gave the
        same one answer.

    Raises:
        InputError: if the lengths differ or there is nothing to compare.

    References:
        Cohen (1960), Educational and Psychological Measurement 20, 37.

    Examples:
        >>> cohen_kappa("aabb", "aabb"), cohen_kappa("aabb", "abab")
        (1.0, 0.0)
    """
    if len(first) != len(second) or not first:
        raise InputError(
            f"annotators: found {len(first)} and {len(second)} answers, expected as many of both, "
            "at least 1"
        )
    if len({*first, *second}) == 1:
        return float("nan")  # scikit-learn answers the same, with two warnings
    from sklearn.metrics import cohen_kappa_score

    return float(cohen_kappa_score(list(first), list(second)))


def fleiss_kappa(counts: NDArray[np.int64]) -> float:
    """Agreement of any number of annotators.

    Args:
        counts: (n, k) how many annotators gave agent i the answer j; every agent has equally many
            answers, at least 2.

    Returns:
        1 for perfect agreement, 0 for chance, negative below it; NaN where all annotators always
        gave the same one answer.

    Raises:
        InputError: if agents differ in their number of answers, or have fewer than 2.

    References:
        Fleiss (1971), Psychological Bulletin 76, 378.

    Examples:
        >>> fleiss_kappa(np.array([[3, 0], [0, 3]]))
        1.0
    """
    table = np.asarray(counts)
    answers = table.sum(axis=1) if table.ndim == 2 else np.empty(0)
    if not answers.size or answers.min() != answers.max() or answers[0] < 2 or table.min() < 0:
        raise InputError(
            "counts: found uneven numbers of answers, expected as many for every agent, at least 2"
        )
    if np.count_nonzero(table.any(axis=0)) == 1:
        return float("nan")  # statsmodels answers the same, with a warning
    from statsmodels.stats import inter_rater

    return float(inter_rater.fleiss_kappa(table))
