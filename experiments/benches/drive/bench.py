"""The licence test: a policy drives in every scenario among crowds of every kind.

Each episode is driven once by every policy among the same departures, so that policies and crowds
are compared seed by seed. The figures of each episode can be kept in a folder. The same command
then goes on where it was stopped, and a policy that is added later is compared with those that are
there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from behaviors.errors import lookup
from experiments.benches.contract import Bench, option
from experiments.benches.drive.crowds import CROWDS, HOMOGENEOUS, MIXED
from experiments.benches.drive.episode import METRICS, ROADS, drive
from experiments.benches.drive.policies import POLICIES, get_policy
from experiments.benches.drive.ranking import mean_row, ranking_rows
from experiments.data.parallel import in_parallel
from experiments.score.rows import Cell, Row, tidy_row
from sim.frames import FloatArray


@dataclass(frozen=True, slots=True)
class Settings:
    """Who is tested where, among whom and how often.

    Attributes:
        policy: policies beside or instead of ours: names, "planner", or "module:function".
        alone: whether only those are driven, not ours too.
        scenarios: keys of `ROADS`.
        crowds: keys of `CROWDS`.
        seeds: episodes of each policy in each scenario and crowd.
        first_seed: seed of the first episode; the planner was tuned on other ones.
        flow: of the traffic.
        duration_s: longest time that an episode takes, s.
        warmup_s: how long the traffic drives before, s.
        jobs: processes; None for one per core.
        out: folder that keeps every episode's figures; "" for none.
    """

    policy: tuple[str, ...] = option((), "Names, planner, or module:function of your own.")
    alone: bool = option(False, "Drive only these policies, not ours beside them.")
    scenarios: tuple[str, ...] = option(tuple(ROADS), "Where.")
    crowds: tuple[str, ...] = option(tuple(CROWDS), "Among whom.")
    seeds: int = option(20, "Episodes of each policy in each scenario and crowd.")
    first_seed: int = option(700_000, "Seed of the first episode.")
    flow: str = option("medium", "light, medium, dense or vehicles per hour.")
    duration_s: float = option(60.0, "Longest time that an episode takes, s.")
    warmup_s: float = option(20.0, "How long the traffic drives before, s.")
    jobs: int | None = option(None, "Processes [default: one per core].")
    out: str = option("", "Folder that keeps every episode's figures, to go on from.", "FOLDER")

    @property
    def policies(self) -> tuple[str, ...]:
        """Every policy once: ours, then the given ones."""
        ours = () if self.alone and self.policy else tuple(POLICIES)
        return tuple(dict.fromkeys([*ours, *self.policy]))


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Drive everything.

    Yields:
        Rows of each scenario: means per episode of the `METRICS` for every crowd and policy; then
        those over all scenarios, `experiments.benches.drive.ranking.ranking_rows`, and, unless
        all figures were kept from before, what driving took: ``driven_minutes`` of all policies,
        ``core_s_per_minute``, and what that makes ``minutes_per_hour_on_two_cores``.

    Raises:
        InputError: if a scenario, crowd or policy is not known.
    """
    for name in settings.scenarios:
        lookup(ROADS, name, "scenario")
    for name in settings.crowds:
        lookup(CROWDS, name, "crowd")
    policies = settings.policies
    for name in policies:
        get_policy(name)
    config = {
        "flow": settings.flow, "duration_s": settings.duration_s, "warmup_s": settings.warmup_s,
    }  # fmt: skip
    seeds = range(settings.first_seed, settings.first_seed + settings.seeds)
    shape = (settings.seeds, len(settings.crowds), len(policies), len(METRICS))
    tables: list[FloatArray] = []
    minutes = core_s = 0.0
    for scenario in settings.scenarios:
        arguments = [
            (scenario, crowd, policies, seed, config, settings.out or None)
            for seed in seeds for crowd in settings.crowds
        ]  # fmt: skip
        found = list(in_parallel(drive, arguments, settings.jobs))
        minutes += sum(cell.minutes for cell in found)
        core_s += sum(cell.core_s for cell in found)
        figures = [[one[m] for m in METRICS] for cell in found for one in cell.figures]
        table = np.array(figures).reshape(shape)
        tables.append(table)
        yield _rows(scenario, settings.crowds, policies, table)
    everything = np.concatenate(tables)
    score = METRICS.index("score")
    scores = {
        crowd: everything[:, c, :, score].T for c, crowd in enumerate(settings.crowds)
    }  # fmt: skip
    yield [
        *_rows("all", settings.crowds, policies, everything, len(tables)),
        *ranking_rows(scores, policies, HOMOGENEOUS, MIXED, len(tables)),
        *_speed_rows(minutes, core_s),
    ]


def _speed_rows(minutes: float, core_s: float) -> list[Row]:
    """What driving so many minutes took; nothing where none were driven."""
    if minutes == 0.0:
        return []
    each_s = core_s / minutes
    speeds = {
        "driven_minutes": minutes,
        "core_s_per_minute": each_s,
        "minutes_per_hour_on_two_cores": 2 * 3600.0 / each_s,
    }
    keys: dict[str, Cell] = {"scenario": "all", "crowd": "all", "policy": "all"}
    return [tidy_row(keys, metric, value, None, None, 1) for metric, value in speeds.items()]


def _rows(
    scenario: str,
    crowds: Sequence[str],
    policies: Sequence[str],
    table: FloatArray,
    scenarios: int = 1,
) -> list[Row]:
    """Rows of (episodes, crowds, policies, metrics) figures, with intervals over seeds."""
    rows: list[Row] = []
    for c, crowd in enumerate(crowds):
        for p, policy in enumerate(policies):
            keys: dict[str, Cell] = {"scenario": scenario, "crowd": crowd, "policy": policy}
            for m, metric in enumerate(METRICS):
                values = table[:, c, p, m]
                if metric == "minutes":
                    total = float(values.sum())
                    rows.append(tidy_row(keys, metric, total, None, None, values.size))
                else:
                    rows.append(mean_row(keys, metric, values, scenarios))
    return rows


def lay_out(rows: Sequence[Any]) -> list[Row]:
    """The figures over all scenarios: a line for each policy and crowd."""
    lines: dict[tuple[Cell, Cell], dict[str, Cell]] = {}
    for row in rows:
        if row["scenario"] == "all":
            keys = (row["policy"], row["crowd"])
            line = lines.setdefault(keys, {"policy": keys[0], "crowd": keys[1]})
            line[str(row["metric"])] = row["value"]
    return [lines[keys] for keys in sorted(lines, key=str)]


BENCH: Final = Bench(
    name="drive",
    summary="Test how policies drive in every scenario among crowds of every kind.",
    keys=("scenario", "crowd", "policy"),
    full=Settings(),
    quick=Settings(
        scenarios=("straight_road", "right_before_left"), crowds=(MIXED, HOMOGENEOUS), seeds=1,
        duration_s=3.0, warmup_s=3.0, jobs=1,
    ),
    measure=measure,
    table=lay_out,
)  # fmt: skip
