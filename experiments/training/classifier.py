"""Train a method on datasets' training episodes and save the model with its card."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, get_args

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.notices import LOGGER
from experiments.data.windows import gather
from experiments.score.labels import answer_episodes, scored_answers
from experiments.score.rows import stamped
from experiments.training.other_traffic import train_on_worlds
from graphrqi.methods import METHODS, Model, train
from graphrqi.model_files import check_model_folder, save_model
from graphrqi.samples import WINDOWS_S, NoSamplesError, Samples
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import Split

TRAINING_EVERY_S: Final = 3.0
"""Time between the ends of training windows of one driver."""

TRAINING_PER_MOMENT: Final = 1
"""Window lengths drawn for each driver and moment in training."""

BOTH: Final = "graphrqi-plus"
"""The method whose models have networks for other traffic."""

TRAINING_LIMITS_MPS: Final = (13.89, 13.89, 13.89, 13.89, 8.33, 13.89, 13.89, 13.89, 13.89, 19.44)
"""Speed limits of the training data, episode by episode. A third of the training episodes have
another limit, so that speeds are compared with the local free-flow speed. Episodes for validation
and scoring have the usual limit."""


def train_model(
    datasets: Sequence[Dataset],
    method: str,
    *,
    solver: str = "graphrqi",
    per_moment: int = TRAINING_PER_MOMENT,
    seed: int = 0,
    jobs: int | None = None,
    quiet: bool = True,
) -> Model:
    """Train on training episodes; validation episodes serve early stopping and calibration.

    Args:
        datasets: with train and validation episodes. If only some are random worlds, a model of
            the method ``BOTH`` learns other traffic from the worlds. Any other model learns from
            all of them alike.
        method: a key of ``METHODS``.
        solver: a key of ``SOLVERS``.
        per_moment: window lengths drawn for each driver and moment.
        seed: the same seed and data give the same model.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        The model, with the data and the split in its card.
    """
    chosen = METHODS[method]
    worlds = [d for d in datasets if "worlds" in d.header.configuration]
    home = [d for d in datasets if d not in worlds]
    other, networks = None, dict[str, Any]()
    classes = tuple(dict.fromkeys(one for dataset in datasets for one in dataset.behaviors))
    if chosen.name == BOTH and home and worlds:
        if len(classes) > len(BEHAVIORS):
            raise InputError(
                "train: found random worlds beside behaviours of one's own, expected one of the "
                "two: the networks for other traffic know the six"
            )
        other, networks = train_on_worlds(home, worlds, seed, jobs, quiet)
        datasets = home
    options: dict[str, Any] = {
        "solver": solver,
        "windows_s": WINDOWS_S,
        "every_s": TRAINING_EVERY_S,
        "per_moment": per_moment,
        "seed": seed,
        "jobs": jobs,
        "quiet": quiet,
        "classes": classes,
    }
    training = gather(datasets, "train", chosen.name, **options)
    validation = None
    if any(dataset.episodes("validation") for dataset in datasets):
        with _skipping_empty():
            validation = gather(datasets, "validation", chosen.name, **options)
    model = train(chosen.name, training, validation, solver, seed, classes=classes)
    card = {**_card(datasets, model, training), **networks}
    return dataclasses.replace(model, other=other, card=card)


@contextmanager
def _skipping_empty() -> Iterator[None]:
    """Skip a part of the data that has no samples, and say so."""
    try:
        yield
    except NoSamplesError as reason:
        LOGGER.warning("left out %s", reason)


def _card(datasets: Sequence[Dataset], model: Model, training: Samples) -> dict[str, Any]:
    return {
        "summary": model.method.summary,
        "data": {
            "configurations": [dict(dataset.header.configuration) for dataset in datasets],
            "schema_versions": [dataset.manifest.schema_version for dataset in datasets],
            "episodes": {
                s: sum(len(dataset.episodes(s)) for dataset in datasets) for s in get_args(Split)
            },
        },
        "training_windows": len(training),
        "windows_s": [w if math.isfinite(w) else "life so far" for w in WINDOWS_S],
        "protocol": "test episodes were never trained on; every driver once, by its last answer; "
        "95 % intervals by bootstrap over episodes",
        "scores": [],
    }


def train_on(
    datasets: Sequence[Path],
    method: str,
    out: Path,
    seed: int = 0,
    quiet: bool = False,
    jobs: int | None = None,
    per_moment: int = TRAINING_PER_MOMENT,
) -> Model:
    """Train on dataset folders and save the model (``graphrqi train``).

    Args:
        datasets: folders of datasets.
        method: a key of ``METHODS``.
        out: folder of the model.
        seed: the same seed and data give the same model.
        quiet: whether to show no progress.
        jobs: processes; None for one per core.
        per_moment: window lengths drawn for each driver and moment.

    Returns:
        The trained model; its card has the scores on the test episodes as rows.
    """
    opened = [open_dataset(dataset) for dataset in datasets]
    check_model_folder(out)
    model = train_model(opened, method, per_moment=per_moment, seed=seed, jobs=jobs, quiet=quiet)
    answered = answer_episodes(model, opened, split="test", jobs=jobs, quiet=quiet)
    rows = [*model.card["scores"], *scored_answers(answered, model.method.name, model.classes)]
    scores = stamped(rows, "train", seed)
    model = dataclasses.replace(model, card={**model.card, "scores": scores})
    save_model(model, out)
    return model
