"""Score trained models on unseen episodes, with the majority class beside every accuracy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.metrics import Estimate, confusion, score
from experiments.windows import OBSERVED_S, gather
from graphrqi.methods import Model
from sim.dataset import Dataset
from sim.schema import Split


def scores_on(
    dataset: Dataset,
    model: Model,
    scenario: str,
    majority: int,
    split: Split = "test",
    jobs: int | None = None,
    quiet: bool = True,
) -> tuple[dict[str, Estimate], NDArray[np.float64]]:
    """Scores after 10 s of observation on the episodes of one scenario and split.

    Args:
        dataset: labelled.
        model: a trained model.
        scenario: which scenario.
        majority: the most frequent class of the training data.
        split: which part of the data.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        Scores by name, and the (6, 6) confusion matrix (rows are true classes).
    """
    samples = gather(
        dataset, split, model.method.name, scenario=scenario, solver=model.solver,
        windows_s=(OBSERVED_S,), jobs=jobs, quiet=quiet,
    )  # fmt: skip
    probability = model.posterior(samples.features.astype(np.float64))
    scores = score(samples.codes, probability, samples.episode, majority, split)
    return scores, confusion(samples.codes, probability.argmax(axis=1), samples.episode).sum(axis=0)


def training_majority(dataset: Dataset, jobs: int | None = None) -> int:
    """The most frequent class among the drivers of the training episodes."""
    counts = np.zeros(len(BEHAVIORS), dtype=np.int64)
    for entry in dataset.episodes("train"):
        behavior = dataset.read(entry).tracks.behavior
        if behavior is not None:
            counts += np.bincount(behavior[behavior >= 0], minlength=counts.size)
    if not counts.any():
        raise InputError(f"{dataset.path}: found no labelled driver in training, expected some")
    return int(counts.argmax())
