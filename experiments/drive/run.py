"""Drives every policy in every scenario among every crowd, seed by seed, and counts the figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import rankdata

from behaviors.errors import InputError, lookup
from behaviors.labels import read_behaviors, tables_of
from experiments.data.parallel import in_parallel
from experiments.drive.episode import CROWDS, HOMOGENEOUS, METRICS, MIXED, ROADS, crowd_of, drive
from experiments.drive.policies import BLIND, PLANNERS, POLICIES, get_policy
from experiments.score.metrics import LEAST_EPISODES, RESAMPLES, RESAMPLING_SEED
from experiments.score.rows import Cell, Row, tidy_row
from scenarios.demand import parse_mix
from sim.frames import FloatArray

STRAYS: Final = ("roundabout", "city")
"""Scenarios in which our planners leave their route: they do not know which exit is theirs."""


@dataclass(frozen=True, slots=True)
class LicenceTest:
    """A test: policies, scenarios, crowds and the number of episodes.

    Attributes:
        policies: names, or "module:function" of one's own.
        scenarios: keys of `ROADS`; those of `STRAYS` are not for our planners.
        crowds: as `crowd_of` takes them.
        episodes: of each policy in each scenario and crowd.
        seed: of the first episode; the planner was tuned on other ones.
        flow: of the traffic.
        duration_s: longest time that an episode takes, s.
        warmup_s: how long the traffic drives before, s.
        behaviors: behaviours of one's own that crowds name, as `read_behaviors` takes them.
    """

    policies: tuple[str, ...] = tuple(POLICIES)
    scenarios: tuple[str, ...] = tuple(name for name in ROADS if name not in STRAYS)
    crowds: tuple[str, ...] = tuple(CROWDS)
    episodes: int = 20
    seed: int = 700_000
    flow: str = "medium"
    duration_s: float = 60.0
    warmup_s: float = 20.0
    behaviors: str | None = None


QUICK = LicenceTest(
    scenarios=("straight_road", "right_before_left"), crowds=(MIXED, HOMOGENEOUS), episodes=2,
    duration_s=20.0, warmup_s=10.0,
)  # fmt: skip
"""A test of some minutes, which shows what there is to see."""


def run_test(test: LicenceTest, jobs: int | None, quiet: bool) -> Iterator[list[Row]]:
    """Drive everything.

    Yields:
        The rows of each scenario; then those over all of them ("all"), if there are several.
    """
    for name in test.scenarios:
        lookup(ROADS, name, "scenario")
    own = read_behaviors(test.behaviors)
    for name in test.crowds:
        parse_mix(crowd_of(name, own).mix, own)
    strayed = sorted({*test.scenarios} & {*STRAYS})
    for name in test.policies:
        get_policy(name)
        if name in PLANNERS and strayed:
            expected = "another scenario or policy: planners leave their route there"
            raise InputError(f"scenario: found {strayed[0]} for {name}, expected {expected}")
    if test.episodes < 1:
        raise InputError(f"episodes: found {test.episodes}, expected at least 1")
    config = {"flow": test.flow, "duration_s": test.duration_s, "warmup_s": test.warmup_s}
    config |= {"behaviors": tables_of(own)} if own else {}
    shape = (1, test.episodes, len(test.crowds), len(test.policies), len(METRICS))
    tables = []
    for scenario in test.scenarios:
        arguments = [
            (scenario, crowd, policy, seed, config)
            for seed in range(test.seed, test.seed + test.episodes)
            for crowd in test.crowds
            for policy in test.policies
        ]
        found = list(in_parallel(drive, arguments, jobs, f"driving in {scenario}: episodes", quiet))
        tables.append(np.array([[one[m] for m in METRICS] for one in found]).reshape(shape))
        yield figure_rows(scenario, test.crowds, test.policies, tables[-1])
    if len(tables) > 1:
        yield figure_rows("all", test.crowds, test.policies, np.concatenate(tables))


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
    scores, near = (table[..., METRICS.index(metric)] for metric in ("score", "near_misses"))
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
            if policy in PLANNERS and policy != BLIND and BLIND in policies:
                blind = policies.index(BLIND)
                for metric, of in (("score", scores), ("near_misses", near)):
                    gain = of[:, :, c, p] - of[:, :, c, blind]
                    found.append(mean_row(keys, f"{metric}_minus_blind", gain))
    return found


SHOWN = ("score", "rank", "collisions_caused", "near_misses", "rules_broken", "progress")
"""The figures of the table for people; the rows have all of them."""


def short_table(rows: Sequence[Row]) -> list[Row]:
    """A line for each policy and crowd, over all scenarios that were driven in."""
    last = rows[-1]["scenario"]
    lines: dict[tuple[Cell, Cell], dict[str, Cell]] = {}
    for row in rows:
        if row["scenario"] == last and row["metric"] in SHOWN:
            keys = (row["crowd"], row["policy"])
            line = lines.setdefault(keys, {"crowd": keys[0], "policy": keys[1]})
            line[str(row["metric"])] = row["value"]
            if row["metric"] == "score" and row["low"] is not None:
                line["low"], line["high"] = row["low"], row["high"]
    return list(lines.values())
