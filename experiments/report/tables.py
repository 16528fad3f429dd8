"""Turns rows into the tables of a report.

A table has a line for each thing that is compared and a column for each figure, with its interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from experiments.rows import Row

_NAMES: Final = {
    "weighted_accuracy": "accuracy (A_w)",
    "majority_weighted_accuracy": "majority class",
    "balanced_accuracy": "balanced accuracy",
    "macro_f1": "macro-F1",
    "style_balanced_accuracy": "style balanced accuracy",
    "told_accuracy": "accuracy where told",
    "style_auc": "style AUC",
    "style_ece": "calibration error of the style",
    "unknown_share": "unknown",
    "ece": "calibration error",
    "ade_m": "ADE, m",
    "fde_m": "FDE, m",
    "min_ade_m": "min ADE, m",
    "min_fde_m": "min FDE, m",
    "rmse_m": "RMSE, m",
    "miss_rate": "miss rate",
    "coverage_90": "in 90 % set",
    "cpu_ms": "CPU, ms",
    "ms_per_frame": "ms per frame",
    "agent_steps_per_s": "agent-steps/s",
}
"""What metrics are called on a page; those that are not listed keep their own name."""

_LESS: Final = frozenset(
    {
        "ade_m", "fde_m", "min_ade_m", "min_fde_m", "rmse_m", "miss_rate", "brier_min_fde_m", "nll",
        "collisions", "off_road", "ece", "style_ece", "unknown_share", "cpu_ms", "wall_ms",
        "ms_per_frame", "ms_median", "ms_p99",
        "bytes_per_agent_step",
    }
)  # fmt: skip
"""Metrics of which a smaller value is better."""

_MORE: Final = frozenset(
    {
        "weighted_accuracy", "balanced_accuracy", "macro_f1", "style_balanced_accuracy", "auc",
        "yield_auc", "wait_auc", "agent_steps_per_s", "speedup", "real_time_factor",
    }
)  # fmt: skip
"""Metrics of which a larger value is better."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One figure of a table.

    Attributes:
        value: the figure as text; "" where it was not measured.
        interval: its 95 % interval as text; "" where there is none.
        best: whether it is the best of its column.
        expected: whether the largest figure of the line is expected here: the right answer in a
            confusion matrix, or the behaviour to which the paper assigns a trait.
    """

    value: str
    interval: str = ""
    best: bool = False
    expected: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a page.

    Attributes:
        title: the heading above the table.
        caption: what holds for all of its figures: split, number of cases, meaning of bold type.
        corner: the heading of the first column, which names the lines.
        columns: the headings of the other columns.
        rows: for each line its name and its cells.
    """

    title: str
    caption: str
    corner: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


def name_of(metric: str) -> str:
    """What a metric is called on a page."""
    return _NAMES.get(metric, metric.replace("_", " "))


def words(value: object) -> str:
    """The value of a key as text."""
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value is None or value == "" else str(value)


def number_or_none(value: object) -> float | None:
    """The value of a row as a number; None where it has none."""
    return float(value) if isinstance(value, int | float) else None


def grouped(rows: Sequence[Row], keys: Sequence[str]) -> dict[tuple[str, ...], list[Row]]:
    """Rows grouped by the values of some keys, in the order in which the values first appear."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(words(row.get(k)) for k in keys), []).append(row)
    return groups


def number(value: float) -> str:
    """A figure as text, with three or four significant digits.

    Examples:
        >>> [number(x) for x in (0.51249, 12.3456, 1234.5, 0.00012, 3, 0.0)]
        ['0.512', '12.35', '1234', '0.00012', '3', '0']
    """
    if value == 0 or (abs(value) < 1e15 and value == int(value)):
        return str(int(value))
    if abs(value) >= 100:
        return f"{value:.0f}"
    if abs(value) >= 10:
        return f"{value:.2f}"
    return f"{value:.3f}" if abs(value) >= 0.01 else f"{value:.2g}"


def pivot(rows: Sequence[Row], title: str, down: Sequence[str], across: Sequence[str]) -> Table:
    """Arrange rows as a table.

    Args:
        rows: the rows to show. They differ in no other keys than those of ``down`` and ``across``.
        title: the heading above the table.
        down: keys whose values distinguish the lines.
        across: keys whose values distinguish the columns; ``metric`` may be one of them.

    Returns:
        The table. Keys of ``down`` that have the same value in all lines are not shown. Its caption
        says the number of cases, and what intervals and bold figures mean if there are any.
    """
    varying = [k for k in down if len({words(r.get(k)) for r in rows}) > 1] or list(down[:1])
    lines = list(dict.fromkeys(tuple(_line(k, r) for k in varying) for r in rows))
    heads = _in_order([tuple(_head(k, r) for k in across) for r in rows])
    found = {
        (tuple(_line(k, r) for k in varying), tuple(_head(k, r) for k in across)): r for r in rows
    }
    # Nothing is the best of figures that were measured on different data.
    alike = not {"scenario", "split"} & set(varying)
    best: dict[tuple[str, ...], float] = {}
    for head in heads if alike else ():
        column = [found[line, head] for line in lines if (line, head) in found]
        metric = str(column[0]["metric"])
        fair = [_value(r) for r in column if "majority" not in words(r.get("method"))]
        if "metric" in across and len(fair) > 1 and metric in _LESS | _MORE:
            best[head] = min(fair) if metric in _LESS else max(fair)
    body = tuple(
        (
            ", ".join(line),
            tuple(
                _cell(found[line, head], best.get(head)) if (line, head) in found else Cell("")
                for head in heads
            ),
        )
        for line in lines
    )
    counts = [int(n) for r in rows if isinstance(n := r.get("n"), int)]
    many = (
        ""
        if not counts
        else f"n = {min(counts)}" + (f" to {max(counts)}" if max(counts) > min(counts) else "")
    )
    split = {str(r["split"]) for r in rows if r.get("split") and "split" not in varying}
    cells = [cell for _, line in body for cell in line]
    said = [
        *(f"split: {s}" for s in sorted(split)),
        many,
        "small: 95 % intervals" if any(cell.interval for cell in cells) else "",
        "bold: best of its column" if any(cell.best for cell in cells) else "",
    ]
    return Table(
        title,
        "; ".join(part for part in said if part),
        ", ".join(k.replace("_", " ").removesuffix(" s") for k in varying),
        tuple(" ".join(part for part in head if part) for head in heads),
        body,
    )


def _in_order(heads: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Each heading once, sorted by its first part, then by the second.

    The parts are in the order in which they first appear.
    """
    places = [list(dict.fromkeys(part)) for part in zip(*heads, strict=True)]
    return sorted(
        set(heads), key=lambda head: [p.index(w) for p, w in zip(places, head, strict=True)]
    )


def _line(key: str, row: Row) -> str:
    value = row.get(key)
    return name_of(str(value)) if key == "metric" else words(value)


def _head(key: str, row: Row) -> str:
    value = row.get(key)
    if key == "metric":
        return name_of(str(value))
    if key == "horizon_s":
        return "" if value is None else f"at {words(value)} s"
    return f"{key} {words(value)}" if key == "d" else words(value)


def _value(row: Row) -> float:
    value = row["value"]
    assert isinstance(value, int | float)
    return float(value)


def _cell(row: Row, best: float | None) -> Cell:
    value, low, high = _value(row), row.get("low"), row.get("high")
    interval = ""
    if isinstance(low, int | float) and isinstance(high, int | float):
        interval = f"{number(float(low))} – {number(float(high))}"
    fair = "majority" not in words(row.get("method"))
    return Cell(number(value), interval, fair and best is not None and value == best)
