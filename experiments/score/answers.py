"""Scores of answers about drivers, for every source and format.

Scores are of the likeliest behaviour of every driver; the share of drivers with an answer is a
separate figure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS, Style
from experiments.score.metrics import (
    FloatArray,
    IntArray,
    Statistic,
    auc_over_episodes,
    balanced_accuracy,
    bootstrap,
    calibration_error,
    confusion,
    macro_f1,
    ratio,
    recall_of,
    reliability,
    summed,
    weighted_accuracy,
)
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.posterior import aggressive_share

STYLES: Final = (Style.AGGRESSIVE, Style.CONSERVATIVE)

STYLE_OF: Final = np.array([STYLES.index(b.style) for b in BEHAVIORS])
"""(6,) code of each behaviour's style."""

ALL: Final = "all"
"""The scenario or split of rows over several of them."""


@dataclass(frozen=True, slots=True)
class Answers:
    """Answers about some drivers, and their true labels.

    Attributes:
        episode: (n,) number of the episode.
        probability: (n, 6) of each behaviour.
        truth: (n,) codes into ``BEHAVIORS``, -1 where not known.
        style: (n,) codes into ``STYLES``, -1 where not known.
        answered: (n,) whether a behaviour is likely enough to be an answer.
        domain: (n,) 0 in simulated traffic, 1 in other traffic.
    """

    episode: IntArray
    probability: FloatArray
    truth: NDArray[np.int64]
    style: NDArray[np.int64]
    answered: NDArray[np.bool_]
    domain: FloatArray

    @classmethod
    def known(
        cls, probability: FloatArray, truth: NDArray[np.integer[Any]], episode: IntArray
    ) -> Answers:
        """Answers that are always given, about drivers whose behaviour is known.

        Args:
            probability: (n, 6) posteriors.
            truth: (n,) codes into ``BEHAVIORS``, -1 where not known.
            episode: (n,) episode numbers.

        Returns:
            The answers.
        """
        n, codes = len(probability), truth.astype(np.int64)
        style = np.where(codes >= 0, STYLE_OF[codes], -1)
        return cls(episode, probability, codes, style, np.ones(n, dtype=bool), np.zeros(n))

    @classmethod
    def of_tables(cls, tables: Sequence[pa.Table]) -> Answers:
        """The answers of some episodes, from tables with the columns of a labels file.

        Args:
            tables: one of each episode, with a row per driver.

        Returns:
            The answers.
        """
        table = pa.concat_tables(tables)
        columns = [table[f"p_{b.value}"].to_numpy() for b in BEHAVIORS]
        return cls(
            episode=np.repeat(np.arange(len(tables)), [t.num_rows for t in tables]),
            probability=np.stack(columns, axis=1).astype(np.float64),
            truth=_codes(table["truth"], BEHAVIORS),
            style=_codes(table["true_style"], STYLES),
            answered=pc.is_valid(table["behavior"]).to_numpy(),
            domain=table["domain"].to_numpy().astype(np.float64),
        )

    def where(self, chosen: NDArray[np.bool_]) -> Answers:
        """The answers for which ``chosen`` (n,) holds."""
        return Answers(*(getattr(self, name)[chosen] for name in self.__slots__))

    @property
    def likeliest(self) -> IntArray:
        """(n,) codes of the most likely behaviours."""
        return np.asarray(self.probability.argmax(axis=1), dtype=np.int64)

    @property
    def counts(self) -> FloatArray:
        """(E, 6, 6) confusion matrices of behaviours."""
        return confusion(self.truth, self.likeliest, self.episode)

    @property
    def style_counts(self) -> FloatArray:
        """(E, 2, 2) confusion matrices of styles, by the larger sum of probabilities."""
        answer = (aggressive_share(self.probability) < 0.5).astype(np.int64)
        return confusion(self.style, answer, self.episode, len(STYLES))


def _codes(words: pa.ChunkedArray, known: Sequence[str]) -> NDArray[np.int64]:
    codes = pc.fill_null(pc.index_in(words, value_set=pa.array(known, pa.string())), -1)
    return np.asarray(codes.to_numpy(), dtype=np.int64)


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

    def share(name: str, part: NDArray[Any], **extra: Cell) -> Row:
        found = bootstrap(ratio, summed(episode, part, np.ones(n)))
        return tidy_row({**keys, **extra}, name, *found, n)

    rows.append(share("answered_share", answers.answered))
    rows.append(share("domain", answers.domain))
    rows.append(share("confidence", answers.probability.max(axis=1)))
    if breakdown:
        answer = np.where(answers.answered, answers.likeliest, -1)
        rows += [share("named_share", answer == b.code, behavior=b.value) for b in BEHAVIORS]
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
    truth, episode, n, counts = answers.truth, answers.episode, answers.truth.size, answers.counts
    constant = np.full(n, np.bincount(truth).argmax() if majority is None else majority)
    bins = reliability(truth, answers.probability, episode)
    right = summed(episode, answers.answered & (answers.likeliest == truth), answers.answered)
    measured: list[tuple[str, Statistic, FloatArray, int]] = [
        ("weighted_accuracy", weighted_accuracy, counts, n),
        ("majority_weighted_accuracy", weighted_accuracy, confusion(truth, constant, episode), n),
        ("answered_accuracy", ratio, right, int(answers.answered.sum())),
        ("balanced_accuracy", balanced_accuracy, counts, n),
        ("macro_f1", macro_f1, counts, n),
        ("ece", calibration_error, bins, n),
    ]
    for name, statistic, per_episode, count in measured:
        if count:
            yield tidy_row(keys, name, *bootstrap(statistic, per_episode), count)
    total = counts.sum(axis=0)
    for behavior in BEHAVIORS:
        own, row = int(total[behavior.code].sum()), {**keys, "behavior": behavior.value}
        if own:
            yield tidy_row(row, "recall", *bootstrap(recall_of(behavior.code), counts), own)
        for other in BEHAVIORS if breakdown else ():
            taken = float(total[behavior.code, other.code])
            yield tidy_row({**row, "answer": other.value}, "confusion", taken, n=own)
    for number, (count, sure, _) in enumerate(bins.sum(axis=0) if breakdown else ()):
        if count:
            row = {**keys, "confidence": round(float(sure / count), 4)}
            found = bootstrap(ratio, bins[:, number, [2, 0]])
            yield tidy_row(row, "reliability", *found, int(count))


