"""Adapt a model to a place, and say what that gained (``graphrqi train --from``)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.guard import guarded_call
from experiments.score.labels import answer_episodes
from experiments.score.rows import Row, tidy_row
from experiments.score.tables import CHANCES
from graphrqi.model_files import check_model_folder, load_model, save_model
from graphrqi.places.adaptation import from_labels
from graphrqi.posterior import AGGRESSIVE, aggressive_share
from sim.formats.common.label_file import DriverLabels, read_driver_labels
from sim.frames import BoolArray, FloatArray
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

LABELLED, SPLITS, LEAST_SCORED = (10, 30, 100), 20, 10
"""Numbers of labelled drivers that are reported, random choices of them that are averaged, and the
fewest drivers beside them on which a number is reported."""


def adapt(
    model: str | Path, recordings: Path, out: Path, labels: Path, quiet: bool = False
) -> list[Row]:
    """Adapt a model to the place of a dataset of recordings, and save it in the folder ``out``.

    Returned are rows on the fit, and accuracy on other labelled drivers before and after.
    """
    trained = dataclasses.replace(load_model(model), adaptation=None)
    check_model_folder(out)
    if len(trained.classes) > len(BEHAVIORS):
        found = ", ".join(trained.classes[len(BEHAVIORS) :])
        raise InputError(
            f"{model}: found a model that knows {found}, expected one of the six behaviours: "
            "graphrqi train on such data makes one for them"
        )
    given = guarded_call(labels, read_driver_labels, labels)
    dataset = open_dataset(recordings)
    answered = answer_episodes(trained, [dataset], traffic="recorded", quiet=quiet)
    drivers = len(answered)
    probability, allowed = _labelled(dataset.episodes(), answered, given)
    given.check()
    if not len(allowed):
        raise InputError(
            f"{labels}: found no label of a driver seen for 1 s, expected at least one"
        )
    adaptation = from_labels(probability, allowed)
    card = {**trained.card, "adapted": {"drivers": drivers, "labelled": len(allowed)}}
    save_model(dataclasses.replace(trained, adaptation=adaptation, card=card), out)
    return [
        tidy_row({}, "drivers", drivers),
        tidy_row({}, "labelled_drivers", len(allowed)),
        *_gains(probability, allowed),
        tidy_row({}, "scale", adaptation.scale),
        *(
            tidy_row({"behavior": str(behavior)}, "offset", float(offset))
            for behavior, offset in zip(BEHAVIORS, adaptation.offset, strict=True)
        ),
    ]


def _labelled(
    entries: Sequence[EpisodeEntry], answered: pd.DataFrame, given: DriverLabels
) -> tuple[FloatArray, BoolArray]:
    """The last answers (n, 6) about labelled drivers, and the behaviours (n, 6) labels allow."""
    answers, allowed = [np.zeros((0, len(BEHAVIORS)))], list[tuple[bool, ...]]()
    for entry in entries:
        own = answered[answered["episode"] == entry.id]
        found = given.of(own["name"].tolist(), entry.name, entry.file, entry.id)
        answers.append(own[CHANCES].to_numpy(np.float64)[[one is not None for one in found]])
        allowed += [one.allowed for one in found if one is not None]
    return np.concatenate(answers), np.array(allowed, dtype=bool)


def _gains(known: FloatArray, allowed: BoolArray) -> list[Row]:
    """Scores of styles of labelled drivers that were left out of a random choice of so many."""
    from sklearn.metrics import balanced_accuracy_score, log_loss, roc_auc_score

    style: BoolArray = np.asarray(allowed[:, AGGRESSIVE].any(axis=1))
    rows: list[Row] = []
    for count in LABELLED:
        scores: dict[tuple[str, str], list[float]] = {}
        for split in range(SPLITS if len(known) >= count + LEAST_SCORED else 0):
            order = np.random.default_rng(split).permutation(len(known))
            learned, left = order[:count], order[count:]
            truth = style[left]
            if len(set(style[learned])) < 2 or len(set(truth)) < 2:
                continue
            adapted = from_labels(known[learned], allowed[learned]).applied(known[left])
            for name, answer in (("as it was", known[left]), ("adapted", adapted)):
                share = aggressive_share(answer)
                for metric, value in (
                    ("style_balanced_accuracy", balanced_accuracy_score(truth, share > 0.5)),
                    ("style_auc", roc_auc_score(truth, share)),
                    ("style_log_loss", log_loss(truth, share.clip(1e-6, 1.0 - 1e-6))),
                ):
                    scores.setdefault((name, metric), []).append(float(value))
        rows += [
            tidy_row(
                {"labelled": count, "model": name}, metric, float(np.mean(values)), n=len(values)
            )
            for (name, metric), values in scores.items()
        ]  # fmt: skip
    return rows
