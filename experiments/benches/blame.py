"""How often blame by counterfactual and blame by rule agree.

Episodes are driven, and for each collision and near miss every driver near is made careful in a
branch (`experiments.what_if.blame`). Beside it stands the agent that the rules of
`sim.episode.incidents` name as the cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import numpy as np

from behaviors.errors import lookup
from experiments.benches.contract import Bench, option
from experiments.data.parallel import in_parallel
from experiments.score.metrics import bootstrap, ratio
from experiments.score.rows import Row, tidy_row
from experiments.what_if.blame import NEAREST, Agreement, agreements, judge
from scenarios import get_scenario
from sim.frames import EventKind
from sim.scenario import sample_agents

KINDS: Final = (EventKind.COLLISION, EventKind.NEAR_MISS)


@dataclass(frozen=True, slots=True)
class Settings:
    """Which episodes are judged.

    Attributes:
        scenarios: registered names.
        seeds: episodes of each.
        first_seed: seed of the first episode.
        flow: of the traffic.
        mix: shares of behaviours or styles; None for equal ones.
        kinds: which incidents are judged.
        duration_s: length of an episode, s.
        bystanders: drivers beside the two parties who are tried for each incident.
        jobs: processes; None for one per core.
    """

    scenarios: tuple[str, ...] = option(
        ("straight_road", "two_way_road", "four_way_intersection", "all_way_stop"),
        "Registered names.",
    )
    seeds: int = option(10, "Episodes of each.")
    first_seed: int = option(900_000, "Seed of the first episode.")
    flow: str = option("dense", "light, medium, dense or vehicles per hour.")
    mix: str | None = option(None, "Shares of behaviours or styles [default: equal].", "MIX")
    kinds: tuple[str, ...] = option(
        tuple(kind.value for kind in KINDS), "Which incidents are judged."
    )
    duration_s: float = option(120.0, "Length of an episode, s.")
    bystanders: int = option(NEAREST, "Drivers beside the parties who are tried.")
    jobs: int | None = option(None, "Processes [default: one per core].")


def judged(
    scenario: str, options: Mapping[str, Any], seed: int, bystanders: int, kinds: Sequence[str]
) -> list[Agreement]:
    """What the counterfactuals say of each incident of one episode."""
    made = get_scenario(scenario)(**options)
    wanted = [EventKind(kind) for kind in kinds]
    agents = sample_agents(made, seed)
    return agreements(list(judge(made, agents, seed, bystanders=bystanders, kinds=wanted)))


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Judge the incidents of every scenario.

    Yields:
        Rows of each scenario and kind of incident: how many ``incidents``; the share that a single
        careful driver prevents (``preventable``), that the one blamed by rule prevents
        (``by_blamed``), the other party (``by_other``), a bystander (``by_bystander``); of those
        that exactly one party prevents, the share in which it is the one blamed by rule
        (``agreement``); and how often drawing a driver anew prevents it by luck (``luck``).
    """
    for kind in settings.kinds:
        lookup({known.value: known for known in KINDS}, kind, "incident")
    options = {"flow": settings.flow, "mix": settings.mix, "duration_s": settings.duration_s}
    for scenario in settings.scenarios:
        arguments = [
            (scenario, options, seed, settings.bystanders, settings.kinds)
            for seed in range(settings.first_seed, settings.first_seed + settings.seeds)
        ]
        episodes = list(in_parallel(judged, arguments, settings.jobs))
        yield [
            row
            for kind in map(EventKind, settings.kinds)
            for row in rows_of(scenario, kind, episodes)
        ]


def rows_of(scenario: str, kind: EventKind, episodes: Sequence[Sequence[Agreement]]) -> list[Row]:
    """Shares over all incidents of a kind, with intervals over episodes."""
    of_kind = [[one for one in episode if one.kind is kind] for episode in episodes]
    keys: dict[str, str | int | float | bool | None] = {"scenario": scenario, "kind": kind.value}
    every = list(chain(*of_kind))
    rows: list[Row] = [tidy_row(keys, "incidents", len(every), None, None, len(every))]
    for metric, field in (
        ("preventable", "preventable"), ("by_blamed", "by_blamed"), ("by_other", "by_other"),
        ("by_bystander", "by_bystander"), ("agreement", "agrees"), ("luck", "lucky"),
    ):  # fmt: skip
        sums = np.array(
            [
                (np.sum(known), len(known))
                for known in (
                    [
                        float(value)
                        for value in (getattr(one, field) for one in episode)
                        if value is not None and value == value
                    ]
                    for episode in of_kind
                )
                if known
            ]
        )
        if sums.size:
            n = int(sums[:, 1].sum())
            rows.append(tidy_row(keys, metric, *bootstrap(ratio, sums), n))
    return rows


BENCH: Final = Bench(
    name="blame",
    summary="Ask whose careful driving would have prevented each collision and near miss.",
    keys=("scenario", "kind"),
    full=Settings(),
    quick=Settings(scenarios=("straight_road",), seeds=1, duration_s=40.0, bystanders=1, jobs=1),
    measure=measure,
)
