"""Train a method on datasets' training episodes and save the model with its card."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, get_args

from experiments.console.notices import LOGGER
from experiments.data.windows import gather
from experiments.score.labels import answer_episodes, scored_answers
from experiments.score.rows import stamped
from graphrqi.methods import Model, train
from graphrqi.model_files import check_model_folder, save_model
from graphrqi.samples import WINDOWS_S, NoSamplesError
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import Split

TRAINING_EVERY_S, TRAINING_PER_MOMENT = 3.0, 1
"""Time between the ends of training windows of one driver, s, and how many are drawn there."""

TRAINING_LIMITS_MPS: Final = (13.89, 13.89, 13.89, 13.89, 8.33, 13.89, 13.89, 13.89, 13.89, 19.44)
"""Speed limits of the training data, episode by episode. A third of the training episodes have
another limit, so that speeds are compared with the local free-flow speed. Episodes for validation
and scoring have the usual limit."""


def train_model(
    datasets: Sequence[Dataset], method: str, *, per_moment: int = TRAINING_PER_MOMENT,
    seed: int = 0, jobs: int | None = None, quiet: bool = True,
) -> Model:  # fmt: skip
    """Train on training episodes; validation episodes serve early stopping and calibration.

    Args:
        datasets: with train and validation episodes.
        method: a key of ``METHODS``.
        per_moment: window lengths drawn for each driver and moment.
        seed: the same seed and data give the same model.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.
    """
    classes = tuple(dict.fromkeys(one for dataset in datasets for one in dataset.behaviors))
    observe = partial(
        gather, datasets, method=method, windows_s=WINDOWS_S,
        every_s=TRAINING_EVERY_S, per_moment=per_moment, seed=seed, jobs=jobs, quiet=quiet,
        classes=classes,
    )  # fmt: skip
    training, validation = observe("train"), None
    if any(dataset.episodes("validation") for dataset in datasets):
        try:
            validation = observe("validation")
        except NoSamplesError as reason:
            LOGGER.warning("left out %s", reason)
    model = train(method, training, validation, seed=seed, classes=classes)
    card: dict[str, Any] = {
        "summary": model.method.summary,
        "data": {
            "configurations": [dict(dataset.header.configuration) for dataset in datasets],
            "schema_versions": [dataset.manifest.schema_version for dataset in datasets],
            "episodes": {
                split: sum(len(dataset.episodes(split)) for dataset in datasets)
                for split in get_args(Split)
            },
        },
        "training_windows": len(training),
        "windows_s": [w if math.isfinite(w) else "life so far" for w in WINDOWS_S],
        "protocol": "test episodes were never trained on; every driver once, by its last answer; "
        "95 % intervals by bootstrap over episodes",
        "scores": [],
    }
    return dataclasses.replace(model, card=card)


def train_on(
    datasets: Sequence[Path], method: str, out: Path, seed: int = 0, quiet: bool = False,
    jobs: int | None = None, per_moment: int = TRAINING_PER_MOMENT,
) -> Model:  # fmt: skip
    """Train on dataset folders and save the model (``graphrqi train``), as `train_model` does.

    The card of the trained model has the scores on the test episodes as rows.
    """
    opened = [open_dataset(dataset) for dataset in datasets]
    check_model_folder(out)
    model = train_model(opened, method, per_moment=per_moment, seed=seed, jobs=jobs, quiet=quiet)
    answered = answer_episodes(model, opened, split="test", jobs=jobs, quiet=quiet)
    scores = stamped(scored_answers(answered, model.method.name, model.classes), "train", seed)
    model = dataclasses.replace(model, card={**model.card, "scores": scores})
    save_model(model, out)
    return model
