"""Ranks policies by score, and compares the ranking among clones with that in diverse traffic."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from experiments.score.metrics import RESAMPLES
from experiments.score.rows import Cell, Row, tidy_row
from sim.frames import FloatArray


def drawn_anew(episodes: int, scenarios: int = 1) -> FloatArray:
    """(RESAMPLES, episodes) how often each episode is drawn, seeds anew within each scenario.

    The scenarios are those that are there, no sample of others; the seeds are a sample.

    Args:
        episodes: how many, scenario by scenario, as many of each.
        scenarios: how many.

    Examples:
        >>> weight = drawn_anew(6, scenarios=2)
        >>> weight.shape, set(weight[:, :3].sum(axis=1).tolist())
        ((2000, 6), {3.0})
    """
    seeds = episodes // scenarios
    rng = np.random.default_rng(0)
    weight = rng.multinomial(seeds, np.full(seeds, 1.0 / seeds), size=(RESAMPLES, scenarios))
    return weight.reshape(RESAMPLES, episodes).astype(np.float64)


def mean_row(keys: Mapping[str, Cell], metric: str, values: FloatArray, scenarios: int = 1) -> Row:
    """The mean of (n,) values with its interval; none where each scenario has one seed."""
    low = high = None
    if values.size > scenarios:
        means = drawn_anew(values.size, scenarios) @ values / values.size
        low, high = (float(end) for end in np.quantile(means, [0.025, 0.975]))
    return tidy_row(keys, metric, float(values.mean()), low, high, values.size)


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
    scores: Mapping[str, FloatArray],
    policies: Sequence[str],
    homogeneous: str,
    diverse: str,
    scenarios: int = 1,
) -> list[Row]:
    """The ranks in every crowd, and what clones make of the ranking.

    Args:
        scores: by crowd, (policies, n) scores; the n episodes are the same ones in all crowds.
        policies: their names.
        homogeneous: the crowd of clones.
        diverse: the crowd of all behaviours.
        scenarios: how many; the episodes are in their order, as many of each.

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
        gain = clones[p] - mixed[p]
        rows.append(mean_row(keys, "score_minus_diverse", gain, scenarios))
    both: dict[str, Cell] = {"scenario": "all", "crowd": homogeneous, "policy": "all"}
    n = clones.shape[1]
    found = float(swapped(clones.mean(axis=1), mixed.mean(axis=1)))
    if n == scenarios:
        return [*rows, tidy_row(both, "swapped_pairs", found, None, None, n)]
    weight = drawn_anew(n, scenarios)
    means = list(zip(weight @ clones.T, weight @ mixed.T, strict=True))
    counts = np.array([swapped(one, two) for one, two in means])
    low, high = (float(end) for end in np.quantile(counts, [0.025, 0.975]))
    rows.append(tidy_row(both, "swapped_pairs", found, low, high, n))
    other = float(np.mean([one.argmax() != two.argmax() for one, two in means]))
    rows.append(tidy_row(both, "best_differs", other, None, None, n))
    return rows
