"""The classification bench: which data every protocol learns from and is scored on."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from behaviors.errors import lookup
from experiments.benches.protocols import (
    MAIN_S,
    OURS,
    SCORED_S,
    Recordings,
    ablation,
    across_datasets,
    across_scenarios,
    ceiling,
    inductive,
    interpretability,
    leak_probe,
    random_rows,
    robustness,
    shipped,
    speed_rows,
    transductive,
)
from experiments.console.tables import Row
from experiments.data.generate import GenerateConfig, generate
from experiments.training.classifier import TRAINING_LIMITS_MPS
from graphrqi.methods import METHODS
from sim.store.dataset import open_dataset

SCENARIOS: Final = ("straight_road", "four_way_intersection")

TRAFFIC: Final[dict[str, dict[str, Any]]] = {
    "as usual": {},
    "light flow": {"flow": "light"},
    "dense flow": {"flow": "dense"},
    "mostly careful": {"mix": {"careful": 0.6, "cautious": 0.2, "impatient": 0.1, "reckless": 0.04,
                               "threatening": 0.03, "timid": 0.03}},
    "limits of 40 and 60 km/h": {"limits_mps": (11.11, 16.67)},
    "other roads": {"scenarios": ("two_way_road", "priority_intersection")},
}  # fmt: skip
"""What is never trained on, as options of `GenerateConfig`, after what to compare it with."""


@dataclass(frozen=True)
class Sizes:
    """How much is made and measured.

    Attributes:
        base: options of `GenerateConfig` for the data that is learned.
        other: the same for what is only scored.
        engine: the same for drivers of another law and of the other engine, scored and learned.
        fresh: the same for what the shipped model is scored on.
        many: the same for the leak probe, whose interval needs episodes; None for the base.
        traffic: which of ``TRAFFIC``.
        methods: compared with one another.
        main: measured under every protocol.
        levels: of each disturbance; None for all.
    """

    base: Mapping[str, Any]
    other: Mapping[str, Any]
    engine: Mapping[str, Any]
    fresh: Mapping[str, Any]
    many: Mapping[str, Any] | None
    traffic: tuple[str, ...]
    methods: tuple[str, ...]
    main: tuple[str, ...]
    levels: int | None = None


FULL: Final = Sizes(
    base={"episodes": 15, "duration_s": 150.0, "limits_mps": TRAINING_LIMITS_MPS},
    other={"episodes": 12, "duration_s": 150.0},
    engine={"episodes": 20, "duration_s": 300.0},
    fresh={"episodes": 6, "duration_s": 300.0},
    many={"episodes": 40, "duration_s": 150.0},
    traffic=tuple(TRAFFIC),
    methods=(OURS, *(name for name in METHODS if name != OURS)),
    main=(OURS,),
)
"""Nine episodes a scenario to learn from and three to score on; some 50 minutes of CPU time."""

QUICK: Final = Sizes(
    base={"episodes": 5, "duration_s": 40.0},
    other={"episodes": 3, "duration_s": 30.0},
    engine={"episodes": 3, "duration_s": 30.0},
    fresh={"episodes": 1, "duration_s": 30.0},
    many=None,
    traffic=("dense flow",),
    methods=("cheung",),
    main=("cheung",),
    levels=1,
)
"""To see that it works."""


class Bench:
    """The datasets, each made when first asked for.

    Args:
        sizes: how much is made and measured.
        dataset: learned from and scored on; None makes one.
        folder: where datasets are made; what is there is used again.
        jobs: processes; None for one per core.
    """

    def __init__(self, sizes: Sizes, dataset: Path | None, folder: Path, jobs: int | None) -> None:
        self.sizes = sizes
        self._dataset, self._folder, self._jobs = dataset, folder, jobs

    def _made(self, name: str, **options: Any) -> Recordings:
        where = self._folder / name.replace(" ", "-").replace("/", "")
        generate(GenerateConfig(**{"scenarios": SCENARIOS, **options}), where, self._jobs, True)
        return Recordings(open_dataset(where), self._jobs)

    @cached_property
    def base(self) -> Recordings:
        """What is learned, and the unseen episodes beside it."""
        if self._dataset is not None:
            return Recordings(open_dataset(self._dataset), self._jobs)
        return self._made("base", **self.sizes.base, seed=11)

    @cached_property
    def traffic(self) -> dict[str, Recordings]:
        """What is never trained on, by what differs."""
        return {
            name: self._made(name, **{**self.sizes.other, "seed": 12, **TRAFFIC[name]})
            for name in self.sizes.traffic
        }

    @cached_property
    def fresh(self) -> Recordings:
        """Usual traffic that nothing was ever trained on."""
        return self._made("fresh", **self.sizes.fresh, seed=14)

    @cached_property
    def many(self) -> Recordings:
        """Usual traffic for what looks at nothing of it."""
        if self._dataset is not None or self.sizes.many is None:
            return self.base
        return self._made("many", **self.sizes.many, seed=15)

    @cached_property
    def idm(self) -> Recordings:
        """Drivers in SUMO who follow by the other law."""
        return self._made("idm", **self.sizes.engine, engine="sumo-idm", seed=16)

    @cached_property
    def highway(self) -> Recordings:
        """Drivers of the other engine."""
        return self._made("highway", **self.sizes.engine, engine="highway", seed=13)

    @cached_property
    def krauss(self) -> Recordings:
        """Drivers of the other engine who follow by SUMO's law."""
        return self._made("krauss", **self.sizes.engine, engine="highway-krauss", seed=17)


