"""Trains the models that ship in the package: ``python -m experiments.model`` (or ``make model``).

``--part`` trains one of ``classifier``, ``networks`` (for other traffic) and ``predictors`` alone.
The first two do not need each other; the model is put together once both are there. Predictors need
the model, and are trained on other episodes, since a classifier is too certain about the drivers
that it was trained on. Data and results are kept in ``--work`` and used again by the next run.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import graphrqi.predict
from experiments.console.notices import exit_on_user_error, show_notices
from experiments.demo import BEST_METHOD, SCENARIOS
from experiments.generate import RANDOM_WORLD
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.rows import stamped
from experiments.training.classifier import TRAINING_LIMITS_MPS, train_on
from experiments.training.other_traffic import train_on_worlds
from experiments.training.predictor import calibrate_drivers, train_predictors
from experiments.training.recorded import train_on_recordings
from graphrqi.model_files import FILE, MODELS, load_model, save_model
from graphrqi.networks.portable_torch import leave_onednn_out
from graphrqi.networks.weights import load_weights, save_weights
from graphrqi.places.other_traffic import OtherTraffic
from graphrqi.predict.rollout.driver_table import SHIPPED
from sim.store.dataset import open_dataset

RECORDINGS: Final = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"
"""Folder of open recordings, beside the checkout."""

CLASSIFIER_DATA: Final[dict[str, dict[str, Any]]] = {
    f"classifier-{engine}-{scenario}": {
        "scenarios": (scenario,), "episodes": episodes, "seed": seed, "engine": engine,
        "limits_mps": TRAINING_LIMITS_MPS,
    }
    for engine, seed, counts in (("sumo", 2020, (40, 450)), ("sumo-idm", 2022, (15, 75)))
    for scenario, episodes in zip(SCENARIOS, counts, strict=True)
}  # fmt: skip
PREDICTOR_DATA: Final[dict[str, Any]] = {"scenarios": SCENARIOS, "episodes": 30, "seed": 2021}
"""Datasets by folder, as options of `GenerateConfig`; examples and benchmarks use other seeds. Of
the predictors' episodes, 60 % are for training."""

CLASSIFIER_PER_MOMENT: Final = 2
"""Window lengths drawn for each driver and moment, twice as many as by default."""

NETWORK_DATA: Final[dict[str, dict[str, Any]]] = {
    f"networks-{name}": {"scenarios": SCENARIOS, "seed": 2023, "duration_s": 150.0, **options}
    for name, options in {
        "as-usual": {"episodes": 90, "limits_mps": TRAINING_LIMITS_MPS},
        "light": {"episodes": 20, "flow": "light"},
        "dense": {"episodes": 20, "flow": "dense"},
        "idm": {"episodes": 20, "engine": "sumo-idm", "limits_mps": TRAINING_LIMITS_MPS},
    }.items()
}
NETWORK_WORLDS: Final[dict[str, dict[str, Any]]] = {
    f"networks-worlds-{seed}": {"scenarios": (RANDOM_WORLD,), "episodes": episodes, "seed": seed}
    for seed, episodes in ((7000, 700), (31000, 1500), (52000, 2000))
}
"""Simulated traffic and random worlds that the networks for other traffic learn from."""

WORLDS: Final[dict[str, Any]] = {"scenarios": (RANDOM_WORLD,), "episodes": 60, "seed": 77}
"""Random worlds that the predictor for recordings is trained on."""

ROUNDABOUTS: Final = ((13.0, 1), (20.0, 1), (20.0, 2), (30.0, 2), (45.0, 2))
"""Radius of the ring, m, and lanes of each roundabout (from the smallest that a bus can pass to
those of country roads)."""

FREE_ROADS: Final[dict[str, Any]] = {
    "scenarios": ("motorway", "motorway_ramps"), "episodes": 8, "flow": "light", "seed": 78,
    "limits_mps": (22.22, 50.0, 27.78, 36.11), "duration_s": 60.0,
}  # fmt: skip
RINGS: Final[dict[str, Any]] = {
    "episodes": 2, "engine": "sumo-idm", "seed": 77, "limits_mps": (13.89, 8.33, 11.11, 16.67),
    "duration_s": 60.0,
}  # fmt: skip
"""Options of the episodes of nearly empty motorways, and of each roundabout."""

OPEN_DATA: Final = ("ngsim_us101", "ngsim_lankershim", "ngsim_peachtree", "sind_tianjin")
"""Recordings whose licence lets weights be shipped: NGSIM (US government, open) and SinD (CC0)."""

NETWORKS: Final = "networks.safetensors"
"""File of the trained networks in the working folder, beside the folder of the classifier."""


