"""The confusion matrices and reliability charts of an evaluation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from behaviors.labels import BEHAVIORS
from experiments.report.charts import Axis, Chart, Line, Point
from experiments.report.tables import grouped, number_or_none
from experiments.rows import Row

DRAWN: Final = frozenset({"confusion", "reliability"})
"""Metrics that are drawn and stand in no table."""


@dataclass(frozen=True, slots=True)
class Confusion:
    """A confusion matrix in per cent of each true behaviour.

    Attributes:
        title: whose answers.
        rows: true behaviour, how many cases, and the share of each answer, 0 to 100.
    """

    title: str
    rows: tuple[tuple[str, int, tuple[float, ...]], ...]


def confusion_of(matrix: Sequence[Sequence[int]], title: str) -> Confusion:
    """Rows are true behaviours, columns answers; each row adds to 100 %."""
    return Confusion(
        title,
        tuple(
            (str(b), sum(row), tuple(100 * count / max(sum(row), 1) for count in row))
            for b, row in zip(BEHAVIORS, matrix, strict=True)
        ),
    )


def _parts(rows: Iterable[Row], metric: str) -> dict[str, list[Row]]:
    """The rows of a metric by model, scenario and split, in words.

    Of a model that has a test split, only that: it knows the drivers that it was trained on.
    """
    wanted = [row for row in rows if row["metric"] == metric]
    tested = {row.get("model") for row in wanted if row.get("split") == "test"}
    shown = [r for r in wanted if r.get("model") not in tested or r.get("split") == "test"]
    keys = ("model", "scenario", "split")
    parts = {}
    for values, part in grouped(shown, keys).items():
        named = zip(keys, values, strict=True)
        title = ", ".join(f"all {k}s" if word == "all" else word for k, word in named)
        parts[title] = part
    return parts


def confusions(rows: Iterable[Row]) -> list[Confusion]:
    """A matrix for each model, scenario and split of an evaluation."""
    found = []
    place = {behavior.value: number for number, behavior in enumerate(BEHAVIORS)}
    for title, part in _parts(rows, "confusion").items():
        matrix = [[0] * len(BEHAVIORS) for _ in BEHAVIORS]
        for row in part:
            true, answer = place.get(str(row.get("behavior"))), place.get(str(row.get("answer")))
            value = row["value"]
            if true is not None and answer is not None and isinstance(value, int | float):
                matrix[true][answer] = max(int(value), 0)
        found.append(confusion_of(matrix, title))
    return found


def reliability_charts(rows: Iterable[Row]) -> list[Chart]:
    """How often answers of each confidence are right, for each model, scenario and split."""
    charts = []
    even = Line("as often as claimed", (Point(0.0, 0.0), Point(1.0, 1.0)), thin=True)
    for title, part in _parts(rows, "reliability").items():
        points = [
            Point(x, y, number_or_none(row.get("low")), number_or_none(row.get("high")))
            for row in part
            if (x := number_or_none(row.get("confidence"))) is not None
            and (y := number_or_none(row["value"])) is not None
        ]
        if points:
            line = Line("answers", tuple(sorted(points, key=lambda p: p.x)))
            sure, right = Axis("confidence", high=1.0), Axis("share right", high=1.05)
            said = f"{title}: how often answers of each confidence are right"
            charts.append(Chart(said, sure, right, (line, even)))
    return charts
