"""Scores of answers about drivers, for every source and format.

Scores are of the likeliest behaviour of every driver; the share of drivers with an answer is a
separate figure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
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
from sim.frames import FloatArray, IntArray

STYLES: Final = (Style.AGGRESSIVE, Style.CONSERVATIVE)


def joined_answers(tables: Sequence[pa.Table]) -> pd.DataFrame:
    """Tables as of a labels file, of an episode each, as one, in which episodes are numbers."""
    number = np.repeat(np.arange(len(tables)), [table.num_rows for table in tables])
    answers: pd.DataFrame = pa.concat_tables(tables).to_pandas().assign(episode=number)
    return answers


def known_answers(
    probability: FloatArray, truth: NDArray[np.integer[Any]], episode: IntArray,
    classes: Sequence[Behavior] = BEHAVIORS,
) -> pd.DataFrame:  # fmt: skip
    """Answers (n, k) that are always given, with the columns of a labels file that scores need.

    Episodes (n,) are numbers. True codes (n,) stand for the classes, and -1 for an unknown one.
    """
    words, styles = (
        np.array([*map(str, names), None], dtype=object)
        for names in (classes, [one.style for one in classes])
    )
    answers = pd.DataFrame(probability, columns=[f"p_{b}" for b in classes])
    return answers.assign(
        episode=episode, domain=0.0, behavior=words[probability.argmax(axis=1)],
        truth=words[truth], true_style=styles[truth],
    )  # fmt: skip


def score_answers(
    answers: pd.DataFrame,
    keys: Mapping[str, Cell],
    majority: int | None = None,
    breakdown: bool = True,
    classes: Sequence[Behavior] = BEHAVIORS,
) -> list[Row]:
    """All answers of one source.

    Args:
        answers: one of every driver (or of every window of observation), as from `joined_answers`
            or `known_answers`.
        keys: what was measured, for the rows.
        majority: code of the constant answer; None for the most frequent behaviour of the scored
            drivers.
        breakdown: whether rows by answer and by confidence are wanted.
        classes: the behaviours that the model knows.

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
    n, episode = len(answers), answers["episode"].to_numpy()
    rows = [tidy_row(keys, "drivers", n, n=n)]
    if not n:
        return rows
    rows.append(tidy_row(keys, "episodes", np.unique(episode).size, n=n))
    probability = _chances(answers, classes)
    answer = np.where(answers["behavior"].notna(), probability.argmax(axis=1), -1)
    shares: list[tuple[str, dict[str, Cell], NDArray[Any]]] = [
        ("answered_share", {}, answer >= 0),
        ("domain", {}, answers["domain"].to_numpy(np.float64)),
        ("confidence", {}, probability.max(axis=1)),
    ]
    for code, behavior in enumerate(classes if breakdown else ()):
        shares.append(("named_share", {"behavior": str(behavior)}, answer == code))
    for name, more, part in shares:
        found = bootstrap(ratio, summed(episode, part, np.ones(n)))
        rows.append(tidy_row({**keys, **more}, name, *found, n))
    known = answers[_codes(answers["truth"], classes) >= 0]
    if len(known):
        rows += _behavior_rows(known, keys, majority, breakdown, classes)
    known = answers[_codes(answers["true_style"], STYLES) >= 0]
    if len(known):
        rows += _style_rows(known, keys, majority, classes)
    return rows


def _codes(words: pd.Series[Any], known: Sequence[str]) -> IntArray:
    found = pd.Index([str(word) for word in known]).get_indexer(pd.Index(words))
    return np.asarray(found, dtype=np.int64)


def _chances(answers: pd.DataFrame, classes: Sequence[Behavior]) -> FloatArray:
    return np.asarray(answers[[f"p_{b}" for b in classes]], dtype=np.float64)


def _counts(answers: pd.DataFrame, classes: Sequence[Behavior] = BEHAVIORS) -> FloatArray:
    """(E, k, k) confusion matrices of behaviours."""
    truth, likeliest = _codes(answers["truth"], classes), _chances(answers, classes).argmax(axis=1)
    return confusion(truth, likeliest, answers["episode"].to_numpy(), len(classes))


