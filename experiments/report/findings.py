"""Statements of figures in sentences, good or bad."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pandas as pd

from experiments.report.tables import is_everyone, subject_of, tested

PAPER: Final = "graphrqi"
"""The method of the paper."""

PAIRS: Final = (("constant-velocity", "graphrqi-predict"), ("car-following-blind", "car-following"))
"""Predictors that are compared, the simpler one first."""


def findings(rows: pd.DataFrame) -> list[str]:
    """Sentences by scenario on the scores of drivers and on predictions in tidy rows."""
    if "scenario" not in rows:
        return []
    rows = tested(rows[is_everyone(rows)])
    return [
        f"{scenario}: {sentence}"
        for scenario, part in rows.groupby("scenario", sort=False)
        for sentence in (*_answers(part), *_predictions(part))
    ]


def _answers(rows: pd.DataFrame) -> Iterator[str]:
    scored = rows[rows["metric"] == "weighted_accuracy"]
    subject = None if scored.empty else subject_of(scored)
    if subject is None:
        return
    figures = rows.pivot_table("value", subject, "metric", aggfunc="last")
    best = figures.loc[figures["weighted_accuracy"].idxmax()]
    yield (
        f"{best.name} names the right behaviour in {100 * best['weighted_accuracy']:.0f} % of all "
        f"cases (majority class {100 * best['majority_weighted_accuracy']:.0f} %) and the right "
        f"style in {100 * best['style_balanced_accuracy']:.0f} % (balanced)."
    )
    if PAPER in figures.index and best.name != PAPER:
        paper = figures.loc[PAPER]
        lift = paper["weighted_accuracy"] - paper["majority_weighted_accuracy"]
        yield (
            "rows of the eigenvector matrix alone, as in the paper, are "
            f"{'above' if lift > 0 else 'below'} the majority class in accuracy by "
            f"{100 * abs(lift):.1f} percentage points, with macro-F1 {paper['macro_f1']:.2f} "
            "(chance is about 0.17)."
        )


def _predictions(rows: pd.DataFrame) -> Iterator[str]:
    scored = rows[rows["metric"] == "ade_m"]
    if scored.empty or "predictor" not in scored:
        return
    horizon_s = float(scored["horizon_s"].max())
    error = scored[scored["horizon_s"] == horizon_s].groupby("predictor")["value"].last()
    for plain, ours in PAIRS:
        if plain in error and ours in error:
            change = 100 * (1 - error[ours] / error[plain])
            yield (
                f"the mean displacement error of {ours} over {horizon_s:g} s is "
                f"{abs(change):.1f} % {'smaller' if change > 0 else 'larger'} than that of {plain} "
                f"({error[ours]:.2f} m against {error[plain]:.2f} m)."
            )
