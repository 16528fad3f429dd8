"""Trains the models that ship in the package: ``python -m experiments.model`` (or ``make model``).

The classifier and the predictors are trained on different episodes, since a classifier is too
certain about the drivers that it was trained on. The data are kept in ``runs/model`` and used again
by the next run.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any, Final

import graphrqi.predict
from experiments.console.exit_codes import exit_on_user_error
from experiments.console.notices import show_notices
from experiments.demo import BEST_METHOD, SCENARIOS
from experiments.generate import RANDOM_WORLD
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.training.classifier import TRAINING_LIMITS_MPS, train_on
from experiments.training.other_traffic import train_on_worlds
from experiments.training.predictor import calibrate_drivers, train_predictors
from experiments.training.recorded import train_on_recordings
from experiments.training.roads import generate_roads
from graphrqi.model_files import MODELS, load_model, save_model
from graphrqi.portable_torch import leave_onednn_out
from graphrqi.predict.rollout.driver_table import CARD
from sim.store.dataset import open_dataset

RECORDINGS: Final = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"
"""Folder of open recordings, beside the checkout."""

CLASSIFIER_SEEDS: Final = {"sumo": 2020, "sumo-idm": 2022}
PREDICTOR_SEED: Final = 2021
"""Seeds of the datasets, the classifier's by engine; examples and benchmarks use other seeds."""

CLASSIFIER_EPISODES: Final = {
    "sumo": {"straight_road": 40, "four_way_intersection": 450},
    "sumo-idm": {"straight_road": 15, "four_way_intersection": 75},
}
PREDICTOR_EPISODES: Final = 30
"""Episodes by engine and scenario, of 300 s each, 60 % of them for training. A straight road shows
three times as many drivers in the same time; doubling the episodes of the four-way intersection
still improved macro-F1 by .01, and predictors that learn from 30 episodes err 2 to 4 % less than
those that learn from 20. Drivers with another car-following law raise the accuracy of styles on a
third engine from .84 to .89 at the intersection, and lower macro-F1 on drivers with Krauss's law
by .004 to .009."""

WORLDS, WORLDS_SEED = 60, 77
"""Random worlds that the predictor for recordings is trained on, and their seed."""

CLASSIFIER_PER_MOMENT: Final = 2
"""Window lengths drawn for each driver and moment, twice as many as by default."""


NETWORK_EPISODES: Final[dict[str, dict[str, Any]]] = {
    "as-usual": {"episodes": 90, "limits_mps": TRAINING_LIMITS_MPS},
    "light": {"episodes": 20, "flow": "light"},
    "dense": {"episodes": 20, "flow": "dense"},
    "idm": {"episodes": 20, "engine": "sumo-idm", "limits_mps": TRAINING_LIMITS_MPS},
}
"""Simulated traffic that the networks for other traffic learn from: options of `GenerateConfig`."""

NETWORK_SEED, NETWORK_S = 2023, 150.0
"""Seed of this traffic, and the length of its episodes, s."""

WORLDS_EPISODES: Final = {7000: 700, 31000: 1500, 52000: 2000}
"""Random worlds that the networks for other traffic learn from, by their seed."""

OPEN_DATA: Final = ("ngsim_us101", "ngsim_lankershim", "ngsim_peachtree", "sind_tianjin")
"""Recordings whose licence lets weights be shipped: NGSIM (US government, open) and SinD (CC0)."""


def train_classifier(work: Path, quiet: bool = False, jobs: int | None = None) -> None:
    """Generate the classifier's data and train it.

    Args:
        work: folder for the data.
        quiet: whether to show no progress.
        jobs: processes; None for one per core.
    """
    folders = []
    for engine, scenarios in CLASSIFIER_EPISODES.items():
        for scenario, episodes in scenarios.items():
            folders.append(work / f"classifier-{engine}-{scenario}")
            config = GenerateConfig(
                scenarios=(scenario,),
                episodes=episodes,
                seed=CLASSIFIER_SEEDS[engine],
                engine=engine,
                limits_mps=TRAINING_LIMITS_MPS,
            )
            generate(config, folders[-1], jobs, quiet)
    train_on(
        folders, BEST_METHOD, MODELS / BEST_METHOD, quiet=quiet, jobs=jobs,
        per_moment=CLASSIFIER_PER_MOMENT,
    )  # fmt: skip


def worlds_of(count: int, seed: int) -> GenerateConfig:
    """So many random worlds."""
    return GenerateConfig(scenarios=(RANDOM_WORLD,), episodes=count, seed=seed)


def train_networks(work: Path, quiet: bool = False, jobs: int | None = None) -> None:
    """Generate simulated traffic and random worlds, and train the networks for other traffic.

    Args:
        work: folder for the data.
        quiet: whether to show no progress.
        jobs: processes; None for one per core.
    """
    simulated = []
    for name, options in NETWORK_EPISODES.items():
        simulated.append(work / f"networks-{name}")
        config = GenerateConfig(
            **{"scenarios": SCENARIOS, **options},
            seed=NETWORK_SEED,
            duration_s=NETWORK_S,
        )
        generate(config, simulated[-1], jobs, quiet)
    worlds = []
    for seed, count in WORLDS_EPISODES.items():
        worlds.append(work / f"networks-worlds-{seed}")
        generate(worlds_of(count, seed), worlds[-1], jobs, quiet)
    model = load_model(BEST_METHOD)
    learned = train_on_worlds(
        [open_dataset(folder) for folder in simulated],
        [open_dataset(folder) for folder in worlds],
        jobs=jobs,
        quiet=quiet,
    )
    save_model(dataclasses.replace(model, other=learned), MODELS / BEST_METHOD)


def build_models(work: Path, quiet: bool = False) -> None:
    """Generate the data, train classifier and predictors, and calibrate the driver parameters.

    The predictors are trained last, on beliefs as the whole classifier has them.

    Args:
        work: folder for the data.
        quiet: whether to show no progress.
    """
    train_classifier(work, quiet)
    train_networks(work, quiet)
    data = work / "predictor"
    config = GenerateConfig(scenarios=SCENARIOS, episodes=PREDICTOR_EPISODES, seed=PREDICTOR_SEED)
    generate(config, data, None, quiet)
    weights = Path(graphrqi.predict.__file__).parent / "weights"
    calibrate_drivers(data, weights / CARD, quiet=quiet)
    train_predictors(data, BEST_METHOD, weights, quiet=quiet)
    train_for_recordings(work, weights, quiet)


def train_for_recordings(work: Path, out: Path, quiet: bool = False) -> None:
    """Train the predictor for recordings on random worlds, other roads and open recordings.

    Without the recordings, which are not part of the package, the weights that ship stay.

    Args:
        work: folder for the generated data.
        out: folder of the weights.
        quiet: whether to show no progress.
    """
    recordings = [RECORDINGS / name for name in OPEN_DATA]
    if not all(path.is_dir() for path in recordings):
        sys.stderr.write(
            f"graphrqi: weights for recordings left as they are: found no recordings "
            f"{', '.join(OPEN_DATA)} in {RECORDINGS}\n"
        )
        return
    worlds = work / "recorded-worlds"
    generate(worlds_of(WORLDS, WORLDS_SEED), worlds, None, quiet)
    roads = generate_roads(work, WORLDS_SEED, quiet)
    train_on_recordings([*recordings, worlds, *roads], out, quiet=quiet)


if __name__ == "__main__":
    show_notices()
    leave_onednn_out()
    with exit_on_user_error():
        build_models(Path("runs/model"))
