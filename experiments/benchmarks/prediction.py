"""Every figure of the predictors on unseen episodes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError, lookup
from behaviors.labels import BEHAVIORS
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
from graphrqi.posterior import Posterior
from graphrqi.predict import PREDICTORS, chosen_predictor
from graphrqi.predict.rollout.following import certain, shuffled_posterior
from graphrqi.stream import DEFAULT_MODEL
from sim.frames import FloatArray, Tracks
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

SCENARIOS: Final = ("straight_road", "four_way_intersection")

SEED: Final = 9_172_026
"""Seed of the episodes predicted on: no shipped model was trained on them."""

MAP_FREE: Final = ("constant-velocity", "graphrqi-predict")
"""Predictors that are compared without a map."""

QUICK: Final = ("constant-velocity", "car-following", "lstm", "graphrqi-predict")
"""Predictors of a small run: one of each kind, and those whose ratios are given."""

DEAF: Final = (
    "constant-velocity", "constant-acceleration", "kalman", "car-following-blind", "lstm",
)  # fmt: skip
"""Predictors that no belief changes: they are scored once, beside the classifier's beliefs."""

RATIOS: Final = (
    ("graphrqi-predict", "classifier", "ade_m", "constant-velocity", "classifier"),
    ("graphrqi-predict", "classifier", "ade_m", "car-following-blind", "classifier"),
    ("graphrqi-predict", "classifier", "ade_m", "lstm", "classifier"),
    ("graphrqi-predict", "classifier", "ade_m", "graphrqi-predict", "uniform"),
    ("graphrqi-predict", "classifier", "rmse_m", "constant-velocity", "classifier"),
    ("graphrqi-predict", "classifier", "collisions", "constant-velocity", "classifier"),
    ("graphrqi-predict", "shuffled", "ade_m", "graphrqi-predict", "uniform"),
    ("car-following", "shuffled", "ade_m", "car-following-blind", "classifier"),
)
"""Predictor and its beliefs, metric, and the predictor and beliefs by whose figure it is divided,
at the longest horizon."""

GAINS: Final = (
    ("graphrqi-predict", "graphrqi-predict", "uniform"),
    ("car-following", "car-following-blind", "classifier"),
)
"""Predictors, and what they are compared with: ``label_gain_share`` is the share of the true
labels' gain that the classifier's beliefs reach."""

Figures = Mapping[tuple[str, str], Errors]
"""Errors by predictor and beliefs."""


def true_beliefs(history: Tracks, posterior: Posterior) -> Posterior:
    """Certain beliefs in the true behaviours: what perfect classification would give."""
    if history.behavior is None:
        raise InputError("beliefs: found no true behaviours, expected labelled tracks")
    return Posterior(history.ids, certain(history.behavior.astype(np.int64)))


def no_beliefs(history: Tracks, posterior: Posterior) -> Posterior:
    """Uniform posteriors: every behaviour is equally likely."""
    return Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))


BELIEFS: Final[Mapping[str, Callable[[Tracks, Posterior], Posterior]]] = {
    "classifier": lambda history, posterior: posterior,
    "truth": true_beliefs,
    "shuffled": shuffled_posterior,
    "uniform": no_beliefs,
}
"""Beliefs about the drivers present that predictors are given, from the classifier's
posteriors."""


@dataclass(frozen=True)
class EpisodeResult:
    """Contribution of one episode.

    Attributes:
        errors: of predictors that are given the road.
        map_free: of predictors without it.
        chances: what was said about who yields, by beliefs.
    """

    errors: Figures
    map_free: Figures
    chances: Mapping[str, EncounterChances]


