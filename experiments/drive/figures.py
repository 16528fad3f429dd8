"""The figures of a licence test: means, ranks, and what clones and beliefs make of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from scipy.stats import rankdata

from experiments.drive.crowds import HOMOGENEOUS, MIXED
from experiments.drive.episode import METRICS
from experiments.drive.policies import BLIND
from experiments.rows import Cell, Row, tidy_row
from sim.frames import FloatArray

RESAMPLES: Final = 2000
"""Bootstrap resamples (enough for two digits of a 95 % interval)."""


def mean_row(keys: Mapping[str, Cell], metric: str, values: FloatArray) -> Row:
    """The mean of (scenarios, seeds) values with its interval over seeds.

    The scenarios are those that are there, no sample of others; seeds are drawn anew within each.
    With one seed there is no interval.
    """
    scenarios, seeds = values.shape
    low = high = None
    if seeds > 1:
        rng = np.random.default_rng(0)
        weight = rng.multinomial(seeds, np.full(seeds, 1 / seeds), (RESAMPLES, scenarios))
        low, high = np.quantile((weight * values).sum(axis=(1, 2)) / values.size, [0.025, 0.975])
    return tidy_row(keys, metric, float(values.mean()), low, high, values.size)


def figure_rows(
    scenario: str, crowds: Sequence[str], policies: Sequence[str], table: FloatArray
) -> list[Row]:
    """Rows of every crowd and policy.

    Args:
        scenario: what stands in the rows.
        crowds: their names.
        policies: their names.
        table: (scenarios, seeds, crowds, policies, metrics) what was measured.

    Returns:
        The mean of each of the `METRICS`, and the ``rank`` by score in the crowd. Paired by seed:
        by how much clones flatter a policy (``score_minus_diverse``), and what a planner gains by
        what it knows (``score_minus_blind``, ``near_misses_minus_blind``).
    """
    found: list[Row] = []
    scores = table[..., METRICS.index("score")]
    for c, crowd in enumerate(crowds):
        rank = rankdata(-scores[:, :, c].mean(axis=(0, 1)))
        for p, policy in enumerate(policies):
            keys: dict[str, Cell] = {"scenario": scenario, "crowd": crowd, "policy": policy}
            own = table[:, :, c, p]
            found += [mean_row(keys, metric, own[..., m]) for m, metric in enumerate(METRICS)]
            found.append(tidy_row(keys, "rank", float(rank[p]), None, None, own[..., 0].size))
            if crowd == HOMOGENEOUS and MIXED in crowds:
                gain = scores[:, :, c, p] - scores[:, :, crowds.index(MIXED), p]
                found.append(mean_row(keys, "score_minus_diverse", gain))
            if policy in ("planner-told", "planner-true") and BLIND in policies:
                blind = table[:, :, c, policies.index(BLIND)]
                for metric in ("score", "near_misses"):
                    m = METRICS.index(metric)
                    gain = own[..., m] - blind[..., m]
                    found.append(mean_row(keys, f"{metric}_minus_blind", gain))
    return found
