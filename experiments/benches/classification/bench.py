"""The classification bench: which data every protocol learns from and is scored on."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from behaviors.errors import lookup
from experiments.benches.classification.controls import (
    ceiling,
    interpretability,
    leak_probe,
    random_rows,
)
from experiments.benches.classification.noise import FINE_STEP_S, noise_rows
from experiments.benches.classification.protocols import (
    ablation,
    across_datasets,
    across_scenarios,
    inductive,
    shipped,
    transductive,
)
from experiments.benches.classification.recorded import recorded_rows
from experiments.benches.classification.recordings import MAIN_S, OURS, SCORED_S, Recordings
from experiments.benches.classification.robustness import robustness
from experiments.benches.classification.speed import speed_rows
from experiments.benches.classification.worlds import AXES, learn, worlds_rows
from experiments.benches.classification.zero_shot import zero_shot_rows
from experiments.benches.contract import Bench, option
from experiments.benches.real_data import DATA_VARIABLE
from experiments.data.configuration import GenerateConfig
from experiments.data.generate import generate
from experiments.data.worlds.episode import WorldsConfig
from experiments.figure_files import write_figure
from experiments.score.rows import Row
from experiments.training.classifier import TRAINING_LIMITS_MPS
from graphrqi.methods import METHODS, Model
from graphrqi.model_files import load_model
from sim.store.catalogue import is_dataset
from sim.store.dataset import Dataset, open_dataset

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
class Settings:
    """How much data is made, and what is measured on it.

    Attributes:
        data: a dataset to learn from and score on; None makes one. For ``zero-shot`` and
            ``recorded`` a folder of recordings; None for what ``GRAPHRQI_DATA`` names.
        model: a shipped model's name or a folder, which these two score.
        out: where datasets are made, and used again; None for a temporary folder.
        protocols: keys of ``PROTOCOLS``; () for all.
        jobs: processes; None for one per core.
        base: options of `GenerateConfig` for the data that is learned.
        other: the same for data that are only scored.
        engine: the same for drivers of another law and of the other engine, scored and learned.
        fresh: the same for the data on which the shipped model is scored.
        many: the same for the leak probe, whose interval needs episodes; None for the base.
        worlds: options of `WorldsConfig` for worlds that are left out in turn.
        sensed: the same as ``base`` for usual traffic that is seen by worse sensors.
        recordings: most recordings of a place, and most videos; None for all.
        axes: by what worlds are left out; keys of ``AXES``.
        traffic: which of ``TRAFFIC``.
        methods: compared with one another.
        main: measured under every protocol.
        levels: of each disturbance; None for all.
    """

    data: Path | None = option(
        None,
        "A dataset to learn and score on [default: one is made]; zero-shot, recorded: recordings.",
    )
    model: str = option(OURS, "The model that zero-shot and recorded score.")
    out: Path | None = option(
        Path("runs/classification"), "Where datasets are made; those that are there are used."
    )
    protocols: tuple[str, ...] = option((), "Only these [default: all].", "A,B,...")
    jobs: int | None = option(None, "Processes [default: one per core].")
    base: Mapping[str, Any] = field(
        default_factory=lambda: {
            "episodes": 15, "duration_s": 150.0, "limits_mps": TRAINING_LIMITS_MPS,
        }
    )  # fmt: skip
    other: Mapping[str, Any] = field(default_factory=lambda: {"episodes": 12, "duration_s": 150.0})
    engine: Mapping[str, Any] = field(default_factory=lambda: {"episodes": 20, "duration_s": 300.0})
    fresh: Mapping[str, Any] = field(default_factory=lambda: {"episodes": 6, "duration_s": 300.0})
    many: Mapping[str, Any] | None = field(
        default_factory=lambda: {"episodes": 40, "duration_s": 150.0}
    )
    worlds: Mapping[str, Any] = field(default_factory=lambda: {"worlds": 600})
    sensed: Mapping[str, Any] = field(default_factory=lambda: {"episodes": 4, "duration_s": 120.0})
    recordings: int | None = option(
        None,
        "Most recordings of a place, and videos, of recorded and zero-shot [default: all].",
    )
    axes: tuple[str, ...] = tuple(AXES)
    traffic: tuple[str, ...] = tuple(TRAFFIC)
    methods: tuple[str, ...] = (OURS, *(name for name in METHODS if name != OURS))
    main: tuple[str, ...] = (OURS,)
    levels: int | None = None


class Datasets:
    """The datasets, each made when first asked for.

    Args:
        settings: how much is made.
        folder: where datasets are made, and used again.
    """

    def __init__(self, settings: Settings, folder: Path) -> None:
        self.settings, self._folder = settings, folder

    def _made(self, name: str, **options: Any) -> Recordings:
        where, jobs = self._folder / name.replace(" ", "-").replace("/", ""), self.settings.jobs
        generate(GenerateConfig(**{"scenarios": SCENARIOS, **options}), where, jobs, True)
        return Recordings(open_dataset(where), jobs)

    @cached_property
    def base(self) -> Recordings:
        """What is learned, and the unseen episodes beside it."""
        if self.settings.data is not None:
            return Recordings(open_dataset(self.settings.data), self.settings.jobs)
        return self._made("base", **self.settings.base, seed=11)

    @cached_property
    def traffic(self) -> dict[str, Recordings]:
        """What is never trained on, by what differs."""
        return {
            name: self._made(name, **{**self.settings.other, "seed": 12, **TRAFFIC[name]})
            for name in self.settings.traffic
        }

    @cached_property
    def fresh(self) -> Recordings:
        """Usual traffic that nothing was ever trained on."""
        return self._made("fresh", **self.settings.fresh, seed=14)

    @cached_property
    def many(self) -> Recordings:
        """Usual traffic for what looks at nothing of it."""
        if self.settings.data is not None or self.settings.many is None:
            return self.base
        return self._made("many", **self.settings.many, seed=15)

    @cached_property
    def worlds(self) -> Dataset:
        """Random worlds, other ones than any model that ships was trained on."""
        where = self._folder / "worlds"
        generate(WorldsConfig(seed=18, **self.settings.worlds), where, self.settings.jobs, True)
        return open_dataset(where)

    @cached_property
    def sensed(self) -> Recordings:
        """Usual traffic that nothing was ever trained on."""
        return self._made("sensed", **self.settings.sensed, seed=19)

    @cached_property
    def fine(self) -> Recordings:
        """The same drivers in a finer simulation."""
        return self._made("fine", **{**self.settings.sensed, "step_s": FINE_STEP_S}, seed=19)

    @cached_property
    def idm(self) -> Recordings:
        """Drivers in SUMO who follow by the other law."""
        return self._made("idm", **self.settings.engine, engine="sumo-idm", seed=16)

    @cached_property
    def highway(self) -> Recordings:
        """Drivers of the other engine."""
        return self._made("highway", **self.settings.engine, engine="highway", seed=13)

    @cached_property
    def krauss(self) -> Recordings:
        """Drivers of the other engine who follow by SUMO's law."""
        return self._made("krauss", **self.settings.engine, engine="highway-krauss", seed=17)