def measure(
    episodes: int = 10,
    duration_s: float | None = None,
    predictors: Sequence[str] = (),
    model: str = DEFAULT_MODEL,
    told: Sequence[str] = (),
    jobs: int | None = None,
) -> Iterator[list[Row]]:
    """Predict on fresh episodes of both scenarios with several beliefs about the drivers.

    Args:
        episodes: per scenario.
        duration_s: of each, s; None for the scenario's own.
        predictors: keys of ``PREDICTORS``, or "module:function"; () for all.
        model: the classifier whose beliefs are used.
        told: names of the beliefs, keys of `BELIEFS`; () for all. The classifier's are always
            among them.
        jobs: processes; None for one per core.

    Yields:
        The rows of each scenario: errors with the road and without it; ratios; and who yields.
    """
    names = list(predictors or PREDICTORS)
    for name in names:
        chosen_predictor(name)
    for kind in told:
        lookup(BELIEFS, kind, "beliefs")
    kinds = [kind for kind in BELIEFS if not told or kind in (*told, "classifier")]
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        folder = Path(scratch) / "data"
        config = GenerateConfig(
            scenarios=SCENARIOS, episodes=episodes, seed=SEED, duration_s=duration_s
        )
        generate(config, folder, jobs=jobs, quiet=True)
        dataset = open_dataset(folder)
        for scenario in SCENARIOS:
            arguments = [(folder, e, names, kinds, model) for e in dataset.episodes(None, scenario)]
            found = list(in_parallel(predicted_episode, arguments, jobs))
            rows: list[Row] = []
            for split, results in (
                ("unseen", [one.errors for one in found]),
                ("unseen, no map", [one.map_free for one in found]),
            ):
                for kind in kinds:
                    chosen = [_with_beliefs(one, kind) for one in results]
                    keys = {"scenario": scenario, "split": split, "beliefs": kind}
                    if chosen[0]:
                        rows += score_predictions(chosen, keys)
                rows += compare(results, scenario, split)
            for kind in kinds:
                said = score_chances([one.chances[kind] for one in found], scenario, "unseen")
                rows += [{"beliefs": kind, **row} for row in said]
            yield rows


def _with_beliefs(figures: Figures, kind: str) -> dict[str, Errors]:
    """Errors by predictor, of those that were given these beliefs."""
    return {name: errors for (name, told), errors in figures.items() if told == kind}


def predicted_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str], kinds: Sequence[str], model: str
) -> EpisodeResult:
    """Errors and yielding chances of predictors in one episode, with each kind of beliefs."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    scored = sorted(instants(tracks, max(HORIZONS_S), EVERY_S))
    stops = {*scored, *instants(tracks, max(HORIZONS_S), yielding.EVERY_S)}
    believed = beliefs(tracks, load_model(model), sorted(stops))
    errors: dict[tuple[str, str], Errors] = {}
    map_free: dict[tuple[str, str], Errors] = {}
    chances: dict[str, EncounterChances] = {}
    for kind in kinds:
        posteriors = {
            stop: BELIEFS[kind](tracks.window(stop, 1), posterior)
            for stop, posterior in believed.items()
        }
        moments = {stop: posteriors[stop] for stop in scored}
        names = [name for name in predictors if kind == "classifier" or name not in DEAF]
        found = score_episode(tracks, moments, road, names)
        errors |= {(name, kind): one for name, one in found.items()}
        chances[kind] = (
            NO_ENCOUNTERS if road is None else encounter_chances(tracks, road, posteriors, names)
        )
        if kind == "classifier":
            found = score_episode(tracks, moments, None, MAP_FREE)
            map_free = {(name, kind): one for name, one in found.items()}
    return EpisodeResult(errors, map_free, chances)


def compare(episodes: Sequence[Figures], scenario: str, split: str) -> list[Row]:
    """Ratios of predictors' figures, with intervals over episodes."""
    rows: list[Row] = []

    def total(which: tuple[str, str], metric: str) -> FloatArray:
        return np.array([e[which].total[0, -1, MEASURES.index(metric)] for e in episodes])

    def add(
        which: tuple[str, str], metric: str, statistic: Statistic, sums: list[FloatArray]
    ) -> None:
        found = bootstrap(statistic, np.stack(sums, axis=1))
        if not np.isfinite(found[0]):
            return
        count = int(sum(e[which].count[0] for e in episodes))
        name, kind = which
        keys = prediction_keys(scenario, name, max(HORIZONS_S), split)
        rows.append(tidy_row({"beliefs": kind, **keys}, metric, *found, count))

    there = set(episodes[0]) if episodes else set()
    for name, kind, metric, other, others in RATIOS:
        if {(name, kind), (other, others)} <= there:
            statistic = root_ratio if metric == "rmse_m" else ratio
            sums = [total((name, kind), metric), total((other, others), metric)]
            against = other if other != name else f"{others}_beliefs"
            add((name, kind), f"{metric}_over_{against}", statistic, sums)
    for name, other, others in GAINS:
        compared = ((other, others), (name, "classifier"), (name, "truth"))
        if set(compared) <= there:
            sums = [total(which, "ade_m") for which in compared]
            add((name, "classifier"), "label_gain_share", _gain_share, sums)
    return rows


def _gain_share(sums: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((sums[..., 0] - sums[..., 1]) / (sums[..., 0] - sums[..., 2]))
