"""One generic way from tidy rows to pictures: lines over a number, bars, and confusion matrices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from behaviors.labels import BEHAVIORS, COLORS, UNKNOWN_COLOR
from experiments.report.tables import FIRST, is_everyone, name_of, subject_of, tested, varying

CYCLE: Final = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", UNKNOWN_COLOR)
"""Colours of series that are not behaviours: the scheme "bright" of Tol (2021, SRON technical note
EPS/TN/09-002), distinguishable with a colour weakness."""

NUMBERS: Final = ("horizon_s", "window_s", "d", "agents", "vehicles", "lanes", "confidence", "jobs")
"""Keys that lines are drawn over, the first that has several values."""

LOGARITHMIC: Final = frozenset({"d", "agents", "vehicles"})
"""Those of `NUMBERS` that count in powers of ten, as do the values over them."""

SIZE_IN: Final = (5.2, 3.6)
"""Width and height of a picture, inches."""


class Picture(NamedTuple):
    """A picture of a page: what it shows, and the drawing."""

    title: str
    figure: Figure


def pictures_of(rows: pd.DataFrame) -> Iterator[Picture]:
    """The pictures of the rows of one command.

    The first of the metrics `FIRST` is shown over a number or as bars. Reliability and confusion
    matrices follow where rows have them.
    """
    metric = next((name for name in FIRST if (rows["metric"] == name).any()), None)
    if metric is not None:
        chosen = rows[rows["metric"] == metric]
        chosen = chosen[is_everyone(chosen)]
        over = next((key for key in NUMBERS if key in varying(chosen)), None)
        for title, part in _parts(chosen, over):
            yield _lines(title, part, over) if over else _bars(title, part)
    for title, part in _parts(tested(rows[rows["metric"] == "reliability"]), "confidence"):
        yield _lines(title, part, "confidence")
    for title, part in _parts(tested(rows[rows["metric"] == "confusion"]), "behavior", True):
        yield _confusion(title, part)


def _parts(
    rows: pd.DataFrame, over: str | None, each_subject: bool = False
) -> Iterator[tuple[str, pd.DataFrame]]:
    """The rows of each picture, with a title; what is compared shares a picture."""
    if rows.empty:
        return
    apart = [over or "", "answer", *(() if each_subject else (subject_of(rows) or "",))]
    keys = varying(rows, apart)
    metric = name_of(str(rows["metric"].iloc[0]))
    if not keys:
        yield metric, rows
        return
    for values, part in rows.groupby(keys, sort=False, dropna=False):
        yield f"{', '.join(str(v) for v in values)}: {metric}", part


def color_of(name: str, place: int) -> str:
    """The colour of a behaviour, or for anything else the next colour that no behaviour has."""
    return COLORS.get(name) or CYCLE[place % len(CYCLE)]


def _axes() -> tuple[Figure, Axes]:
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _lines(title: str, rows: pd.DataFrame, over: str) -> Picture:
    """A line with its interval for each thing compared, over a number."""
    figure, axes = _axes()
    subject = subject_of(rows)
    groups: Any = [("", rows)] if subject is None else rows.groupby(subject, sort=False)
    for place, (name, part) in enumerate(groups):
        line = part.sort_values(over).drop_duplicates(over)
        color = color_of(str(name), place)
        x, y = line[over].astype(float), line["value"].astype(float)
        axes.plot(x, y, marker="o", markersize=4, color=color, label=str(name) or None)
        axes.fill_between(x, line["low"], line["high"], color=color, alpha=0.16, linewidth=0)
    if over == "confidence":
        axes.plot([0, 1], [0, 1], "--", color="#8C8C8C", linewidth=1, label="as sure as right")
    elif over in LOGARITHMIC:
        axes.set(xscale="log", yscale="log")
    else:
        axes.set_ylim(bottom=min(0.0, float(rows["value"].min())))
    axes.set(xlabel=over.replace("_s", ", s"), ylabel=name_of(str(rows["metric"].iloc[0])))
    axes.grid(axis="y", linewidth=0.5)
    figure.legend(loc="outside lower left", ncols=2, frameon=False, fontsize=8)
    return Picture(title, figure)


def _bars(title: str, rows: pd.DataFrame) -> Picture:
    """A bar with its interval for each thing compared."""
    figure, axes = _axes()
    subject = subject_of(rows) or "metric"
    bars = rows.drop_duplicates(subject)
    names, values = bars[subject].astype(str), bars["value"].astype(float)
    away = np.stack([values - bars["low"], bars["high"] - values]).astype(float)
    colors = [color_of(name, place) for place, name in enumerate(names)]
    axes.barh(names, values, color=colors, xerr=np.clip(np.nan_to_num(away), 0.0, None))
    axes.invert_yaxis()
    axes.set_xlabel(name_of(str(rows["metric"].iloc[0])))
    return Picture(title, figure)


def _confusion(title: str, rows: pd.DataFrame) -> Picture:
    """A confusion matrix in per cent of each true behaviour."""
    figure, axes = _axes()
    names = [str(b) for b in BEHAVIORS]
    counts = rows.pivot_table(index="behavior", columns="answer", values="value", aggfunc="sum")
    counts = counts.reindex(index=names, columns=names).fillna(0.0)
    total = counts.sum(axis=1)
    share = (100.0 * counts.div(total.where(total > 0), axis=0)).to_numpy()
    axes.imshow(np.nan_to_num(share), cmap="Blues", vmin=0, vmax=100)
    for (row, column), value in np.ndenumerate(share):
        if np.isfinite(value):
            color = "white" if value > 55 else "black"
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", color=color)
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
    axes.set_yticks(range(len(names)), [f"{b} ({total[b]:.0f})" for b in names])
    axes.set(xlabel="answer, % of each row", ylabel="true behaviour (drivers)")
    return Picture(title, figure)