def _shipped(data: Datasets) -> list[Row]:
    others = {**data.traffic, "highway engine": data.highway}
    parts = [shipped(data.fresh)]
    parts += [shipped(other, (MAIN_S,), name) for name, other in others.items()]
    return [row for rows in parts for row in rows]


def _inductive(data: Datasets) -> list[Row]:
    methods = data.settings.methods
    return [
        *inductive(data.base, methods, SCORED_S),
        *ceiling(data.base),
        *interpretability(data.base),
    ]


def _across_traffic(data: Datasets) -> list[Row]:
    return across_datasets([data.base], data.traffic, data.settings.main, "across-traffic")


def _across_engines(data: Datasets) -> list[Row]:
    sumo, highway = data.base, data.highway
    ways = [
        ("sumo, scored on highway", [sumo], highway),
        ("sumo with both laws, scored on highway", [sumo, data.idm], highway),
        ("highway, scored on sumo", [highway], data.fresh),
        ("highway with both laws, scored on sumo", [highway, data.krauss], data.fresh),
    ]
    return [
        row
        for name, learned, other in ways
        for row in across_datasets(
            learned, {f"trained on {name}": other}, data.settings.main, "across-engines"
        )
    ]


def _worlds(data: Datasets) -> list[Row]:
    settings = data.settings
    home = [data.base.dataset]
    return worlds_rows(home, data.worlds, settings.main, settings.jobs, settings.axes)


