"""Scores of answers about drivers, for every source and format.

Scores are of the likeliest behaviour of every driver; the share of drivers with an answer is a
separate figure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS, Behavior, Style
from experiments.score import metrics
from experiments.score.metrics import Statistic, ratio, row_of, summed
from experiments.score.rows import Cell, Row, pivoted, tidy_row
from graphrqi.posterior import aggressive_share
from sim.frames import FloatArray, IntArray

STYLES: Final = (Style.AGGRESSIVE, Style.CONSERVATIVE)


def known_answers(
    probability: FloatArray, truth: NDArray[np.integer[Any]], episode: IntArray,
    classes: Sequence[Behavior] = BEHAVIORS,
) -> pd.DataFrame:  # fmt: skip
    """Answers (n, k) that are always given, with the columns of a labels file that scores need.

    True codes (n,) stand for the classes, and -1 for an unknown one.
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
        answers: one of every driver (or of every window of observation), with the columns of a
            labels file, as `answer_episodes` or `known_answers` give them.
        keys: what was measured, for the rows.
        majority: code of the constant answer; None for the most frequent behaviour of the scored
            drivers.
        breakdown: whether rows by answer (``named_share``, ``confusion``) and by confidence
            (``reliability``, a share of right answers) are wanted.
        classes: the behaviours that the model knows.

    Returns:
        Rows of all drivers, then of those with a known behaviour, then with a known style.
        ``weighted_accuracy`` is the paper's, which is plain accuracy. Intervals are by bootstrap
        over episodes.
    """
    n, episode = len(answers), _episodes(answers)
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
        rows.append(row_of({**keys, **more}, name, ratio, summed(episode, part, np.ones(n)), n))
    known = answers[_codes(answers["truth"], classes) >= 0]
    if len(known):
        rows += _behavior_rows(known, keys, majority, breakdown, classes)
    known = answers[_codes(answers["true_style"], STYLES) >= 0]
    if len(known):
        rows += _style_rows(known, keys, majority, classes)
    return rows


def _episodes(answers: pd.DataFrame) -> IntArray:
    """(n,) numbers of the answers' episodes, in the order in which they come."""
    return np.asarray(pd.factorize(answers["episode"])[0], dtype=np.int64)


def _codes(words: pd.Series[Any], known: Sequence[str]) -> IntArray:
    found = pd.Index([str(word) for word in known]).get_indexer(pd.Index(words))
    return np.asarray(found, dtype=np.int64)


def _chances(answers: pd.DataFrame, classes: Sequence[Behavior]) -> FloatArray:
    return np.asarray(answers[[f"p_{b}" for b in classes]], dtype=np.float64)


def _style_chances(answers: pd.DataFrame, classes: Sequence[Behavior]) -> FloatArray:
    """(n, 2) probabilities of `STYLES`."""
    aggressive = aggressive_share(_chances(answers, classes), classes)
    return np.stack([aggressive, 1.0 - aggressive], axis=1)


def _counts(truth: IntArray, probability: FloatArray, episode: IntArray) -> FloatArray:
    """(E, k, k) confusion matrices of the likeliest class."""
    return metrics.confusion(truth, probability.argmax(axis=1), episode, probability.shape[1])


def _figures(
    answers: pd.DataFrame, truth: IntArray, probability: FloatArray, usual: int | None
) -> dict[str, tuple[Statistic, FloatArray]]:
    """Statistics of answers with known codes beside a constant one, each with its counts."""
    episode, right = _episodes(answers), probability.argmax(axis=1) == truth
    counts = _counts(truth, probability, episode)
    constant = truth == (np.bincount(truth).argmax() if usual is None else usual)
    bins = metrics.reliability(right, probability.max(axis=1), episode)
    return {
        "accuracy": (metrics.weighted_accuracy, counts),
        "majority": (ratio, summed(episode, constant, np.ones(truth.size))),
        "balanced_accuracy": (metrics.balanced_accuracy, counts),
        "macro_f1": (metrics.macro_f1, counts),
        "ece": (metrics.calibration_error, bins),
    }


