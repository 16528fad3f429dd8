"""Drives every policy in every scenario among every crowd, seed by seed, and counts the figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.stats import rankdata

from behaviors.errors import InputError, lookup
from behaviors.labels import read_behaviors, tables_of
from experiments.data.parallel import in_parallel
from experiments.drive.episode import CROWDS, HOMOGENEOUS, METRICS, MIXED, ROADS, crowd_of, drive
from experiments.drive.policies import BLIND, KNOWS, POLICIES, get_policy
from experiments.report.tables import with_interval
from experiments.score.metrics import LEAST_EPISODES, RESAMPLES, RESAMPLING_SEED
from experiments.score.rows import Cell, Row, pivoted, tidy_row
from scenarios.demand import parse_mix
from sim.frames import FloatArray

STRAYS: Final = ("roundabout", "city")
"""Scenarios in which our planners leave their route: they do not know which exit is theirs."""

EVERYWHERE: Final = tuple(name for name in ROADS if name not in STRAYS)
"""The other scenarios."""

QUICK: Final[dict[str, Any]] = {
    "scenarios": ("straight_road", "right_before_left"), "crowds": (MIXED, HOMOGENEOUS),
    "episodes": 2, "duration_s": 20.0, "warmup_s": 10.0,
}  # fmt: skip
"""A test of some minutes, which shows what there is to see."""

SHOWN: Final = (
    "score", "rank", "collisions_caused", "near_misses", "rules_broken", "progress",
)  # fmt: skip
"""The figures of the table for people; the rows have all of them."""


def run_test(
    *,
    policies: Sequence[str] = tuple(POLICIES),
    scenarios: Sequence[str] = EVERYWHERE,
    crowds: Sequence[str] = tuple(CROWDS),
    episodes: int = 20,
    seed: int = 700_000,
    flow: str = "medium",
    duration_s: float = 60.0,
    warmup_s: float = 20.0,
    behaviors: str | None = None,
    jobs: int | None = None,
    quiet: bool = True,
) -> Iterator[list[Row]]:
    """Drive everything.

    Args:
        policies: names, or "module:function" of one's own.
        scenarios: keys of `ROADS`; those of `STRAYS` are not for our planners.
        crowds: as `crowd_of` takes them.
        episodes: of each policy in each scenario and crowd.
        seed: of the first episode; the planner was tuned on other ones.
        flow: of the traffic.
        duration_s: longest time that an episode takes, s.
        warmup_s: how long the traffic drives before, s.
        behaviors: behaviours of one's own that crowds name, as `read_behaviors` takes them.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Yields:
        The rows of each scenario; then those over all of them ("all"), if there are several.
    """
    for name in scenarios:
        lookup(ROADS, name, "scenario")
    own = read_behaviors(behaviors)
    for name in crowds:
        parse_mix(crowd_of(name, own).get("mix"), own)
    strayed = sorted({*scenarios} & {*STRAYS})
    for name in policies:
        get_policy(name)
        if name in KNOWS and strayed:
            expected = "another scenario or policy: planners leave their route there"
            raise InputError(f"scenario: found {strayed[0]} for {name}, expected {expected}")
    if episodes < 1:
        raise InputError(f"episodes: found {episodes}, expected at least 1")
    config = {"flow": flow, "duration_s": duration_s, "warmup_s": warmup_s}
    config |= {"behaviors": tables_of(own)} if own else {}
    shape = (1, episodes, len(crowds), len(policies), len(METRICS))
    tables = []
    for scenario in scenarios:
        arguments = [
            (scenario, crowd, policy, one, config)
            for one in range(seed, seed + episodes)
            for crowd in crowds
            for policy in policies
        ]
        found = list(in_parallel(drive, arguments, jobs, f"driving in {scenario}: episodes", quiet))
        tables.append(np.array([[one[m] for m in METRICS] for one in found]).reshape(shape))
        yield figure_rows(scenario, crowds, policies, tables[-1])
    if len(tables) > 1:
        yield figure_rows("all", crowds, policies, np.concatenate(tables))


def mean_row(keys: Mapping[str, Cell], metric: str, values: FloatArray) -> Row:
    """The mean of (scenarios, seeds) values with its interval over seeds.

    The scenarios are those that are there, not a sample; seeds are resampled within each.
    Fewer than `LEAST_EPISODES` seeds give no interval.
    """
    scenarios, seeds = values.shape
    low = high = None
    if seeds >= LEAST_EPISODES:
        rng = np.random.default_rng(RESAMPLING_SEED)
        weight = rng.multinomial(seeds, np.full(seeds, 1 / seeds), (RESAMPLES, scenarios))
        low, high = np.quantile((weight * values).sum(axis=(1, 2)) / values.size, [0.025, 0.975])
    return tidy_row(keys, metric, float(values.mean()), low, high, values.size)


def figure_rows(
    scenario: str, crowds: Sequence[str], policies: Sequence[str], table: FloatArray
) -> list[Row]:
    """Rows of every crowd and policy from a (scenarios, seeds, crowds, policies, metrics) table.

    They are the mean of each of the `METRICS`, and the ``rank`` by score in the crowd. Two
    differences are paired by seed. ``score_minus_diverse`` says by how much clones flatter a
    policy; ``score_minus_blind`` and ``near_misses_minus_blind`` what a planner gains by knowledge.
    """
    found: list[Row] = []
    place = {metric: m for m, metric in enumerate(METRICS)}
    for c, crowd in enumerate(crowds):
        rank = rankdata(-table[:, :, c, :, place["score"]].mean(axis=(0, 1)))
        for p, policy in enumerate(policies):
            keys: dict[str, Cell] = {"scenario": scenario, "crowd": crowd, "policy": policy}
            own = table[:, :, c, p]
            found += [mean_row(keys, metric, own[..., m]) for metric, m in place.items()]
            found.append(tidy_row(keys, "rank", float(rank[p]), n=own[..., 0].size))
            if crowd == HOMOGENEOUS and MIXED in crowds:
                gain = own - table[:, :, crowds.index(MIXED), p]
                found.append(mean_row(keys, "score_minus_diverse", gain[..., place["score"]]))
            if policy in KNOWS and policy != BLIND and BLIND in policies:
                gain = own - table[:, :, c, policies.index(BLIND)]
                found += [
                    mean_row(keys, f"{metric}_minus_blind", gain[..., place[metric]])
                    for metric in ("score", "near_misses")
                ]
    return found


def short_table(rows: Sequence[Row]) -> list[dict[str, Cell]]:
    """A line for each policy and crowd, over all scenarios that were driven in."""
    last = rows[-1]["scenario"]
    shown = [row for row in rows if row["scenario"] == last and row["metric"] in SHOWN]
    return pivoted(shown, ["crowd", "policy"], lambda row: str(row["metric"]), with_interval)
