"""Every figure of the predictors on unseen episodes, and how long their rollouts take."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.benches.contract import Bench, option
from experiments.benches.prediction import yielding
from experiments.benches.prediction.yield_picture import YieldCase, clearest, draw_cases
from experiments.benches.prediction.yielding import (
    NO_ENCOUNTERS,
    EncounterChances,
    encounter_chances,
    score_chances,
)
from experiments.benches.statistics import prediction_keys
from experiments.data.configuration import GenerateConfig
from experiments.data.generate import generate
from experiments.data.parallel import in_parallel
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
from graphrqi.predict.rollout.driver_table import default_table
from graphrqi.predict.rollout.mixture import mixture_with
from graphrqi.predict.scene.scene import make_scene
from graphrqi.stream import DEFAULT_MODEL
from scenarios import get_scenario
from sim.frames import FloatArray, Frame, Tracks
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

SCENARIOS: Final = ("straight_road", "four_way_intersection")

SEED: Final = 9_172_026
"""Seed of the episodes predicted on: no shipped model was trained on them."""

MAP_FREE: Final = ("constant-velocity", "graphrqi-predict")
"""What is compared without a map, where all predictors but the first are the same."""

MOST_SHIFT_S: Final = 4.0
"""Each vehicle's clock is shifted by up to this, as in some recordings in circulation, s."""

RATIOS: Final = (
    ("graphrqi-predict", "ade_m", "constant-velocity"),
    ("graphrqi-predict", "ade_m", "car-following-blind"),
    ("graphrqi-predict", "ade_m", "lstm"),
    ("graphrqi-predict", "ade_m", "graphrqi-predict-unlabelled"),
    ("graphrqi-predict", "rmse_m", "constant-velocity"),
    ("graphrqi-predict", "collisions", "constant-velocity"),
    ("graphrqi-predict-shuffled", "ade_m", "graphrqi-predict-unlabelled"),
    ("shuffled", "ade_m", "car-following-blind"),
    ("car-following-wary", "ade_m", "car-following"),
    ("lstm", "ade_m", "mlp"),
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
        shifted: the same, with every vehicle's clock wrong.
        chances: what was said about who yields.
    """

    errors: Mapping[str, Errors]
    map_free: Mapping[str, Errors]
    shifted: Mapping[str, Errors]
    chances: EncounterChances


@dataclass(frozen=True, slots=True)
class Settings:
    """What is predicted, by whom.

    Attributes:
        episodes: per scenario.
        duration_s: of each episode, s; None for the scenario's own.
        predictors: keys of ``PREDICTORS``, or "module:function"; () for all.
        model: the classifier whose beliefs are used.
        agents: vehicles in the scene whose rollout is timed.
        repeats: how often it is rolled out.
        jobs: processes; None for one per core.
        plot: where to draw a driver predicted to yield and one predicted not to; None: nowhere.
    """

    episodes: int = option(10, "Episodes per scenario.")
    duration_s: float | None = option(None, "Length of each [default: the scenario's own].")
    predictors: tuple[str, ...] = option((), "Names or module:function [default: all names].")
    model: str = option(DEFAULT_MODEL, "The classifier whose beliefs are used.")
    agents: int = 100
    repeats: int = 40
    jobs: int | None = option(None, "Processes [default: one per core].")
    plot: Path | None = option(
        None,
        "Draw a driver predicted to let somebody cross, and one not: .pdf, .png or .svg.",
        "FILE",
    )


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Predict on fresh episodes of both scenarios with a classifier's beliefs.

    Yields:
        The rows of each scenario; then how long a rollout takes.
    """
    names = list(settings.predictors or PREDICTORS)
    for name in names:
        chosen_predictor(name)
    cases: list[YieldCase] = []
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        folder = Path(scratch) / "data"
        config = GenerateConfig(
            scenarios=SCENARIOS, episodes=settings.episodes, seed=SEED,
            duration_s=settings.duration_s,
        )  # fmt: skip
        generate(config, folder, jobs=settings.jobs, quiet=True)
        dataset = open_dataset(folder)
        for scenario in SCENARIOS:
            entries = dataset.episodes(None, scenario)
            arguments = [(folder, entry, names, settings.model) for entry in entries]
            found = list(in_parallel(bench_episode, arguments, settings.jobs))
            rows: list[Row] = []
            for split, episodes in (
                ("unseen", [one.errors for one in found]),
                ("unseen, no map", [one.map_free for one in found]),
                ("unseen, no map, clocks shifted", [one.shifted for one in found]),
            ):
                rows += score_predictions(episodes, {"scenario": scenario, "split": split})
                rows += compare(episodes, scenario, split)
            rows += score_chances([one.chances for one in found], scenario, "unseen")
            cases += [case for one in found for case in one.chances.cases]
            yield rows
    if settings.plot is not None and cases:
        draw_cases(clearest(cases), settings.plot)
    yield [rollout_time(settings.agents, settings.repeats)]


def bench_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str], model: str
) -> EpisodeResult:
    """Errors and yielding chances of predictors in one episode."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    scored = sorted(instants(tracks, max(HORIZONS_S), EVERY_S))
    stops = {*scored, *instants(tracks, max(HORIZONS_S), yielding.EVERY_S)}
    posteriors = beliefs(tracks, load_model(model), sorted(stops))
    moments = {stop: posteriors[stop] for stop in scored}
    late = shifted_in_time(tracks, entry.seed)
    return EpisodeResult(
        errors=score_episode(tracks, moments, road, predictors),
        map_free=score_episode(tracks, moments, None, MAP_FREE),
        shifted=score_episode(late, moments, None, MAP_FREE),
        chances=NO_ENCOUNTERS
        if road is None
        else encounter_chances(tracks, road, posteriors, predictors),
    )


def shifted_in_time(tracks: Tracks, seed: int) -> Tracks:
    """The same tracks, each agent's clock off by its own time of up to `MOST_SHIFT_S`."""
    most = round(MOST_SHIFT_S / tracks.step_s)
    rng = np.random.default_rng(seed)
    late = rng.integers(-most, most + 1, tracks.ids.size)
    column = np.arange(tracks.time_s.size)[None] - late[:, None]
    inside = (column >= 0) & (column < tracks.time_s.size)
    row, at = np.arange(tracks.ids.size)[:, None], np.clip(column, 0, tracks.time_s.size - 1)
    return replace(
        tracks,
        xy=tracks.xy[row, at],
        heading=tracks.heading[row, at],
        speed=tracks.speed[row, at],
        valid=tracks.valid[row, at] & inside,
    )