def _behavior_rows(
    answers: pd.DataFrame, keys: Mapping[str, Cell], majority: int | None, breakdown: bool,
    classes: Sequence[Behavior],
) -> Iterator[Row]:  # fmt: skip
    """Rows about drivers whose behaviour is known."""
    truth, probability = _codes(answers["truth"], classes), _chances(answers, classes)
    found = _figures(answers, truth, probability, majority)
    said = {"accuracy": "weighted_accuracy", "majority": "majority_weighted_accuracy"}
    rows = [row_of(keys, said.get(name, name), *each, truth.size) for name, each in found.items()]
    answered = answers["behavior"].notna().to_numpy()
    if answered.any():
        right = answered & (probability.argmax(axis=1) == truth)
        shares = summed(_episodes(answers), right, answered)
        rows.insert(2, row_of(keys, "answered_accuracy", ratio, shares, int(answered.sum())))
    yield from rows
    counts, bins = found["accuracy"][1], found["ece"][1]
    total = counts.sum(axis=0)
    for code, behavior in enumerate(classes):
        own, row = int(total[code].sum()), {**keys, "behavior": str(behavior)}
        if own:
            per_episode = np.stack([counts[:, code, code], counts[:, code].sum(axis=1)], axis=1)
            yield row_of(row, "recall", ratio, per_episode, own)
        for taken, other in zip(total[code], classes if breakdown else (), strict=False):
            yield tidy_row({**row, "answer": str(other)}, "confusion", float(taken), n=own)
    for number, (count, sure, _) in enumerate(bins.sum(axis=0) if breakdown else ()):
        if count:
            row = {**keys, "confidence": round(float(sure / count), 4)}
            yield row_of(row, "reliability", ratio, bins[:, number, [2, 0]], int(count))


def _style_rows(
    answers: pd.DataFrame, keys: Mapping[str, Cell], majority: int | None,
    classes: Sequence[Behavior],
) -> Iterator[Row]:  # fmt: skip
    """Rows about drivers whose style is known, with or without their behaviour."""
    truth, probability = _codes(answers["true_style"], STYLES), _style_chances(answers, classes)
    usual = None if majority is None else STYLES.index(classes[majority].style)
    found = _figures(answers, truth, probability, usual)
    for name in ("accuracy", "majority", "balanced_accuracy", "ece"):
        said = "majority_style_accuracy" if name == "majority" else f"style_{name}"
        yield row_of(keys, said, *found[name], truth.size)
    auc = metrics.auc_over_episodes(probability[:, 0], truth == 0, _episodes(answers))
    yield tidy_row(keys, "style_auc", *auc, truth.size)


def score_difference(
    ours: pd.DataFrame, theirs: pd.DataFrame, keys: Mapping[str, Cell],
    classes: Sequence[Behavior] = BEHAVIORS,
) -> list[Row]:  # fmt: skip
    """How much better some answers are than others about the same drivers in the same order.

    Drivers count whose behaviour is known; intervals are by a paired bootstrap over episodes.
    """
    known = _codes(ours["truth"], classes) >= 0
    rows: list[Row] = []
    figures: Any = (
        ("macro_f1", metrics.macro_f1, "truth", classes, _chances),
        ("balanced_accuracy", metrics.balanced_accuracy, "true_style", STYLES, _style_chances),
    )
    for name, of, column, words, chances in figures:
        each = [
            _counts(_codes(one[column], words), chances(one, classes), _episodes(one))
            for one in (ours[known], theirs[known])
        ]

        def difference(counts: FloatArray, of: Statistic = of) -> FloatArray:
            return np.asarray(of(counts[..., 0, :, :]) - of(counts[..., 1, :, :]))

        per_episode = np.stack(each, axis=1)
        what = f"{'style_' if words is STYLES else ''}{name}_difference"
        rows.append(row_of(keys, what, difference, per_episode, int(known.sum())))
    return rows


SHOWN: Final = {
    "drivers": "drivers", "weighted_accuracy": "accuracy",
    "majority_weighted_accuracy": "majority class", "answered_accuracy": "of answers",
    "balanced_accuracy": "balanced", "macro_f1": "macro F1", "ece": "ECE",
    "style_balanced_accuracy": "style, balanced", "style_auc": "style, AUC",
    "answered_share": "answered", "domain": "domain",
}  # fmt: skip
"""Columns of the table for people, by metric."""

LEGEND: Final = (
    "accuracy: share of drivers whose likeliest behaviour is right; majority class: that of always "
    "naming the commonest; of answers: that of labelled drivers alone.\n"
    "balanced: mean over behaviours; ECE: calibration error; domain: 0 like the training traffic, "
    "1 unlike it; [low, high]: 95 % interval, from three episodes on."
)
"""Text below that table: its columns."""


def scores_table(rows: Sequence[Row], down: Sequence[str] = ("scenario", "split")) -> list[Row]:
    """Rows of `score_answers` for people: a line for each combination of some keys."""

    def cell(row: Row) -> str:
        value, low = float(row["value"] or 0.0), row["low"]
        if row["metric"] == "drivers":
            return f"{value:.0f}"
        if low is not None and row["metric"] in ("weighted_accuracy", "style_auc"):
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
