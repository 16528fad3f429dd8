"""Every figure of the predictors on unseen episodes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.benchmarks import yielding
from experiments.data.parallel import in_parallel
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.metrics import bootstrap, ratio, root_ratio
from experiments.score.predictions import (
    EVERY_S,
    HORIZONS_S,
    MEASURES,
    Errors,
    beliefs,
    instants,
    score_episode,
    score_predictions,
)
from experiments.score.rows import Cell, Row, tidy_row
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

OURS: Final = "graphrqi-predict"

MAP_FREE: Final = ("constant-velocity", OURS)
"""Predictors that are compared without a map."""

QUICK: Final = ("constant-velocity", "car-following", "lstm", OURS)
"""Predictors of a small run: one of each kind, and those whose ratios are given."""

DEAF: Final = (
    "constant-velocity", "constant-acceleration", "kalman", "car-following-blind", "lstm",
)  # fmt: skip
"""Predictors that no belief changes: they are scored once, beside the classifier's beliefs."""

RATIOS: Final = (
    ("ade_m", "constant-velocity", "classifier"),
    ("ade_m", "car-following-blind", "classifier"),
    ("ade_m", "lstm", "classifier"),
    ("ade_m", OURS, "uniform"),
    ("rmse_m", "constant-velocity", "classifier"),
)
"""Metric, and the predictor and its beliefs by whose figure that of `OURS` is divided, at the
longest horizon."""

_Figures = Mapping[tuple[str, str], Errors]
"""Errors by predictor and beliefs."""


def _true_beliefs(history: Tracks, posterior: Posterior) -> Posterior:
    """Certain beliefs in the true behaviours: what perfect classification would give."""
    if history.behavior is None:
        raise InputError("beliefs: found no true behaviours, expected labelled tracks")
    return Posterior(history.ids, certain(history.behavior.astype(np.int64)))


BELIEFS: Final[Mapping[str, Callable[[Tracks, Posterior], Posterior]]] = {
    "classifier": lambda history, posterior: posterior,
    "truth": _true_beliefs,
    "shuffled": shuffled_posterior,
    "uniform": lambda history, posterior: Posterior(
        np.empty(0, np.int64), np.empty((0, len(BEHAVIORS)))
    ),
}
"""Beliefs about the drivers present that predictors are given, from the classifier's
posteriors."""


def measure(
    episodes: int = 10,
    duration_s: float | None = None,
    predictors: Sequence[str] = (),
    jobs: int | None = None,
) -> Iterator[list[Row]]:
    """Predict on fresh episodes of both scenarios with several beliefs about the drivers.

    Predictors are keys of ``PREDICTORS``, or "module:function"; () for all. An episode is
    ``duration_s`` long; None for the scenario's own length.

    Yields:
        The rows of each scenario: errors with the road and without it; ratios; and how well
        beliefs say who yields.
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
            arguments = [(folder, e, names) for e in dataset.episodes(None, scenario)]
            mapped, map_free, chances = zip(
                *in_parallel(_predicted_episode, arguments, jobs), strict=True
            )
            rows: list[Row] = []
            for split, results in (("unseen", mapped), ("unseen, no map", map_free)):
                for kind in BELIEFS:
                    chosen = [
                        {name: errors for (name, given), errors in one.items() if given == kind}
                        for one in results
                    ]
                    keys = {"scenario": scenario, "split": split, "beliefs": kind}
                    if chosen[0]:
                        rows += score_predictions(chosen, keys)
                rows += compare(results, scenario, split)
            for kind in BELIEFS:
                keys = {"scenario": scenario, "split": "unseen", "beliefs": kind}
                rows += yielding.auc_row([one[kind] for one in chances], keys)
            yield rows


def _predicted_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str]
) -> tuple[_Figures, _Figures, dict[str, FloatArray]]:
    """Errors with the road and without it, and chances of yielding, with each kind of beliefs."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    assert road is not None
    scored = sorted(instants(tracks, max(HORIZONS_S), EVERY_S))
    stops = {*scored, *instants(tracks, max(HORIZONS_S), yielding.EVERY_S)}
    believed = beliefs(tracks, load_model(DEFAULT_MODEL), sorted(stops))
    errors: dict[tuple[str, str], Errors] = {}
    chances: dict[str, FloatArray] = {}
    for kind, make in BELIEFS.items():
        posteriors = {
            stop: make(tracks.window(stop, 1), posterior) for stop, posterior in believed.items()
        }
        moments = {stop: posteriors[stop] for stop in scored}
        names = [name for name in predictors if kind == "classifier" or name not in DEAF]
        found = score_episode(tracks, moments, road, names)
        errors |= {(name, kind): one for name, one in found.items()}
        chances[kind] = yielding.yield_chances(tracks, road, posteriors)
    found = score_episode(tracks, {stop: believed[stop] for stop in scored}, None, MAP_FREE)
    return errors, {(name, "classifier"): one for name, one in found.items()}, chances


def compare(episodes: Sequence[_Figures], scenario: str, split: str) -> list[Row]:
    """Ratios of our predictor's figures to others', with intervals over episodes."""
    rows: list[Row] = []
    ours = (OURS, "classifier")
    for metric, *other in RATIOS:
        theirs = (other[0], other[1])
        if not episodes or not {ours, theirs} <= set(episodes[0]):
            continue
        at = MEASURES.index(metric)
        sums = [[e[which].total[0, -1, at] for which in (ours, theirs)] for e in episodes]
        found = bootstrap(root_ratio if metric == "rmse_m" else ratio, np.array(sums))
        if np.isfinite(found[0]):
            against = f"{theirs[1]}_beliefs" if theirs[0] == OURS else theirs[0]
            keys: dict[str, Cell] = {
                "beliefs": ours[1], "scenario": scenario, "predictor": OURS,
                "horizon_s": max(HORIZONS_S), "behavior": "all", "split": split,
            }  # fmt: skip
            n = int(sum(e[ours].count[0] for e in episodes))
            rows.append(tidy_row(keys, f"{metric}_over_{against}", *found, n))
    return rows
