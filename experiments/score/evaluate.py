"""Scores a model where drivers are known, beside answers of any other model and the plain rival."""

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
from experiments.console.notices import LOGGER
from experiments.guard import guarded_call
from experiments.rival import PlainRival, whole_tracks
from experiments.score.answers import is_scored, joined_answers, score_difference
from experiments.score.labels import ALL, Answered, answer_episodes, scored_answers
from experiments.score.rows import Row
from experiments.score.tables import CHANCES
from graphrqi.model_files import load_model
from graphrqi.stream import MIN_SECONDS
from sim.formats.common.tables import read_table
from sim.store.dataset import Dataset, open_dataset

RIVAL: Final = "plain rival"
"""Name of the random forest on nine numbers of a driver's whole track, `experiments.rival`."""


def evaluate(
    model: str | Path, source: Path, labels: Path | None = None, answers: Path | None = None,
    *, traffic: str | None = None, jobs: int | None = None, quiet: bool = False,
) -> list[Row]:  # fmt: skip
    """Implement ``graphrqi evaluate``.

    Args:
        model: a shipped model's name or a folder.
        source: folder of a dataset.
        labels: as `answer_episodes` takes it, like all others.
        answers: answers of another model, as `read_answers` takes them. The test split alone is
            scored then.
        traffic: where the positions come from.
        jobs: processes.
        quiet: whether to show no progress.

    Returns:
        Rows by ``model``, ``scenario`` and ``split``, see `scored_answers`. With ``answers`` also
        those of the file and of the plain rival, which learns from the training split, and paired
        differences to each other model, which the key ``against`` names. A driver without an
        answer counts as unanswered, with the mean of the file's own probabilities.

    Raises:
        InputError: if nothing is known of any driver that an answer was given about, the file is
            broken, or it answers about no driver of the test split.
    """
    known, dataset = load_model(model), open_dataset(source)
    given = None if answers is None else guarded_call(answers, read_answers, answers)
    answered = answer_episodes(
        known, [dataset], split=None if given is None else "test", labels=labels, traffic=traffic,
        jobs=jobs, quiet=quiet,
    )  # fmt: skip
    if not any(one.table.num_rows for one in answered):
        raise InputError(f"{source}: found no driver seen for {MIN_SECONDS:g} s, expected one")
    rows = scored_answers(answered, str(model), known.classes)
    if not is_scored(rows):
        raise InputError(
            f"{source}: found no driver whose behaviour or style is known, expected at least one; "
            "--labels FILE.csv names some"
        )
    data = known.card.get("data")
    configurations = data.get("configurations") if isinstance(data, dict) else None
    if dict(dataset.header.configuration) in (configurations or ()):
        LOGGER.info("the model was trained on data like these: the test split counts")
    if given is None or answers is None:
        return rows
    there = {(one.entry.id, agent) for one in answered for agent in one.table["agent"].to_pylist()}
    if there.isdisjoint(given.index):
        raise InputError(
            f"{answers}: found no answer about a driver of the test split of {source}, expected "
            "its episodes and agents as in the dataset's tables"
        )
    compared = {str(model): answered}
    if dataset.episodes("train"):
        compared[RIVAL] = _replaced(answered, _forest_answers(dataset, jobs))
        rows += scored_answers(compared[RIVAL], RIVAL)
    mine = _replaced(answered, given)
    rows += scored_answers(mine, answers.stem)
    for name, each in compared.items():
        own, other = (joined_answers([one.table for one in those]) for those in (mine, each))
        keys = {"model": answers.stem, "against": name, "scenario": ALL, "split": "test"}
        rows += score_difference(own, other, keys)
    return rows


def read_answers(path: Path) -> pd.DataFrame:
    """The last answer about each driver in a file.

    Args:
        path: CSV or Parquet with the columns ``episode``, ``agent`` and ``label``, a behaviour.
            ``time_s`` orders several answers about one driver; `CHANCES` may be given, all or none.

    Returns:
        Probabilities (n, 6) by episode and agent; without such columns the label has 1.

    Raises:
        InputError: if a column is missing or broken, or a label is no behaviour.
    """
    numbers = ("agent", "time_s", *CHANCES)
    optional = ("time_s", *CHANCES)
    table = read_table(path, numbers, ("episode", "label"), optional)
    table = table.astype({"episode": str, "label": str, "agent": np.int64})
    codes = pd.Categorical(table["label"], [str(b) for b in BEHAVIORS]).codes
    if (codes < 0).any():
        wrong = table["label"][codes < 0].iloc[0]
        known = ", ".join(BEHAVIORS)
        raise InputError(f"{path}: label: found {wrong[:60]!r}, expected one of {known}")
    if not set(CHANCES) <= set(table):
        table[CHANCES] = np.eye(len(BEHAVIORS))[codes]
    if "time_s" in table:
        table = table.sort_values("time_s", kind="stable")
    last: pd.DataFrame = table.groupby(["episode", "agent"])[CHANCES].last()
    return last


def _forest_answers(dataset: Dataset, jobs: int | None) -> pd.DataFrame:
    """The plain rival's probabilities in the test split, by episode and agent."""
    training, asked = (whole_tracks(dataset, split, jobs) for split in ("train", "test"))
    names = np.array([entry.id for entry in dataset.manifest.episodes])
    probability = PlainRival(training).posterior(asked.features.astype(np.float64))
    where = pd.MultiIndex.from_arrays([names[asked.episode], asked.agent])
    return pd.DataFrame(probability, index=where)


def _replaced(ours: Sequence[Answered], given: pd.DataFrame) -> list[Answered]:
    """The same drivers with probabilities by episode and agent; their mean where there are none."""
    found = []
    for one in ours:
        agents = one.table["agent"].to_numpy()
        there = pd.MultiIndex.from_arrays([[one.entry.id] * agents.size, agents])
        probability = given.reindex(there).to_numpy(np.float64, copy=True)
        answered = np.isfinite(probability).all(axis=1)
        probability[~answered] = given.mean().to_numpy()
        words = np.array([str(b) for b in BEHAVIORS])[probability.argmax(axis=1)]
        columns = dict(zip(one.table.column_names, one.table.columns, strict=True))
        columns["behavior"] = pa.array(words, pa.string(), mask=~answered)
        columns |= dict(zip(CHANCES, probability.T, strict=True))
        table = pa.table(columns).cast(one.table.schema)
        found.append(dataclasses.replace(one, table=table))
    return found
