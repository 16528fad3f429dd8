"""Answers of any other model, scored beside ours and the plain rival, on the same drivers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.guard import guarded_call
from experiments.rival import PlainRival, whole_tracks
from experiments.score.answer_file import PROBABILITIES, read_answers
from experiments.score.answers import Answers, score_difference
from experiments.score.labels import ALL, Answered, answer_episodes, scored_answers
from experiments.score.rows import Row
from graphrqi.model_files import load_model
from sim.frames import IntArray
from sim.store.dataset import open_dataset

RIVAL: Final = "plain rival"
"""Name of the random forest on nine numbers of a driver's whole track, `experiments.rival`."""


def compare(
    model: str | Path, source: Path, answers: Path, labels: Path | None = None,
    *, traffic: str | None = None, jobs: int | None = None, quiet: bool = False,
) -> list[Row]:  # fmt: skip
    """Implement ``graphrqi evaluate --answers``: score answers from a file in the test split.

    Drivers without an answer count with the most frequent behaviour of the training drivers, as
    unanswered. The plain rival is trained on the training split, where there is one.

    Args:
        model: a shipped model's name or a folder.
        source: folder of a dataset.
        answers: as `read_answers` takes it.
        labels: as `experiments.score.labels.evaluate` takes it, like all others.
        traffic: where the positions come from.
        jobs: processes.
        quiet: whether to show no progress.

    Returns:
        Rows by ``model`` as from `scored_answers`, then paired differences of the file's answers
        to each other model's, which the key ``against`` names.

    Raises:
        InputError: if the file is broken, or answers about no driver of the test split.
    """
    dataset = open_dataset(source)
    given = guarded_call(answers, read_answers, answers)
    ours = answer_episodes(
        load_model(model), [dataset], split="test", labels=labels, traffic=traffic, jobs=jobs,
        quiet=quiet,
    )  # fmt: skip
    truth = np.concatenate([np.empty(0, np.int64), *(_truth(one) for one in ours)])
    known = truth[truth >= 0]
    if not known.size:
        raise InputError(f"{source}: found no known behaviour in the test split, expected some")
    there = {(one.entry.id, agent) for one in ours for agent in one.table["agent"].to_pylist()}
    if there.isdisjoint(given.index):
        raise InputError(
            f"{answers}: found no answer about a driver of the test split of {source}, expected "
            "its episodes and agents as in the dataset's tables"
        )
    compared = {str(model): ours}
    if dataset.episodes("train"):
        training, asked = (whole_tracks(dataset, split, jobs) for split in ("train", "test"))
        known = training.codes.astype(np.int64)
        names = [entry.id for entry in dataset.manifest.episodes]
        where = [np.array(names)[asked.episode], asked.agent]
        probability = PlainRival(training).posterior(asked.features.astype(np.float64))
        forest = pd.DataFrame(probability, index=pd.MultiIndex.from_arrays(where))
        compared[RIVAL] = _replaced(ours, forest, int(np.bincount(known).argmax()))
    mine = _replaced(ours, given, int(np.bincount(known).argmax()))
    rows = [row for name, each in compared.items() for row in scored_answers(each, name)]
    rows += scored_answers(mine, answers.stem)
    for name, each in compared.items():
        pair = (Answers.of_tables([one.table for one in those]) for those in (mine, each))
        own, other = (answer.where(truth >= 0) for answer in pair)
        keys = {"model": answers.stem, "against": name, "scenario": ALL, "split": "test"}
        rows += score_difference(own, other, keys)
    return rows


def _truth(one: Answered) -> IntArray:
    return Answers.of_tables([one.table]).truth


def _replaced(ours: Sequence[Answered], given: pd.DataFrame, usual: int) -> list[Answered]:
    """The same drivers with probabilities by episode and agent; ``usual`` where there are none."""
    found = []
    for one in ours:
        agents = one.table["agent"].to_numpy()
        there = pd.MultiIndex.from_arrays([[one.entry.id] * agents.size, agents])
        probability = given.reindex(there).to_numpy(np.float64, copy=True)
        answered = np.isfinite(probability).all(axis=1)
        probability[~answered] = np.eye(len(BEHAVIORS))[usual]
        words = np.array([str(b) for b in BEHAVIORS])[probability.argmax(axis=1)]
        columns = dict(zip(one.table.column_names, one.table.columns, strict=True))
        columns["behavior"] = pa.array(words, pa.string(), mask=~answered)
        columns |= dict(zip(PROBABILITIES, probability.T, strict=True))
        table = pa.table(columns).cast(one.table.schema)
        found.append(dataclasses.replace(one, table=table))
    return found
