"""Every figure of the predictors on unseen episodes, and who yields to pedestrians.

Will a driver let the pedestrian go first? An encounter is a driver about to reach an occupied
crossing without a red light. It is scored where the episode's events (`sim.episode.annotate`) say
whether the driver yielded. The behaviours' profiles state how often each yields, so beliefs about
the driver give a chance: the paper's pedestrian figure, as a number.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.data.parallel import in_parallel
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.labels import beliefs
from experiments.score.metrics import auc_over_episodes, bootstrap, ratio, root_ratio
from experiments.score.predictions import (
    EVERY_S,
    HISTORY_S,
    HORIZONS_S,
    MEASURES,
    Errors,
    instants,
    score_episode,
    score_predictions,
)
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.model_files import load_model
from graphrqi.posterior import Posterior
from graphrqi.predict import PREDICTORS, chosen_predictor
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout.driver_table import YIELDS
from graphrqi.predict.rollout.following import certain, shuffled_posterior
from graphrqi.predict.scene.scene import LEARNED_S, Scene, make_scene
from graphrqi.predict.scene.stop_constraints import PROCEED
from graphrqi.stream import DEFAULT_MODEL
from sim.frames import EventKind, FloatArray, Tracks
from sim.road import Road
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

SCENARIOS: Final = ("straight_road", "four_way_intersection")

SEED: Final = 9_172_026
"""Seed of the episodes predicted on: no shipped model was trained on them."""

OURS: Final = "graphrqi-predict"

MAP_FREE: Final = ("constant-velocity", OURS)
"""Predictors that are compared without a map."""

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

BEFORE_S, SEARCHED_EVERY_S = (1.5, 2.5), 0.5
"""An encounter is judged when the crossing is between these times away, s, and searched at this
interval."""

LEAST_SPEED_MPS, SAME_PLACE_M = 2.0, 3.0
"""Slower drivers are left out: they have already decided to stop. An event counts as that of an
encounter if it happens within this of the crossing, m (less than lies between two)."""

_Figures = Mapping[tuple[str, str], Errors]
"""Errors by predictor and beliefs."""

BELIEFS: Final[Mapping[str, Callable[[Tracks, Posterior], Posterior]]] = {
    "classifier": lambda history, posterior: posterior,
    "truth": lambda history, posterior: Posterior(
        history.ids, certain(np.asarray(history.behavior, dtype=np.int64))
    ),
    "shuffled": shuffled_posterior,
    "uniform": lambda history, posterior: Posterior(
        np.empty(0, np.int64), np.empty((0, len(BEHAVIORS)))
    ),
}
"""Beliefs about the drivers present that predictors are given, from the classifier's
posteriors. Episodes are labelled, so the truth is known."""


def measure(
    episodes: int = 10, duration_s: float | None = None, predictors: Sequence[str] = (),
    jobs: int | None = None,
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of each scenario: errors with the road and without it, ratios, and who yields.

    Predictors are keys of ``PREDICTORS``, or "module:function"; () for all. Episodes have a
    scenario's own length, if no ``duration_s`` is given.
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
                    if chosen[0]:
                        keys = {"scenario": scenario, "split": split, "beliefs": kind}
                        rows += score_predictions(chosen, keys)
                rows += compare(results, scenario, split)
            for kind in BELIEFS:
                chance, yielded = np.concatenate([one[kind] for one in chances]).T
                if np.unique(yielded).size > 1:
                    found = auc_over_episodes(chance, yielded == 1.0, np.arange(yielded.size))
                    keys = {"scenario": scenario, "split": "unseen", "beliefs": kind}
                    rows.append(tidy_row(keys, "yield_auc", *found, yielded.size))
            yield rows


def _predicted_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str]
) -> tuple[_Figures, _Figures, dict[str, FloatArray]]:
    """Errors with the road and without it, and chances of yielding, with each kind of beliefs."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    assert road is not None
    scored = sorted(instants(tracks, max(HORIZONS_S), EVERY_S))
    stops = {*scored, *instants(tracks, max(HORIZONS_S), SEARCHED_EVERY_S)}
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
        chances[kind] = yield_chances(tracks, road, posteriors)
    found = score_episode(tracks, {stop: believed[stop] for stop in scored}, None, MAP_FREE)
    return errors, {(name, "classifier"): one for name, one in found.items()}, chances


def compare(episodes: Sequence[_Figures], scenario: str, split: str) -> list[Row]:
    """Ratios of our predictor's figures to others', with intervals over episodes."""
    rows: list[Row] = []
    ours = (OURS, "classifier")
    for metric, name, kind in RATIOS:
        theirs = name, kind
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


def yield_chances(tracks: Tracks, road: Road, posteriors: Mapping[int, Posterior]) -> FloatArray:
    """(m, 2) believed chance of yielding in every first encounter of a driver, and what happened.

    Beliefs about the drivers are given by index of the frame after which they are held. What
    happened is 1 if the driver went on to yield, and 0 if not.
    """
    met, found = set[int](), []
    for stop, posterior in posteriors.items():
        history = tracks.window(stop, round(HISTORY_S / tracks.step_s))
        if not history.ids.size:
            continue
        scene = make_scene(history, road, LEARNED_S)
        for row, left_m in _approaching(scene).items():
            agent = int(history.ids[row])
            if agent in met:
                continue
            met.add(agent)
            yielded = _outcome(tracks, stop - 1, agent, left_m)
            if yielded is not None:
                chance = float(posterior.of(scene.ids[[row]])[0] @ YIELDS)
                found.append((chance, yielded))
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def _approaching(scene: Scene) -> dict[int, float]:
    """The way left, m, of each row whose driver is two seconds before an occupied crossing."""
    graph, paths = scene.graph, scene.paths
    found: dict[int, float] = {}
    soon = scene.stop_state[:, : round(BEFORE_S[1] / STEP_S) + 1]
    shut = (soon != PROCEED).any(axis=1)
    for i in np.flatnonzero(scene.on_path & (scene.speed > LEAST_SPEED_MPS)):
        q = scene.path[i]
        front = scene.s[i] + scene.history.length[i] / 2
        for j, lane in enumerate(paths.lane[q]):
            if lane < 0:
                break
            for z in np.flatnonzero(graph.cross_lane == lane):
                at = paths.start[q, j] + graph.cross_s[z]
                left = float(at - front)
                timely = BEFORE_S[0] <= left / scene.speed[i] <= BEFORE_S[1]
                gates = (paths.stop_row[q] < paths.groups) & (paths.stop_x[q] <= at + 1e-6)
                red = shut[paths.stop_row[q][gates & (paths.stop_x[q] > front)]].any()
                if timely and shut[paths.groups + z] and not red:
                    found.setdefault(int(i), left)
    return found


def _outcome(tracks: Tracks, column: int, agent: int, left_m: float) -> bool | None:
    """Whether a driver went on to yield, by the episode's events; None without one there."""
    kinds = (EventKind.YIELDED, EventKind.NOT_YIELDED)
    events = (
        e for e in tracks.events
        if e.kind in kinds and e.agent == agent and e.time_s > tracks.time_s[column]
    )  # fmt: skip
    first = min(events, key=lambda event: event.time_s, default=None)
    if first is None:
        return None
    until = int(np.searchsorted(tracks.time_s, first.time_s - 1e-6))
    row = int(np.searchsorted(tracks.ids, agent))
    way = np.diff(tracks.xy[row, column : until + 1], axis=0)
    near = abs(np.hypot(*way.T).sum() - left_m) <= SAME_PLACE_M
    return first.kind is EventKind.YIELDED if near else None
