"""Every figure of the predictors on unseen episodes, and how long their rollouts take."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments import yielding
from experiments.generate import GenerateConfig, generate
from experiments.parallel import in_parallel
from experiments.prediction import (
    EVERY_S,
    HORIZONS_S,
    Errors,
    beliefs,
    evaluate,
    instants,
    summarize,
)
from experiments.tables import Row
from experiments.yield_picture import Case, clearest, draw_cases
from experiments.yielding import Asked, ask, score_chances
from graphrqi.methods import load_model
from graphrqi.predict import PREDICTORS
from graphrqi.predict.drivers import default_table
from graphrqi.predict.mixture import mixture_with
from graphrqi.predict.scene import make_scene
from graphrqi.stream import DEFAULT_MODEL
from scenarios import get_scenario
from sim.dataset import open_dataset
from sim.frames import Frame, Tracks
from sim.schema import EpisodeEntry

SCENARIOS: Final = ("straight_road", "four_way_intersection")

SEED: Final = 2_000_003
"""Seed of the episodes predicted on: no shipped model was trained on them."""

EPISODES, QUICK_EPISODES = 10, 2
"""Episodes per scenario."""

QUICK_DURATION_S: Final = 40.0

AGENTS, REPEATS = 100, 40
"""Size of the timed scene, and how often it is rolled out."""


def run_prediction_bench(
    quick: bool = False,
    predictors: Sequence[str] | None = None,
    model: str = DEFAULT_MODEL,
    jobs: int | None = None,
    picture: Path | None = None,
) -> list[Row]:
    """Predict on fresh episodes of both scenarios with a classifier's beliefs.

    Args:
        quick: few short episodes, to see that it works.
        predictors: keys of ``PREDICTORS``; all by default.
        model: the classifier whose beliefs are used.
        jobs: processes; None for one per core.
        picture: where to draw a driver foreseen to yield and one foreseen not to; None: nowhere.

    Returns:
        Flat rows ``scenario predictor horizon_s behavior split metric value low high n``.
    """
    names = list(PREDICTORS if predictors is None else predictors)
    rows: list[Row] = []
    cases: list[Case] = []
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        folder = Path(scratch) / "data"
        config = GenerateConfig(
            scenarios=SCENARIOS,
            episodes=QUICK_EPISODES if quick else EPISODES,
            seed=SEED,
            duration_s=QUICK_DURATION_S if quick else None,
        )
        generate(config, folder, jobs=jobs, quiet=True)
        dataset = open_dataset(folder)
        for scenario in SCENARIOS:
            entries = dataset.episodes(None, scenario)
            arguments = [(folder, entry, names, model) for entry in entries]
            found = list(in_parallel(bench_episode, arguments, jobs))
            rows += summarize([errors for errors, _ in found], scenario, "unseen")
            rows += score_chances([asked for _, asked in found], scenario, "unseen")
            cases += [case for _, asked in found for case in asked.cases]
    if picture is not None and cases:
        draw_cases(clearest(cases), picture)
    return [*rows, rollout_time()]


def bench_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str], model: str
) -> tuple[Mapping[str, Errors], Asked]:
    """Errors and yielding chances of predictors in one episode."""
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    scored = set(instants(tracks, max(HORIZONS_S), EVERY_S))
    stops = scored | set(instants(tracks, max(HORIZONS_S), yielding.EVERY_S))
    posteriors = beliefs(tracks, load_model(model), sorted(stops))
    errors = evaluate(tracks, {s: posteriors[s] for s in sorted(scored)}, road, predictors)
    asked = Asked({}, np.empty(0)) if road is None else ask(tracks, road, posteriors, predictors)
    return errors, asked


def busy_road(agents: int = AGENTS) -> Tracks:
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


def rollout_time(agents: int = AGENTS, repeats: int = REPEATS) -> dict[str, Any]:
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
    return {
        "scenario": "straight_road", "predictor": "behavior-mixture", "horizon_s": 5.0,
        "behavior": "all", "split": "made up", "metric": f"rollout_ms_{agents}_agents_6_modes",
        "value": float(value), "low": float(low), "high": float(high), "n": repeats,
    }  # fmt: skip
