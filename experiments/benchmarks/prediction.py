"""Every figure of the predictors on unseen episodes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from experiments.benchmarks import yielding
from experiments.benchmarks.statistics import prediction_keys
from experiments.benchmarks.yielding import (
    NO_ENCOUNTERS,
    EncounterChances,
    encounter_chances,
    score_chances,
)
from experiments.data.parallel import in_parallel
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.metrics import Statistic, bootstrap, ratio
from experiments.score.predictions import (
    EVERY_S,
    HORIZONS_S,
    MEASURES,
    Errors,
    beliefs,
    instants,
    root_ratio,
    score_episode,
    score_predictions,
)
from experiments.score.rows import Row, tidy_row
from graphrqi.model_files import load_model
from graphrqi.predict import PREDICTORS, chosen_predictor
from graphrqi.stream import DEFAULT_MODEL
from sim.frames import FloatArray
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

SCENARIOS: Final = ("straight_road", "four_way_intersection")

SEED: Final = 9_172_026
"""Seed of the episodes predicted on: no shipped model was trained on them."""

MAP_FREE: Final = ("constant-velocity", "graphrqi-predict")
"""What is compared without a map, where all predictors but the first are the same."""

QUICK: Final = (
    "constant-velocity", "car-following", "lstm", "graphrqi-predict-unlabelled", "graphrqi-predict",
    "graphrqi-predict-oracle",
)  # fmt: skip
"""Predictors of a small run: one of each kind, and those whose ratios are given."""

RATIOS: Final = (
    ("graphrqi-predict", "ade_m", "constant-velocity"),
    ("graphrqi-predict", "ade_m", "car-following-blind"),
    ("graphrqi-predict", "ade_m", "lstm"),
    ("graphrqi-predict", "ade_m", "graphrqi-predict-unlabelled"),
    ("graphrqi-predict", "rmse_m", "constant-velocity"),
    ("graphrqi-predict", "collisions", "constant-velocity"),
    ("graphrqi-predict-shuffled", "ade_m", "graphrqi-predict-unlabelled"),
    ("shuffled", "ade_m", "car-following-blind"),
)
"""Predictor, metric, and the predictor by whose figure it is divided, at the longest horizon."""

GAINS: Final = (
    ("graphrqi-predict-unlabelled", "graphrqi-predict", "graphrqi-predict-oracle"),
    ("car-following-blind", "car-following", "oracle"),
)
"""Predictors given no labels, the classifier's labels and the true ones: ``label_gain_share`` is
the share of the true labels' gain that the classifier's labels reach."""


@dataclass(frozen=True)
class EpisodeResult:
    """What one episode contributes.

    Attributes:
        errors: of predictors that are given the road.
        map_free: of predictors without it.
        chances: what was said about who yields.
    """

    errors: Mapping[str, Errors]
    map_free: Mapping[str, Errors]
    chances: EncounterChances


def measure(
    episodes: int = 10,
    duration_s: float | None = None,
    predictors: Sequence[str] = (),
    model: str = DEFAULT_MODEL,
    jobs: int | None = None,
) -> Iterator[list[Row]]:
    """Predict on fresh episodes of both scenarios with a classifier's beliefs.

    Args:
        episodes: per scenario.
        duration_s: of each, s; None for the scenario's own.
        predictors: keys of ``PREDICTORS``, or "module:function"; () for all.
        model: the classifier whose beliefs are used.
        jobs: processes; None for one per core.

    Yields:
        The rows of each scenario: errors with the road and without it; ratios; and who yields.
    """
    names = list(predictors or PREDICTORS)
    for name in names:
        chosen_predictor(name)
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        folder = Path(scratch) / "data"
        config = GenerateConfig(
            scenarios=SCENARIOS, episodes=episodes, seed=SEED, duration_s=duration_s
        )
        generate(config, folder, jobs=jobs, quiet=True)
        dataset = open_dataset(folder)
        for scenario in SCENARIOS:
            arguments = [(folder, e, names, model) for e in dataset.episodes(None, scenario)]
            found = list(in_parallel(predicted_episode, arguments, jobs))
            rows: list[Row] = []
            for split, results in (
                ("unseen", [one.errors for one in found]),
                ("unseen, no map", [one.map_free for one in found]),
            ):
                rows += score_predictions(results, {"scenario": scenario, "split": split})
                rows += compare(results, scenario, split)
            yield rows + score_chances([one.chances for one in found], scenario, "unseen")


def predicted_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str], model: str
) -> EpisodeResult:
    """Errors and yielding chances of predictors in one episode."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    scored = sorted(instants(tracks, max(HORIZONS_S), EVERY_S))
    stops = {*scored, *instants(tracks, max(HORIZONS_S), yielding.EVERY_S)}
    posteriors = beliefs(tracks, load_model(model), sorted(stops))
    moments = {stop: posteriors[stop] for stop in scored}
    return EpisodeResult(
        errors=score_episode(tracks, moments, road, predictors),
        map_free=score_episode(tracks, moments, None, MAP_FREE),
        chances=NO_ENCOUNTERS
        if road is None
        else encounter_chances(tracks, road, posteriors, predictors),
    )


def compare(episodes: Sequence[Mapping[str, Errors]], scenario: str, split: str) -> list[Row]:
    """Ratios of predictors' figures, with intervals over episodes."""
    rows: list[Row] = []

    def total(name: str, metric: str) -> FloatArray:
        return np.array([e[name].total[0, -1, MEASURES.index(metric)] for e in episodes])

    def add(name: str, metric: str, statistic: Statistic, sums: list[FloatArray]) -> None:
        found = bootstrap(statistic, np.stack(sums, axis=1))
        if not np.isfinite(found[0]):
            return
        count = int(sum(e[name].count[0] for e in episodes))
        keys = prediction_keys(scenario, name, max(HORIZONS_S), split)
        rows.append(tidy_row(keys, metric, *found, count))

    there = set(episodes[0]) if episodes else set()
    for name, metric, other in RATIOS:
        if {name, other} <= there:
            statistic = root_ratio if metric == "rmse_m" else ratio
            sums = [total(name, metric), total(other, metric)]
            add(name, f"{metric}_over_{other}", statistic, sums)
    for blind, classified, truth in GAINS:
        if {blind, classified, truth} <= there:
            sums = [total(n, "ade_m") for n in (blind, classified, truth)]
            add(classified, "label_gain_share", _gain_share, sums)
    return rows


def _gain_share(sums: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((sums[..., 0] - sums[..., 1]) / (sums[..., 0] - sums[..., 2]))
