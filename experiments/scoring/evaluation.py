"""Evaluate a model on a dataset: every driver once, by the last answer that it got.

The answers are those that ``graphrqi classify`` writes. Scores are of the likeliest behaviour of
every driver, whether it was told or not; how many were told is a figure of its own. Intervals are
by bootstrap over episodes. The majority class is the most frequent one among the drivers that are
scored, so it is the best that a constant answer could do there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Style
from experiments.data.parallel import all_in_parallel
from experiments.data.windows import places_of
from experiments.rows import Cell, Row, of_bench, tidy_row
from experiments.scoring.classification import (
    Answered,
    label_episode,
    last_answers,
    probabilities,
    with_truth,
)
from experiments.scoring.metrics import (
    FloatArray,
    IntArray,
    Statistic,
    auc_over_episodes,
    balanced_accuracy,
    bootstrap,
    calibration_error,
    confusion,
    likeliest,
    macro_f1,
    ratio,
    recall_of,
    reliability,
    summed,
    weighted_accuracy,
)
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.posterior import aggressive_share
from graphrqi.stream import MIN_SECONDS
from sim.formats.common.label_file import read_driver_labels
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

BENCH: Final = "evaluation"
"""What rows of an evaluation are marked with."""

ALL: Final = "all"
"""The scenario or split of rows over several of them."""

STYLES: Final = (Style.AGGRESSIVE, Style.CONSERVATIVE)


@dataclass(frozen=True, slots=True)
class Cases:
    """Drivers, each with its last answer.

    Attributes:
        episode: (n,) number of the episode.
        probability: (n, 6) of each behaviour.
        told, style_told: (n,) whether a behaviour, a style is likely enough to be told.
        domain: (n,) how foreign the traffic is to the model.
        truth: (n,) codes into ``BEHAVIORS``, -1 where not known.
        style: (n,) codes into ``STYLES``, -1 where not known.
    """

    episode: IntArray
    probability: FloatArray
    told: NDArray[np.bool_]
    style_told: NDArray[np.bool_]
    domain: FloatArray
    truth: NDArray[np.int8]
    style: NDArray[np.int8]

    @classmethod
    def of(cls, tables: Sequence[pa.Table]) -> Cases:
        """The drivers of some episodes, from their last answers (columns ``LABELS``)."""
        table = pa.concat_tables(tables)
        return cls(
            episode=np.repeat(np.arange(len(tables)), [t.num_rows for t in tables]),
            probability=probabilities(table),
            told=pc.is_valid(table["behavior"]).to_numpy(),
            style_told=pc.is_valid(table["style"]).to_numpy(),
            domain=table["domain"].to_numpy().astype(np.float64),
            truth=_codes(table["truth"], BEHAVIORS),
            style=_codes(table["true_style"], STYLES),
        )

    def where(self, chosen: NDArray[np.bool_]) -> Cases:
        """The cases for which ``chosen`` holds."""
        return Cases(*(getattr(self, name)[chosen] for name in self.__slots__))


def _codes(words: pa.ChunkedArray, known: Sequence[str]) -> NDArray[np.int8]:
    codes = pc.fill_null(pc.index_in(words, value_set=pa.array(known, pa.string())), -1)
    return np.asarray(codes.to_numpy(), dtype=np.int8)


def evaluate(
    model: str | Path,
    source: Path,
    labels: Path | None = None,
    *,
    jobs: int | None = None,
    quiet: bool = False,
) -> list[Row]:
    """What ``graphrqi evaluate`` does.

    Args:
        model: a shipped model's name or a folder.
        source: folder of a dataset.
        labels: a CSV file with labels of some drivers (`sim.formats.common.label_file`); they
            replace those of the dataset.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        Tidy rows, see `evaluation_rows`.

    Raises:
        InputError: if nothing is known of any driver that an answer was given about.
    """
    given = None if labels is None else read_driver_labels(labels)
    dataset = open_dataset(source)
    answered = answers_of(load_model(model), [dataset], None, jobs, quiet)
    if given is not None:
        for number, (entry, found) in enumerate(zip(dataset.episodes(), answered, strict=True)):
            table = with_truth(found.table, found.names, entry, given)
            answered[number] = Answered(found.place, found.names, table)
        given.check()
    if not any(found.table.num_rows for found in answered):
        raise InputError(f"{source}: found no driver seen for {MIN_SECONDS:g} s, expected one")
    rows = evaluation_rows(answered, str(model))
    if not is_scored(rows):
        raise InputError(
            f"{source}: found no driver whose behaviour or style is known, expected at least one; "
            "--labels FILE.csv names some"
        )
    return rows


def answers_of(
    model: Model,
    datasets: Sequence[Dataset],
    split: Split | None = None,
    jobs: int | None = None,
    quiet: bool = True,
) -> list[Answered]:
    """The last answers about the drivers of datasets.

    Args:
        model: a trained model.
        datasets: where from.
        split: only this part; None for all.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        An entry for each episode, in the manifests' order.
    """
    every = [(d.path, e) for d in datasets for e in d.manifest.episodes]
    arguments = [
        (model, path, entry, place)
        for (path, entry), place in zip(every, places_of(datasets), strict=True)
        if split in (None, entry.split)
    ]
    return all_in_parallel(_answered, arguments, jobs, "answering episodes", quiet)


@lru_cache(maxsize=4)
def _opened(folder: Path) -> Dataset:
    return open_dataset(folder)


def _answered(model: Model, folder: Path, entry: EpisodeEntry, place: str) -> Answered:
    episode = _opened(folder).read(entry)
    return Answered(place, episode.tracks.names, last_answers(label_episode(episode, model)))


def evaluation_rows(answered: Sequence[Answered], model: str) -> list[Row]:
    """Everything that last answers say about a model.

    Args:
        answered: by episode.
        model: its name.

    Returns:
        Rows of the bench ``evaluation`` by ``model``, ``scenario`` and ``split``, "all" where
        there are several. Of all drivers: ``drivers``, ``unknown_share``, ``style_unknown_share``,
        ``foreign`` and ``confidence``, and by ``behavior`` the ``answered_share``. Of those whose
        behaviour is known: ``weighted_accuracy`` (which is plain accuracy) beside
        ``majority_weighted_accuracy``, ``told_accuracy`` (of those with an answer),
        ``balanced_accuracy``, ``macro_f1``, ``ece``; by ``behavior`` the ``recall``; by
        ``behavior`` and ``answer`` the ``confusion``, a count; by ``confidence`` the
        ``reliability``, the share of right answers. Of those whose style is known:
        ``style_accuracy`` beside ``majority_style_accuracy``, ``style_balanced_accuracy``,
        ``style_auc`` and ``style_ece``. Nothing is said of episodes without any driver.
    """
    rows: list[Row] = []
    for (scenario, split), tables in _groups(answered).items():
        keys = {"model": model, "scenario": scenario, "split": split}
        rows += of_bench(BENCH, _rows(Cases.of(tables), keys))
    return rows


def _groups(answered: Sequence[Answered]) -> dict[tuple[str, str], list[pa.Table]]:
    """The episodes with drivers, by scenario and split, and over all of either."""
    each: dict[tuple[str, str], list[pa.Table]] = {}
    for one in answered:
        if one.table.num_rows:
            split = one.table["split"][0].as_py()
            each.setdefault((one.place, split), []).append(one.table)
    scenarios = list(dict.fromkeys(scenario for scenario, _ in each))
    splits = [s for s in ("train", "validation", "test") if any(s == x for _, x in each)]
    groups = {}
    for split in [*splits, *([ALL] if len(splits) > 1 else [])]:
        for scenario in [*scenarios, *([ALL] if len(scenarios) > 1 else [])]:
            tables = [
                table
                for (place, part), some in each.items()
                if scenario in (ALL, place) and split in (ALL, part)
                for table in some
            ]
            if tables:
                groups[scenario, split] = tables
    return groups


def _rows(cases: Cases, keys: Mapping[str, Cell]) -> Iterator[Row]:
    n, episode = cases.episode.size, cases.episode

    def share(name: str, part: FloatArray | NDArray[np.bool_], extra: Mapping[str, Cell]) -> Row:
        found = bootstrap(ratio, summed(episode, part, np.ones(n)))
        return tidy_row({**keys, **extra}, name, *found, n)

    yield tidy_row(keys, "drivers", n, None, None, n)
    yield tidy_row(keys, "episodes", np.unique(episode).size, None, None, n)
    yield share("unknown_share", ~cases.told, {})
    yield share("style_unknown_share", ~cases.style_told, {})
    yield share("foreign", cases.domain, {})
    yield share("confidence", cases.probability.max(axis=1), {})
    answer = np.where(cases.told, likeliest(cases.probability), -1)
    for code, behavior in enumerate(BEHAVIORS):
        yield share("answered_share", answer == code, {"behavior": behavior.value})
    known = cases.where(cases.truth >= 0)
    if known.truth.size:
        yield from _behavior_rows(known, keys)
    known = cases.where(cases.style >= 0)
    if known.style.size:
        yield from _style_rows(known, keys)


def _behavior_rows(cases: Cases, keys: Mapping[str, Cell]) -> Iterator[Row]:
    """Rows about drivers whose behaviour is known."""
    truth, episode, n = cases.truth, cases.episode, int(cases.truth.size)
    answer = likeliest(cases.probability)
    counts = confusion(truth, answer, episode)
    majority = int(np.bincount(truth).argmax())
    constant = confusion(truth, np.full(n, majority), episode)
    bins = reliability(truth, cases.probability, episode)
    told = summed(episode, cases.told & (answer == truth), cases.told)
    measured: dict[str, tuple[Statistic, FloatArray, int]] = {
        "weighted_accuracy": (weighted_accuracy, counts, n),
        "majority_weighted_accuracy": (weighted_accuracy, constant, n),
        "balanced_accuracy": (balanced_accuracy, counts, n),
        "macro_f1": (macro_f1, counts, n),
        "ece": (calibration_error, bins, n),
    }
    if cases.told.any():
        measured["told_accuracy"] = ratio, told, int(cases.told.sum())
    for name, (statistic, per_episode, count) in measured.items():
        yield tidy_row(keys, name, *bootstrap(statistic, per_episode), count)
    total = counts.sum(axis=0)
    for code, behavior in enumerate(BEHAVIORS):
        own = int(total[code].sum())
        if own:
            row = {**keys, "behavior": behavior.value}
            yield tidy_row(row, "recall", *bootstrap(recall_of(code), counts), own)
    for code, behavior in enumerate(BEHAVIORS):
        for other, word in enumerate(BEHAVIORS):
            row = {**keys, "behavior": behavior.value, "answer": word.value}
            own = int(total[code].sum())
            yield tidy_row(row, "confusion", float(total[code, other]), None, None, own)
    for number, (count, sure, _) in enumerate(bins.sum(axis=0)):
        if count:
            row = {**keys, "confidence": round(float(sure / count), 4)}
            per_episode = bins[:, number, [2, 0]]
            yield tidy_row(row, "reliability", *bootstrap(ratio, per_episode), int(count))


def _style_rows(cases: Cases, keys: Mapping[str, Cell]) -> Iterator[Row]:
    """Rows about drivers whose style is known, with or without their behaviour."""
    truth, episode, n = cases.style, cases.episode, int(cases.style.size)
    aggressive = aggressive_share(cases.probability)
    probability = np.stack([aggressive, 1.0 - aggressive], axis=1)
    counts = confusion(truth, likeliest(probability), episode, len(STYLES))
    majority = int(np.bincount(truth).argmax())
    constant = confusion(truth, np.full(n, majority), episode, len(STYLES))
    measured: dict[str, tuple[Statistic, FloatArray]] = {
        "style_accuracy": (weighted_accuracy, counts),
        "majority_style_accuracy": (weighted_accuracy, constant),
        "style_balanced_accuracy": (balanced_accuracy, counts),
        "style_ece": (calibration_error, reliability(truth, probability, episode)),
    }
    for name, (statistic, per_episode) in measured.items():
        yield tidy_row(keys, name, *bootstrap(statistic, per_episode), n)
    area = auc_over_episodes(aggressive, truth == 0, episode)
    yield tidy_row(keys, "style_auc", *area, n)


SHOWN: Final = {
    "weighted_accuracy": "accuracy",
    "majority_weighted_accuracy": "majority class",
    "told_accuracy": "where told",
    "balanced_accuracy": "balanced",
    "macro_f1": "macro F1",
    "ece": "ECE",
    "style_balanced_accuracy": "style, balanced",
    "style_auc": "style, AUC",
    "unknown_share": "unknown",
}
"""Metrics of the table for people, by column."""

WITH_INTERVAL: Final = frozenset({"weighted_accuracy", "style_auc"})
"""Metrics that the table for people gives with their intervals (all would not fit)."""


def evaluation_table(rows: Sequence[Row]) -> list[Row]:
    """The scores among the rows of an evaluation, a line for each scenario and split."""
    lines: dict[tuple[Cell, Cell], dict[str, Cell]] = {}
    for row in rows:
        key = row["scenario"], row["split"]
        line = lines.setdefault(key, {"scenario": key[0], "split": key[1], "drivers": row["n"]})
        name = SHOWN.get(str(row["metric"]))
        if name is not None and row["value"] is not None:
            low, high = row["low"], row["high"]
            interval = ""
            if low is not None and row["metric"] in WITH_INTERVAL:
                interval = f" [{float(low):.2f}, {float(high or 0.0):.2f}]"
            if row["metric"] in ("weighted_accuracy", "style_balanced_accuracy"):
                line.setdefault("known", row["n"])
            line[name] = f"{float(row['value']):.2f}{interval}"
    order = ["scenario", "split", "drivers", "known", *SHOWN.values()]
    return [{k: line[k] for k in order if k in line} for line in lines.values()]


def confusion_table(rows: Sequence[Row]) -> tuple[list[Row], str]:
    """Who is taken for whom in the test split, or in all where there is none.

    Args:
        rows: of an evaluation.

    Returns:
        A line for each true behaviour, with counts of answers, and what part of the data it is.
    """
    counted = [row for row in rows if row["metric"] == "confusion" and row["n"]]
    of_test = [row for row in counted if row["split"] == "test"] or counted
    whole = [(row["scenario"], row["split"]) for row in of_test][-1:]
    lines: dict[Cell, dict[str, Cell]] = {}
    for row in of_test:
        if [(row["scenario"], row["split"])] == whole:
            line = lines.setdefault(row["behavior"], {"true": row["behavior"]})
            line[str(row["answer"])] = int(row["value"] or 0)
    return list(lines.values()), ", ".join(
        f"{a} scenarios, {b} split" if a == ALL else f"{a}, {b} split" for a, b in whole
    )


def is_scored(rows: Sequence[Row]) -> bool:
    """Whether anything is known of any driver of an evaluation."""
    return any(row["metric"] == "style_accuracy" for row in rows)


def trained_here(model: str | Path, source: Path) -> bool:
    """Whether a model was trained on a dataset of the same configuration as this one."""
    data = load_model(model).card.get("data")
    known = data.get("configurations") if isinstance(data, dict) else None
    configuration = dict(open_dataset(source).header.configuration)
    return isinstance(known, list) and configuration in known
