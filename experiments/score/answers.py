"""Scores of answers about drivers, for every source and format.

Scores are of the likeliest behaviour of every driver; the share of drivers with an answer is a
separate figure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS, Behavior, Style
from experiments.score.metrics import (
    Statistic,
    auc_over_episodes,
    balanced_accuracy,
    bootstrap,
    calibration_error,
    confusion,
    macro_f1,
    ratio,
    recalls,
    reliability,
    summed,
    weighted_accuracy,
)
from experiments.score.rows import Cell, Row, pivoted, tidy_row
from graphrqi.posterior import aggressive_share
from sim.frames import BoolArray, FloatArray, IntArray

STYLES: Final = (Style.AGGRESSIVE, Style.CONSERVATIVE)


@dataclass(frozen=True, slots=True)
class Answers:
    """Answers about some drivers, and their true labels.

    Attributes:
        episode: (n,) number of the episode.
        probability: (n, k) of each class; the likeliest is the answer.
        truth: (n,) codes into ``classes``, -1 where not known or none of them.
        style: (n,) codes into ``STYLES``, -1 where not known.
        answered: (n,) whether a behaviour is likely enough to be an answer.
        domain: (n,) 0 in simulated traffic, 1 in other traffic.
        classes: the behaviours that the model knows.
    """

    episode: IntArray
    probability: FloatArray
    truth: IntArray
    style: IntArray
    answered: BoolArray
    domain: FloatArray
    classes: tuple[Behavior, ...] = BEHAVIORS

    @classmethod
    def known(
        cls, probability: FloatArray, truth: NDArray[np.integer[Any]], episode: IntArray,
        classes: tuple[Behavior, ...] = BEHAVIORS,
    ) -> Answers:  # fmt: skip
        """Answers (n, k) that are always given, by true codes (n,) and episode numbers (n,)."""
        n, codes = len(probability), truth.astype(np.int64)
        style = np.where(codes >= 0, _styles_of(classes)[codes], -1)
        everyone = np.ones(n, dtype=bool)
        return cls(episode, probability, codes, style, everyone, np.zeros(n), classes)

    @classmethod
    def of_tables(
        cls, tables: Sequence[pa.Table], classes: tuple[Behavior, ...] = BEHAVIORS
    ) -> Answers:
        """The answers of a model that knows some classes, by tables as of a labels file."""
        table = pa.concat_tables(tables).to_pandas()
        return cls(
            episode=np.repeat(np.arange(len(tables)), [t.num_rows for t in tables]),
            probability=table[[f"p_{b}" for b in classes]].to_numpy(np.float64),
            truth=_codes(table["truth"], classes),
            style=_codes(table["true_style"], STYLES),
            answered=table["behavior"].notna().to_numpy(),
            domain=table["domain"].to_numpy(np.float64),
            classes=classes,
        )

    def where(self, chosen: BoolArray) -> Answers:
        """The answers for which ``chosen`` (n,) holds."""
        names = [field.name for field in fields(self) if field.name != "classes"]
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def counts(self) -> FloatArray:
        """(E, k, k) confusion matrices of behaviours."""
        likeliest = self.probability.argmax(axis=1)
        return confusion(self.truth, likeliest, self.episode, len(self.classes))

    def style_counts(self) -> FloatArray:
        """(E, 2, 2) confusion matrices of styles, by the larger sum of probabilities."""
        answer = (aggressive_share(self.probability, self.classes) < 0.5).astype(np.int64)
        return confusion(self.style, answer, self.episode, len(STYLES))


def _styles_of(classes: Sequence[Behavior]) -> IntArray:
    return np.array([STYLES.index(b.style) for b in classes])


def _codes(words: pd.Series[Any], known: Sequence[str]) -> IntArray:
    found = pd.Index([str(word) for word in known]).get_indexer(pd.Index(words))
    return np.asarray(found, dtype=np.int64)


def score_answers(
    answers: Answers,
    keys: Mapping[str, Cell],
    majority: int | None = None,
    breakdown: bool = True,
) -> list[Row]:
    """All answers of one source.

    Args:
        answers: one of every driver (or of every window of observation).
        keys: what was measured, for the rows.
        majority: code of the constant answer; None for the most frequent behaviour of the scored
            drivers.
        breakdown: whether rows by answer and by confidence are wanted.

    Returns:
        Rows. All drivers: ``drivers``, ``episodes``, ``answered_share``, ``domain`` and
        ``confidence``. Known behaviours: ``weighted_accuracy`` (the paper's, which is plain
        accuracy) beside ``majority_weighted_accuracy``, ``answered_accuracy``,
        ``balanced_accuracy``, ``macro_f1``, ``ece``, and by ``behavior`` the ``recall``. Known
        styles: ``style_accuracy`` beside ``majority_style_accuracy``,
        ``style_balanced_accuracy``, ``style_ece`` and ``style_auc``. The breakdown: by ``behavior``
        the ``named_share``; by ``behavior`` and ``answer`` the ``confusion``, a count; by
        ``confidence`` the ``reliability``, a share of right answers. Intervals are by bootstrap
        over episodes.
    """
    n, episode = answers.episode.size, answers.episode
    rows = [tidy_row(keys, "drivers", n, n=n)]
    if not n:
        return rows
    rows.append(tidy_row(keys, "episodes", np.unique(episode).size, n=n))
    likeliest = np.where(answers.answered, answers.probability.argmax(axis=1), -1)
    shares: list[tuple[str, dict[str, Cell], NDArray[Any]]] = [
        ("answered_share", {}, answers.answered),
        ("domain", {}, answers.domain),
        ("confidence", {}, answers.probability.max(axis=1)),
    ]
    for code, behavior in enumerate(answers.classes if breakdown else ()):
        shares.append(("named_share", {"behavior": str(behavior)}, likeliest == code))
    for name, more, part in shares:
        found = bootstrap(ratio, summed(episode, part, np.ones(n)))
        rows.append(tidy_row({**keys, **more}, name, *found, n))
    known = answers.where(answers.truth >= 0)
    if known.truth.size:
        rows += _behavior_rows(known, keys, majority, breakdown)
    known = answers.where(answers.style >= 0)
    if known.style.size:
        rows += _style_rows(known, keys, majority)
    return rows


def _behavior_rows(
    answers: Answers, keys: Mapping[str, Cell], majority: int | None, breakdown: bool
) -> Iterator[Row]:
    """Rows about drivers whose behaviour is known."""
    truth, episode, counts = answers.truth, answers.episode, answers.counts()
    constant = np.full(truth.size, np.bincount(truth).argmax() if majority is None else majority)
    bins = reliability(truth, answers.probability, episode)
    usual = confusion(truth, constant, episode, len(answers.classes))
    hit = answers.answered & (answers.probability.argmax(axis=1) == truth)
    right = summed(episode, hit, answers.answered)
    figures: list[tuple[str, Statistic, FloatArray]] = [
        ("weighted_accuracy", weighted_accuracy, counts),
        ("majority_weighted_accuracy", weighted_accuracy, usual),
        ("answered_accuracy", ratio, right),
        ("balanced_accuracy", balanced_accuracy, counts),
        ("macro_f1", macro_f1, counts),
        ("ece", calibration_error, bins),
    ]
    for name, statistic, per_episode in figures:
        n = int(right[:, 1].sum()) if name == "answered_accuracy" else truth.size
        if n:
            yield tidy_row(keys, name, *bootstrap(statistic, per_episode), n)
    total = counts.sum(axis=0)
    for code, behavior in enumerate(answers.classes):
        own, row = int(total[code].sum()), {**keys, "behavior": str(behavior)}
        if own:
            found = bootstrap(lambda matrix, at=code: recalls(matrix)[..., at], counts)  # type: ignore[misc]
            yield tidy_row(row, "recall", *found, own)
        for taken, other in zip(total[code], answers.classes if breakdown else (), strict=False):
            yield tidy_row({**row, "answer": str(other)}, "confusion", float(taken), n=own)
    for number, (count, sure, _) in enumerate(bins.sum(axis=0) if breakdown else ()):
        if count:
            row = {**keys, "confidence": round(float(sure / count), 4)}
            found = bootstrap(ratio, bins[:, number, [2, 0]])
            yield tidy_row(row, "reliability", *found, int(count))


def _style_rows(answers: Answers, keys: Mapping[str, Cell], majority: int | None) -> Iterator[Row]:
    """Rows about drivers whose style is known, with or without their behaviour."""
    truth, episode, n = answers.style, answers.episode, answers.style.size
    aggressive, counts = (
        aggressive_share(answers.probability, answers.classes),
        answers.style_counts(),
    )
    usual = (
        np.bincount(truth).argmax() if majority is None else _styles_of(answers.classes)[majority]
    )
    bins = reliability(truth, np.stack([aggressive, 1.0 - aggressive], axis=1), episode)
    figures: list[tuple[str, Statistic, FloatArray]] = [
        ("style_accuracy", weighted_accuracy, counts),
        ("majority_style_accuracy", ratio, summed(episode, truth == usual, np.ones(n))),
        ("style_balanced_accuracy", balanced_accuracy, counts),
        ("style_ece", calibration_error, bins),
    ]
    for name, statistic, per_episode in figures:
        yield tidy_row(keys, name, *bootstrap(statistic, per_episode), n)
    yield tidy_row(keys, "style_auc", *auc_over_episodes(aggressive, truth == 0, episode), n)


def score_difference(ours: Answers, theirs: Answers, keys: Mapping[str, Cell]) -> list[Row]:
    """How much better some answers are than others about the same drivers in the same order.

    Returns:
        ``macro_f1_difference`` and ``style_balanced_accuracy_difference``, with intervals by a
        paired bootstrap over episodes.
    """
    rows = []
    for name, of, pair in (
        ("macro_f1", macro_f1, (ours.counts(), theirs.counts())),
        (
            "style_balanced_accuracy",
            balanced_accuracy,
            (ours.style_counts(), theirs.style_counts()),
        ),
    ):

        def difference(counts: FloatArray, of: Statistic = of) -> FloatArray:
            return np.asarray(of(counts[..., 0, :, :]) - of(counts[..., 1, :, :]))

        found = bootstrap(difference, np.stack(pair, axis=1))
        rows.append(tidy_row(keys, f"{name}_difference", *found, ours.truth.size))
    return rows


SHOWN: Final = {
    "drivers": "drivers",
    "weighted_accuracy": "accuracy",
    "majority_weighted_accuracy": "majority class",
    "answered_accuracy": "of answers",
    "balanced_accuracy": "balanced",
    "macro_f1": "macro F1",
    "ece": "ECE",
    "style_balanced_accuracy": "style, balanced",
    "style_auc": "style, AUC",
    "answered_share": "answered",
    "domain": "domain",
}
"""Metrics of the table for people, by column."""

WITH_INTERVAL: Final = frozenset({"weighted_accuracy", "style_auc"})
"""Metrics that the table for people gives with their intervals (all would not fit)."""


def scores_table(rows: Sequence[Row], down: Sequence[str] = ("scenario", "split")) -> list[Row]:
    """Rows of `score_answers` for people: a line for each combination of some keys."""

    def cell(row: Row) -> str:
        value, low = float(row["value"] or 0.0), row["low"]
        if row["metric"] == "drivers":
            return f"{value:.0f}"
        if low is not None and row["metric"] in WITH_INTERVAL:
            return f"{value:.2f} [{low:.2f}, {row['high']:.2f}]"
        return f"{value:.2f}"

    measured = [row for row in rows if row["value"] is not None]
    lines = pivoted(measured, down, lambda row: SHOWN.get(str(row["metric"])), cell)
    order = [*down, *SHOWN.values()]
    return [{k: line[k] for k in order if k in line} for line in lines]


def confusion_table(rows: Sequence[Row]) -> list[Row]:
    """How often each behaviour gets each answer, a line for each true behaviour.

    Counts are of the last group of rows of `score_answers`, of the test split where there is one.
    """
    counted = [row for row in rows if row["metric"] == "confusion" and row["n"]]
    counted = [row for row in counted if row.get("split") == "test"] or counted
    lines = pivoted(
        counted, ["behavior"], lambda row: str(row["answer"]), lambda row: int(row["value"] or 0)
    )
    return [{"true behaviour": line.pop("behavior"), **line} for line in lines]


def is_scored(rows: Iterable[Row]) -> bool:
    """Whether anything is known of any driver that was scored."""
    return any(row["metric"] == "style_accuracy" for row in rows)