def _style_counts(answers: pd.DataFrame, classes: Sequence[Behavior] = BEHAVIORS) -> FloatArray:
    """(E, 2, 2) confusion matrices of styles, by the larger sum of probabilities."""
    answer = (aggressive_share(_chances(answers, classes), classes) < 0.5).astype(np.int64)
    truth = _codes(answers["true_style"], STYLES)
    return confusion(truth, answer, answers["episode"].to_numpy(), len(STYLES))


def _behavior_rows(
    answers: pd.DataFrame, keys: Mapping[str, Cell], majority: int | None, breakdown: bool,
    classes: Sequence[Behavior],
) -> Iterator[Row]:  # fmt: skip
    """Rows about drivers whose behaviour is known."""
    truth, episode = _codes(answers["truth"], classes), answers["episode"].to_numpy()
    counts, probability = _counts(answers, classes), _chances(answers, classes)
    answered = answers["behavior"].notna().to_numpy()
    usual = np.bincount(truth).argmax() if majority is None else majority
    bins = reliability(truth, probability, episode)
    right = summed(episode, answered & (probability.argmax(axis=1) == truth), answered)
    figures: list[tuple[str, Statistic, FloatArray]] = [
        ("weighted_accuracy", weighted_accuracy, counts),
        ("majority_weighted_accuracy", ratio, summed(episode, truth == usual, truth >= 0)),
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
    for code, behavior in enumerate(classes):
        own, row = int(total[code].sum()), {**keys, "behavior": str(behavior)}
        if own:
            found = bootstrap(lambda matrix, at=code: recalls(matrix)[..., at], counts)  # type: ignore[misc]
            yield tidy_row(row, "recall", *found, own)
        for taken, other in zip(total[code], classes if breakdown else (), strict=False):
            yield tidy_row({**row, "answer": str(other)}, "confusion", float(taken), n=own)
    for number, (count, sure, _) in enumerate(bins.sum(axis=0) if breakdown else ()):
        if count:
            row = {**keys, "confidence": round(float(sure / count), 4)}
            found = bootstrap(ratio, bins[:, number, [2, 0]])
            yield tidy_row(row, "reliability", *found, int(count))


def _style_rows(
    answers: pd.DataFrame, keys: Mapping[str, Cell], majority: int | None,
    classes: Sequence[Behavior],
) -> Iterator[Row]:  # fmt: skip
    """Rows about drivers whose style is known, with or without their behaviour."""
    truth, episode = _codes(answers["true_style"], STYLES), answers["episode"].to_numpy()
    aggressive, counts = (
        aggressive_share(_chances(answers, classes), classes),
        _style_counts(answers, classes),
    )
    usual = (
        np.bincount(truth).argmax() if majority is None else STYLES.index(classes[majority].style)
    )
    bins = reliability(truth, np.stack([aggressive, 1.0 - aggressive], axis=1), episode)
    figures: list[tuple[str, Statistic, FloatArray]] = [
        ("style_accuracy", weighted_accuracy, counts),
        ("majority_style_accuracy", ratio, summed(episode, truth == usual, truth >= 0)),
        ("style_balanced_accuracy", balanced_accuracy, counts),
        ("style_ece", calibration_error, bins),
    ]
    for name, statistic, per_episode in figures:
        yield tidy_row(keys, name, *bootstrap(statistic, per_episode), truth.size)
    auc = auc_over_episodes(aggressive, truth == 0, episode)
    yield tidy_row(keys, "style_auc", *auc, truth.size)


def score_difference(
    ours: pd.DataFrame, theirs: pd.DataFrame, keys: Mapping[str, Cell]
) -> list[Row]:
    """How much better some answers are than others about the same drivers in the same order.

    Returns:
        ``macro_f1_difference`` and ``style_balanced_accuracy_difference``, of drivers whose
        behaviour is known, with intervals by a paired bootstrap over episodes.
    """
    known = _codes(ours["truth"], BEHAVIORS) >= 0
    ours, theirs, rows = ours[known], theirs[known], []
    for name, of, counted in (
        ("macro_f1", macro_f1, _counts),
        ("style_balanced_accuracy", balanced_accuracy, _style_counts),
    ):

        def difference(counts: FloatArray, of: Statistic = of) -> FloatArray:
            return np.asarray(of(counts[..., 0, :, :]) - of(counts[..., 1, :, :]))

        found = bootstrap(difference, np.stack([counted(ours), counted(theirs)], axis=1))
        rows.append(tidy_row(keys, f"{name}_difference", *found, len(ours)))
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