def _shipped(bench: Bench) -> list[Row]:
    others = {**bench.traffic, "highway engine": bench.highway}
    parts = [shipped(bench.fresh)]
    parts += [shipped(other, (MAIN_S,), name) for name, other in others.items()]
    return [row for rows in parts for row in rows]


def _inductive(bench: Bench) -> list[Row]:
    methods = bench.sizes.methods
    return [
        *inductive(bench.base, methods, SCORED_S),
        *ceiling(bench.base),
        *interpretability(bench.base),
    ]


def _across_traffic(bench: Bench) -> list[Row]:
    return across_datasets([bench.base], bench.traffic, bench.sizes.main, "across-traffic")


def _across_engines(bench: Bench) -> list[Row]:
    sumo, highway = bench.base, bench.highway
    ways = [
        ("sumo, scored on highway", [sumo], highway),
        ("sumo with both laws, scored on highway", [sumo, bench.idm], highway),
        ("highway, scored on sumo", [highway], bench.fresh),
        ("highway with both laws, scored on sumo", [highway, bench.krauss], bench.fresh),
    ]
    return [
        row
        for name, learned, other in ways
        for row in across_datasets(
            learned, {f"trained on {name}": other}, bench.sizes.main, "across-engines"
        )
    ]


PROTOCOLS: Final[dict[str, Callable[[Bench], list[Row]]]] = {
    "shipped": _shipped,
    "inductive": _inductive,
    "leak-probe": lambda b: leak_probe(b.many),
    "random-rows": lambda b: random_rows(b.base, [m for m in (OURS, "graphrqi", "majority")
                                                  if m in b.sizes.methods]),
    "transductive": lambda b: transductive(b.base, b.sizes.methods),
    "ablation": lambda b: ablation(b.base) if OURS in b.sizes.methods else [],
    "across-scenarios": lambda b: across_scenarios(b.base, b.sizes.main),
    "across-traffic": _across_traffic,
    "across-engines": _across_engines,
    "robustness": lambda b: robustness(b.base, b.sizes.main, b.sizes.levels),
    "speed": lambda b: speed_rows(b.base, b.sizes.main),
}  # fmt: skip
"""What is measured, by name."""


def run_classification_bench(
    quick: bool = False,
    dataset: Path | None = None,
    folder: Path = Path("runs/classification"),
    protocols: Sequence[str] = tuple(PROTOCOLS),
    jobs: int | None = None,
    keep: Callable[[list[Row]], None] | None = None,
) -> list[Row]:
    """What ``graphrqi bench classification`` measures.

    Args:
        quick: few short episodes, one level of each disturbance, one method.
        dataset: learn from and score on this one; None makes one.
        folder: where datasets are made; what is there is used again.
        protocols: keys of ``PROTOCOLS``.
        jobs: processes; None for one per core.
        keep: told all rows measured so far after every protocol.

    Returns:
        Flat rows keyed by protocol, scenario, method, window_s and variation.

    Raises:
        InputError: if there is no such protocol.
    """
    wanted = [lookup(PROTOCOLS, name, "protocol") for name in protocols]
    with tempfile.TemporaryDirectory() as made:
        sizes, where = (QUICK, Path(made)) if quick else (FULL, folder)
        bench = Bench(sizes, dataset, where, jobs)
        rows: list[Row] = []
        for measure in wanted:
            rows += measure(bench)
            if keep is not None:
                keep(rows)
    return rows


def plot_classification(rows: Sequence[Row], path: Path) -> None:
    """Draw how confidence and accuracy agree, and what noise costs.

    Args:
        rows: of `run_classification_bench`, with the protocols ``inductive`` and ``robustness``.
        path: picture to write, its ending says the format.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for scenario in dict.fromkeys(str(row["scenario"]) for row in rows):
        here = [row for row in rows if row["scenario"] == scenario]
        for method in dict.fromkeys(str(r["method"]) for r in here if r["metric"] == "share_right"):
            bins = [r for r in here if r["metric"] == "share_right" and r["method"] == method]
            edges = [str(r["variation"]).removeprefix("confidence ").split(" to ") for r in bins]
            middle = [(float(low) + float(high)) / 2 for low, high in edges]
            left.plot(middle, [r["value"] for r in bins], ".-", label=f"{scenario}, {method}")
        for trained in ("", ", trained with it"):
            levels = [
                (float(words[2]), row["value"])
                for row in here
                if row["metric"] == "macro_f1"
                and (words := str(row["variation"]).split())[:2] == ["position", "noise"]
                and str(row["variation"]).endswith(" m" + trained)
            ]
            if levels:
                right.plot(*zip(*sorted(levels), strict=True), ".-", label=f"{scenario}{trained}")
    left.plot([0, 1], [0, 1], ":", color="grey")
    left.set(xlabel="confidence", ylabel="share of right answers", title="reliability, 10 s")
    right.set(xlabel="position noise, m", ylabel="macro-F1", title="noise, 10 s")
    for axis in (left, right):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize="x-small")
    figure.savefig(path)