def _style_rows(answers: Answers, keys: Mapping[str, Cell], majority: int | None) -> Iterator[Row]:
    """Rows about drivers whose style is known, with or without their behaviour."""
    truth, episode, n = answers.style, answers.episode, answers.style.size
    counts = answers.style_counts
    aggressive = aggressive_share(answers.probability)
    constant = np.full(n, np.bincount(truth).argmax() if majority is None else STYLE_OF[majority])
    bins = reliability(truth, np.stack([aggressive, 1.0 - aggressive], axis=1), episode)
    measured: list[tuple[str, Statistic, FloatArray]] = [
        ("style_accuracy", weighted_accuracy, counts),
        ("majority_style_accuracy", weighted_accuracy,
         confusion(truth, constant, episode, len(STYLES))),
        ("style_balanced_accuracy", balanced_accuracy, counts),
        ("style_ece", calibration_error, bins),
    ]  # fmt: skip
    for name, statistic, per_episode in measured:
        yield tidy_row(keys, name, *bootstrap(statistic, per_episode), n)
    yield tidy_row(keys, "style_auc", *auc_over_episodes(aggressive, truth == 0, episode), n)


def score_places(parts: Iterable[tuple[str, str, pa.Table]], keys: Mapping[str, Cell]) -> list[Row]:
    """Score the answers of many episodes by scenario and split, and over all of either.

    Args:
        parts: scenario, split and the last answers of each episode, see `Answers.of_tables`.
        keys: what was measured, for the rows.

    Returns:
        Rows as from `score_answers` with ``scenario`` and ``split``; these are "all" over several.
    """
    found = [part for part in parts if part[2].num_rows]
    scenarios = list(dict.fromkeys(scenario for scenario, _, _ in found))
    splits = [s for s in ("train", "validation", "test") if any(s == x for _, x, _ in found)]
    rows: list[Row] = []
    for split in [*splits, *([ALL] if len(splits) > 1 else [])]:
        for scenario in [*scenarios, *([ALL] if len(scenarios) > 1 else [])]:
            tables = [t for a, b, t in found if scenario in (ALL, a) and split in (ALL, b)]
            if tables:
                place = {**keys, "scenario": scenario, "split": split}
                rows += score_answers(Answers.of_tables(tables), place)
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
    """Scores for people.

    Args:
        rows: from `score_answers`.
        down: keys that distinguish lines.

    Returns:
        A line for each combination of values of these keys.
    """
    lines: dict[tuple[Cell, ...], dict[str, Cell]] = {}
    for row in rows:
        name = SHOWN.get(str(row["metric"]))
        if name is None or row["value"] is None:
            continue
        place = {key: row.get(key) for key in down}
        line = lines.setdefault(tuple(place.values()), place)
        value, low, high = row["value"], row["low"], row["high"]
        line[name] = f"{value:.0f}" if name == "drivers" else f"{value:.2f}"
        if low is not None and row["metric"] in WITH_INTERVAL:
            line[name] = f"{value:.2f} [{low:.2f}, {high:.2f}]"
    order = [*down, *SHOWN.values()]
    return [{k: line[k] for k in order if k in line} for line in lines.values()]


def confusion_table(rows: Sequence[Row]) -> list[Row]:
    """How often each behaviour gets each answer, in the last group of rows that says so.

    Args:
        rows: from `score_answers`; of the test split where there is one.

    Returns:
        A line for each true behaviour, with counts of answers.
    """
    counted = [row for row in rows if row["metric"] == "confusion" and row["n"]]
    counted = [row for row in counted if row.get("split") == "test"] or counted
    lines: dict[Cell, dict[str, Cell]] = {}
    for row in counted:  # later groups are over more scenarios and replace earlier ones
        line = lines.setdefault(row["behavior"], {"true behaviour": row["behavior"]})
        line[str(row["answer"])] = int(row["value"] or 0)
    return list(lines.values())


def is_scored(rows: Iterable[Row]) -> bool:
    """Whether anything is known of any driver that was scored."""
    return any(row["metric"] == "style_accuracy" for row in rows)
