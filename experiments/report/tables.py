"""One generic way from tidy rows to tables: a line for each thing compared, a column per figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import pandas as pd

from behaviors.labels import BEHAVIORS
from experiments.score.rows import FIGURE, MADE

NAMES: Final = {
    "weighted_accuracy": "accuracy (A_w)",
    "majority_weighted_accuracy": "majority class",
    "answered_accuracy": "accuracy of answers",
    "balanced_accuracy": "balanced accuracy",
    "macro_f1": "macro-F1",
    "style_balanced_accuracy": "style balanced accuracy",
    "style_auc": "style AUC",
    "style_ece": "style calibration error",
    "ece": "calibration error",
    "ade_m": "ADE, m",
    "fde_m": "FDE, m",
    "min_ade_m": "min ADE, m",
    "min_fde_m": "min FDE, m",
    "rmse_m": "RMSE, m",
    "coverage_90": "in 90 % set",
    "cpu_ms": "CPU, ms",
}
"""Names of metrics on a page; others keep their own name."""

FIRST: Final = (
    "weighted_accuracy", "majority_weighted_accuracy", "balanced_accuracy", "macro_f1",
    "style_balanced_accuracy", "style_auc", "ece", "answered_share", "ade_m", "fde_m", "miss_rate",
    "cpu_ms", "ms_median", "score",
)  # fmt: skip
"""Metrics whose columns come first."""

DRAWN: Final = ("confusion", "reliability")
"""Metrics that pictures show and tables do not."""

SUBJECTS: Final = ("method", "model", "predictor", "solver", "policy", "stage", "number", "change")
"""Keys that name what is compared, the first that rows have."""


class Table(NamedTuple):
    """A table of a page: what it shows, the number of cases it rests on, and itself as HTML."""

    title: str
    note: str
    html: str


def name_of(metric: str) -> str:
    """Name of a metric on a page."""
    return NAMES.get(metric, metric.replace("_", " "))


def number(value: float) -> str:
    """A figure as text, with three or four significant digits."""
    if value == int(value) and abs(value) < 1e15:
        return str(int(value))
    if abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.2f}" if abs(value) >= 10 else f"{value:.3g}"


def subject_of(rows: pd.DataFrame) -> str | None:
    """The key that names what is compared; None where there is none."""
    return next((key for key in SUBJECTS if key in rows and rows[key].notna().any()), None)


def varying(rows: pd.DataFrame, without: Sequence[str] = ()) -> list[str]:
    """Keys (but for some) that say what was measured and have several values, in the rows' order.

    Names of things that are compared come last.
    """
    keys = [str(key) for key in rows if key not in (*MADE, *FIGURE, *without)]
    found = [key for key in keys if rows[key].nunique(dropna=False) > 1]
    subject = subject_of(rows)
    return sorted(found, key=lambda key: key == subject)


def tables_of(rows: pd.DataFrame, across: Sequence[str] = ()) -> Iterator[Table]:
    """The tables of the rows of one command; keys in ``across`` get columns beside the metric.

    One table of all drivers for each scenario comes first, then one for each metric that is
    measured by behaviour.
    """
    rows = rows[~rows["metric"].isin(DRAWN)]
    everyone = is_everyone(rows)
    scenario = rows["scenario"] if "scenario" in rows else pd.Series("", index=rows.index)
    for name, part in rows[everyone].groupby(scenario[everyone], sort=False, dropna=False):
        heads = ["metric", *(k for k in ("horizon_s",) if k in varying(part)), *across]
        yield _pivot(part, str(name) or "figures", heads)
    for metric, part in rows[~everyone].groupby("metric", sort=False):
        yield _pivot(part, f"{name_of(str(metric))} by behaviour", ["behavior", *across])


def is_everyone(rows: pd.DataFrame) -> pd.Series[bool]:
    """Whether rows are of all drivers, not of those of one behaviour."""
    if "behavior" not in rows:
        return pd.Series(data=True, index=rows.index)
    return rows["behavior"].isna() | (rows["behavior"] == "all")


def tested(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows that are not of one episode: of the test split where there is one."""
    if "name" in rows:
        rows = rows[rows["name"].isna()]
    if "split" in rows and (rows["split"] == "test").any():
        rows = rows[rows["split"].isna() | (rows["split"] == "test")]
    return rows


def _pivot(rows: pd.DataFrame, title: str, across: Sequence[str]) -> Table:
    """Rows as a table with a column for each value of ``across``; keys of one value are hidden."""
    down = varying(rows, across)
    down = down or ["metric" if "metric" not in across else (subject_of(rows) or "command")]
    frame = rows.assign(cell=[with_interval(row) for row in rows.to_dict("records")])
    frame[down] = frame[down].astype(object).fillna("")
    cells = frame.pivot_table(
        index=down, columns=list(across), values="cell", aggfunc="first", sort=False
    )
    heads = cells.columns.to_frame().to_numpy(object).tolist()
    places = {name: place for place, name in enumerate((*FIRST, *map(str, BEHAVIORS)))}
    first = [min(places.get(word, len(places)) for word in words) for words in heads]
    order = sorted(range(len(heads)), key=lambda at: first[at])
    cells = cells.iloc[:, order]
    cells.columns = pd.Index([", ".join(map(_head, heads[at])) for at in order])
    n = rows["n"].dropna().astype(int)
    many = "" if n.empty else f"n = {n.min()}" + (f" to {n.max()}" if n.max() > n.min() else "")
    intervals = "in brackets: 95 % intervals" if rows["low"].notna().any() else ""
    text = str(cells.to_html(border=0, na_rep="", index_names=True, escape=True))
    return Table(title, "; ".join(part for part in (many, intervals) if part), text)


def _head(word: Any) -> str:
    return f"{word:g} s" if isinstance(word, float) else name_of(str(word))


def with_interval(row: Mapping[Any, Any]) -> str:
    """The figure of a tidy row as text, with its interval where it has one."""
    if pd.isna(row["value"]):
        return "-"
    value = number(float(row["value"]))
    if pd.isna(row["low"]):
        return value
    return f"{value} [{number(row['low'])}, {number(row['high'])}]"
