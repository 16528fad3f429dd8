"""Score trained models on unseen episodes, with the majority class beside every accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.data.windows import gather, places_of
from experiments.scoring.metrics import Estimate, confusion, score
from graphrqi.methods import Model
from graphrqi.samples import Samples
from sim.store.dataset import Dataset


@dataclass(frozen=True, slots=True)
class Scored:
    """How a model does on one scenario.

    Attributes:
        scores: by metric, as `experiments.scoring.metrics.score` names them.
        confusion: (6, 6) counts; rows are true classes.
    """

    scores: dict[str, Estimate]
    confusion: NDArray[np.int64]


def score_model(
    datasets: Sequence[Dataset],
    model: Model,
    majority: int,
    jobs: int | None = None,
    quiet: bool = True,
) -> dict[str, Scored]:
    """Scores after 10 s of observation on the test episodes.

    Args:
        datasets: labelled.
        model: a trained model.
        majority: the most frequent class of the training data.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        Scores by scenario, where the data are of several engines by scenario and engine.

    Raises:
        InputError: if the split is empty.
    """
    samples = gather(
        datasets,
        "test",
        model.method.name,
        solver=model.solver,
        jobs=jobs,
        quiet=quiet,
    )
    place = np.array(places_of(datasets))[samples.episode]
    found = {}
    for name in dict.fromkeys(places_of(datasets)):
        here = samples.where(place == name)
        if not len(here):
            continue
        probability = model.posterior(here.features.astype(np.float64))
        counts = confusion(here.codes, probability.argmax(axis=1), here.episode).sum(axis=0)
        found[name] = Scored(
            score(here.codes, probability, here.episode, majority, "test"), counts.astype(np.int64)
        )
    return found


def majority_of(samples: Samples) -> int:
    """The most frequent class among samples (of the training episodes, to be a fair rival)."""
    return int(np.bincount(samples.codes, minlength=len(BEHAVIORS)).argmax())