def compare(episodes: Sequence[Mapping[str, Errors]], scenario: str, split: str) -> list[Row]:
    """Ratios of predictors' figures, with intervals over episodes.

    Args:
        episodes: errors by predictor.
        scenario: its name, for the rows.
        split: which part of the data, for the rows.

    Returns:
        Rows whose metric is ``METRIC_over_PREDICTOR``, ``min_ade_m_over_ade_m`` or
        ``label_gain_share``, of those predictors that were run.
    """
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
    for name in sorted(there):
        if name in LEARNED:
            sums = [total(name, "min_ade_m"), total(name, "ade_m")]
            add(name, "min_ade_m_over_ade_m", ratio, sums)
    for blind, classified, truth in GAINS:
        if {blind, classified, truth} <= there:
            sums = [total(n, "ade_m") for n in (blind, classified, truth)]
            add(classified, "label_gain_share", _gain_share, sums)
    return rows


LEARNED: Final = ("graphrqi-predict", "lstm", "mlp")
"""Predictors whose futures are made to cover what may happen."""


def _gain_share(sums: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((sums[..., 0] - sums[..., 1]) / (sums[..., 0] - sums[..., 2]))


def busy_road(agents: int) -> Tracks:
    """A history of that many vehicles on the straight road, a second long."""
    road = get_scenario("straight_road")().road
    rng = np.random.default_rng(0)
    lanes = [i for i, lane in enumerate(road.lanes) if not lane.walking and not lane.internal]
    frames: list[Frame] = []
    speed = rng.uniform(6.0, 14.0, agents)
    place = [
        (lanes[i % len(lanes)], 12.0 + (i // len(lanes)) * 20.0 + rng.uniform(0.0, 5.0))
        for i in range(agents)
    ]
    begin = np.array([road.lanes[lane].centerline[0] for lane, _ in place])
    end = np.array([road.lanes[lane].centerline[-1] for lane, _ in place])
    facing = (end - begin) / np.linalg.norm(end - begin, axis=1, keepdims=True)
    s = np.array([at for _, at in place])
    for step in range(11):
        xy = begin + (s + speed * (step - 10) * 0.1)[:, None] * facing
        frames.append(
            Frame(
                time_s=step * 0.1,
                ids=np.arange(agents),
                xy=xy,
                heading=np.arctan2(facing[:, 1], facing[:, 0]),
                speed=speed,
                length=np.full(agents, 4.6),
                width=np.full(agents, 1.8),
                kind=np.zeros(agents, dtype=np.int8),
            )
        )
    return Tracks.from_frames(frames)


def rollout_time(agents: int, repeats: int) -> Row:
    """Time of the central processor to roll out all modes of a scene for 5 s, leaders included.

    Args:
        agents: vehicles in the scene.
        repeats: how often; the first call, which compiles, is left out.

    Returns:
        One row; value, low and high are the median and the 2.5 and 97.5 % quantiles, ms.
    """
    road = get_scenario("straight_road")().road
    scene = make_scene(busy_road(agents), road)
    belief = np.full((agents, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
    table = default_table()
    mixture_with(scene, belief, table)
    taken_ms = []
    for _ in range(repeats):
        begin = time.process_time()
        mixture_with(scene, belief, table)
        taken_ms.append(1e3 * (time.process_time() - begin))
    low, value, high = np.quantile(taken_ms, [0.025, 0.5, 0.975])
    keys = prediction_keys("straight_road", "behavior-mixture", 5.0, "made up")
    return tidy_row(keys, f"rollout_ms_{agents}_agents_6_modes", value, low, high, repeats)


BENCH: Final = Bench(
    name="prediction",
    summary="Measure every predictor's errors on unseen episodes.",
    keys=("scenario", "predictor", "horizon_s", "behavior", "split"),
    full=Settings(),
    quick=Settings(
        episodes=2,
        duration_s=30.0,
        predictors=(
            "constant-velocity",
            "car-following",
            "mlp",
            "graphrqi-predict-unlabelled",
            "graphrqi-predict",
            "graphrqi-predict-oracle",
        ),
        agents=20,
        repeats=4,
    ),
    measure=measure,
)
