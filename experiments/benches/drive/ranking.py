"""Ranks policies by score, and compares the ranking among clones with that in diverse traffic."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from experiments.rows import Cell, Row, tidy_row
from experiments.scoring.metrics import bootstrap, ratio
from sim.frames import FloatArray


def mean_row(keys: Mapping[str, Cell], metric: str, values: FloatArray) -> Row:
    """The mean of (n,) values with its interval."""
    found = bootstrap(ratio, np.column_stack([values, np.ones(values.size)]))
    return tidy_row(keys, metric, *found, values.size)


def ranks(scores: FloatArray) -> FloatArray:
    """Ranks, 1 for the best; equal scores share the mean of theirs.

    Examples:
        >>> ranks(np.array([0.2, 0.9, 0.9])).tolist()
        [3.0, 1.5, 1.5]
    """
    better = (scores[None] > scores[:, None]).sum(axis=1)
    equal = (scores[None] == scores[:, None]).sum(axis=1)
    return np.asarray(better + (equal + 1) / 2, dtype=np.float64)


def swapped(one: FloatArray, other: FloatArray) -> int:
    """How many pairs of policies stand in the opposite order by two lists of scores.

    Examples:
        >>> swapped(np.array([0.9, 0.5, 0.1]), np.array([0.5, 0.9, 0.1]))
        1
    """
    pairs = itertools.combinations(range(one.size), 2)
    return sum(bool((one[a] - one[b]) * (other[a] - other[b]) < 0) for a, b in pairs)


def ranking_rows(
    scores: Mapping[str, FloatArray], policies: Sequence[str], homogeneous: str, diverse: str
) -> list[Row]:
    """The ranks in every crowd, and what clones make of the ranking.

    Args:
        scores: by crowd, (policies, n) scores; the n episodes are the same ones in all crowds.
        policies: their names.
        homogeneous: the crowd of clones.
        diverse: the crowd of all behaviours.

    Returns:
        Of each crowd and policy its ``rank``. Where both crowds are among them, also of each policy
        by how much clones flatter it (``score_minus_diverse``, paired by seed), how many pairs of
        policies clones rank the other way (``swapped_pairs``; its interval is that over resampled
        episodes), and the share of resamples in which the best policy is another
        (``best_differs``).
    """
    rows: list[Row] = []
    for crowd, table in scores.items():
        for policy, rank in zip(policies, ranks(table.mean(axis=1)), strict=True):
            keys: dict[str, Cell] = {"scenario": "all", "crowd": crowd, "policy": policy}
            rows.append(tidy_row(keys, "rank", float(rank), None, None, table.shape[1]))
    if homogeneous not in scores or diverse not in scores:
        return rows
    clones, mixed = scores[homogeneous], scores[diverse]
    for p, policy in enumerate(policies):
        keys = {"scenario": "all", "crowd": homogeneous, "policy": policy}
        rows.append(mean_row(keys, "score_minus_diverse", clones[p] - mixed[p]))
    both: dict[str, Cell] = {"scenario": "all", "crowd": homogeneous, "policy": "all"}
    n = clones.shape[1]
    drawn = np.random.default_rng(0).integers(n, size=(2000, n))
    means = [(clones[:, d].mean(axis=1), mixed[:, d].mean(axis=1)) for d in drawn]
    counts = np.array([swapped(one, two) for one, two in means])
    low, high = np.quantile(counts, [0.025, 0.975])
    found = swapped(clones.mean(axis=1), mixed.mean(axis=1))
    rows.append(tidy_row(both, "swapped_pairs", float(found), float(low), float(high), n))
    other = float(np.mean([one.argmax() != two.argmax() for one, two in means]))
    rows.append(tidy_row(both, "best_differs", other, None, None, n))
    return rows