def _noise(data: Datasets) -> list[Row]:
    settings = data.settings
    models: dict[str, tuple[str, Model]] = {}
    for method in settings.main:
        models["trained at home"] = method, data.base.fitted(method)[0]
        learned = learn([data.base.dataset], data.worlds, method, settings.jobs)
        models["trained on worlds too"] = method, learned.model()
        if method == OURS:
            models["shipped"] = method, load_model(method)
    return noise_rows(models, data.sensed, data.fine, settings.jobs, settings.levels)


def _recordings(data: Datasets, protocol: str, inner: str) -> Path | None:
    """The folder of recordings, or the one in it that a protocol is about; None without any."""
    given = data.settings.data
    if given is None and os.environ.get(DATA_VARIABLE):
        given = Path(os.environ[DATA_VARIABLE])
    if given is None or is_dataset(given):
        said = f"no --data and no {DATA_VARIABLE}" if given is None else f"a dataset in {given}"
        print(f"{protocol} skipped: found {said}, expected recordings", file=sys.stderr)
        return None
    return given / inner if (given / inner).is_dir() else given


def _zero_shot(data: Datasets) -> list[Row]:
    folder = _recordings(data, "zero-shot", "traf")
    settings = data.settings
    return (
        []
        if folder is None
        else zero_shot_rows(folder, settings.model, settings.jobs, settings.recordings)
    )


def _recorded(data: Datasets) -> list[Row]:
    folder = _recordings(data, "recorded", "real")
    settings = data.settings
    if folder is None:
        return []
    places = recorded_rows(folder, settings.model, settings.jobs, settings.recordings)
    return [row for rows in places for row in rows]


PROTOCOLS: Final[dict[str, Callable[[Datasets], list[Row]]]] = {
    "shipped": _shipped,
    "inductive": _inductive,
    "leak-probe": lambda b: leak_probe(b.many),
    "random-rows": lambda b: random_rows(b.base, [m for m in (OURS, "graphrqi", "majority")
                                                  if m in b.settings.methods]),
    "transductive": lambda b: transductive(b.base, b.settings.methods),
    "ablation": lambda b: ablation(b.base) if OURS in b.settings.methods else [],
    "across-scenarios": lambda b: across_scenarios(b.base, b.settings.main),
    "across-traffic": _across_traffic,
    "across-engines": _across_engines,
    "robustness": lambda b: robustness(b.base, b.settings.main, b.settings.levels),
    "worlds": _worlds,
    "noise": _noise,
    "zero-shot": _zero_shot,
    "recorded": _recorded,
    "speed": lambda b: speed_rows(b.base, b.settings.main),
}  # fmt: skip
"""What is measured, by name."""


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Measure protocol after protocol.

    Yields:
        The rows of each protocol.

    Raises:
        InputError: if there is no such protocol.
    """
    wanted = [lookup(PROTOCOLS, name, "protocol") for name in settings.protocols or PROTOCOLS]
    with tempfile.TemporaryDirectory() as made:
        datasets = Datasets(settings, Path(made) if settings.out is None else settings.out)
        for protocol in wanted:
            yield protocol(datasets)


def plot_classification(rows: Sequence[Row], path: Path) -> None:
    """Draw how confidence and accuracy agree, and what noise costs.

    Args:
        rows: of the bench, with the protocols ``inductive`` and ``robustness``.
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
    write_figure(figure, path)


BENCH: Final = Bench(
    name="classification",
    summary="Score every method under every protocol.",
    keys=("protocol", "scenario", "method", "window_s", "variation"),
    full=Settings(),
    quick=Settings(
        out=None,
        base={"episodes": 5, "duration_s": 40.0},
        other={"episodes": 3, "duration_s": 30.0},
        engine={"episodes": 3, "duration_s": 30.0},
        fresh={"episodes": 1, "duration_s": 30.0},
        many=None,
        worlds={"worlds": 5, "duration_s": 20.0},
        sensed={"episodes": 1, "duration_s": 15.0},
        recordings=1,
        axes=("noise",),
        traffic=("dense flow",),
        methods=("cheung",),
        main=("cheung",),
        levels=1,
    ),
    measure=measure,
    plot=plot_classification,
)
"""At full size nine episodes a scenario to learn from and three to score on: some 50 minutes of CPU
time."""