def _made(work: Path, name: str, jobs: int | None, quiet: bool = False, **options: Any) -> Path:
    """The folder of a dataset in the working folder, made with these options."""
    generate(GenerateConfig(**options), work / name, jobs, quiet)
    return work / name


def _train_classifier(work: Path, jobs: int) -> None:
    """Generate the classifier's data and train it."""
    folders = [_made(work, name, jobs, **options) for name, options in CLASSIFIER_DATA.items()]
    train_on(folders, BEST_METHOD, work / BEST_METHOD, jobs=jobs, per_moment=CLASSIFIER_PER_MOMENT)
    _put_together(work)


def _train_networks(work: Path, jobs: int) -> None:
    """Generate simulated traffic and random worlds, and train the networks for other traffic."""
    simulated, worlds = (
        [open_dataset(_made(work, name, jobs, **options)) for name, options in data.items()]
        for data in (NETWORK_DATA, NETWORK_WORLDS)
    )
    learned, about = train_on_worlds(simulated, worlds, jobs=jobs, quiet=False)
    save_weights(work / NETWORKS, "networks", {"card": about}, learned.arrays())
    _put_together(work)


def _put_together(work: Path) -> None:
    """Write the model that ships, if its classifier and its networks have both been trained."""
    if not ((work / BEST_METHOD / FILE).is_file() and (work / NETWORKS).is_file()):
        return
    model = load_model(work / BEST_METHOD)
    found, arrays = load_weights(work / NETWORKS, "networks")
    about = found["card"]
    card = {
        **model.card,
        "networks": about["networks"],
        "scores": [*model.card["scores"], *stamped(about["scores"], "train", 0)],
    }
    other = OtherTraffic.restored(arrays)
    save_model(dataclasses.replace(model, card=card, other=other), MODELS / BEST_METHOD)


def _train_predictors(work: Path, jobs: int) -> None:
    """Generate the predictors' data, and train them; weights for recordings need the recordings."""
    data = _made(work, "predictor", jobs, **PREDICTOR_DATA)
    weights = Path(graphrqi.predict.__file__).parent / "weights"
    calibrate_drivers(data, SHIPPED)
    train_predictors(data, BEST_METHOD, weights)
    recordings = [RECORDINGS / name for name in OPEN_DATA]
    if not all(path.is_dir() for path in recordings):
        sys.stderr.write(
            f"graphrqi: weights for recordings left as they are: found no recordings "
            f"{', '.join(OPEN_DATA)} in {RECORDINGS}\n"
        )
        return
    train_on_recordings([*recordings, *simulated_like_recordings(work, jobs)], weights)


def simulated_like_recordings(
    work: Path, jobs: int | None = None, quiet: bool = False
) -> list[Path]:
    """Generate the simulated traffic that the predictor for recordings learns from, too."""
    worlds = _made(work, "recorded-worlds", jobs, quiet, **WORLDS)
    return [worlds, *generate_roads(work, jobs, quiet)]


def generate_roads(work: Path, jobs: int | None = None, quiet: bool = False) -> list[Path]:
    """Generate episodes of free motorways and of roundabouts; needs netconvert.

    Random worlds have straight roads, ramps and right-angled junctions. Recordings also cover
    roundabouts, where lanes bend, and nearly empty motorways.
    """
    rings = []
    for radius_m, lanes in ROUNDABOUTS:
        rings.append(work / f"roundabout-{radius_m:g}-{lanes}.toml")
        options = f"lanes = {lanes}\noptions = {{ radius_m = {radius_m} }}\n"
        rings[-1].write_text(f'scenario = "roundabout"\n{options}', encoding="utf-8")
    free = _made(work, "recorded-free", jobs, quiet, **FREE_ROADS)
    names = tuple(map(str, rings))
    return [free, _made(work, "recorded-roundabouts", jobs, quiet, scenarios=names, **RINGS)]


PARTS: Final[dict[str, Callable[[Path, int], None]]] = {
    "classifier": _train_classifier,
    "networks": _train_networks,
    "predictors": _train_predictors,
}
"""Trained parts, in this order."""


def main() -> None:
    """Train the parts that are asked for."""
    parser = argparse.ArgumentParser("python -m experiments.model", description=__doc__)
    parser.add_argument("--part", choices=[*PARTS, "all"], default="all")
    parser.add_argument("--work", type=Path, default=Path("runs/model"), metavar="DIR")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N")
    asked = parser.parse_args()
    leave_onednn_out()
    for name, train in PARTS.items():
        if asked.part in (name, "all"):
            train(asked.work, asked.jobs)


if __name__ == "__main__":
    show_notices()
    with exit_on_user_error():
        main()
