"""Statements of figures in sentences, good or bad."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pandas as pd

from experiments.report.tables import is_everyone, subject_of

PAPER: Final = "graphrqi"
"""The method of the paper."""

PAIRS: Final = (("constant-velocity", "graphrqi-predict"), ("car-following-blind", "car-following"))
"""Predictors that are compared, the simpler one first."""


def findings(rows: pd.DataFrame) -> list[str]:
    """Sentences by scenario on the scores of drivers and on predictions in tidy rows."""
    if "scenario" not in rows:
        return []
    rows = rows[is_everyone(rows)]
    if "split" in rows and (rows["split"] == "test").any():
        rows = rows[rows["split"].isna() | (rows["split"] == "test")]
    if "name" in rows:
        rows = rows[rows["name"].isna()]
    return [
        f"{scenario}: {sentence}"
        for scenario, part in rows.groupby("scenario", sort=False)
        for sentence in (*_answers(part), *_predictions(part))
    ]


def _values(rows: pd.DataFrame, subject: str, metric: str) -> dict[str, float]:
    chosen = rows[rows["metric"] == metric].dropna(subset=[subject])
    return dict(zip(chosen[subject], chosen["value"].astype(float), strict=True))


def _answers(rows: pd.DataFrame) -> Iterator[str]:
    scored = rows[rows["metric"] == "weighted_accuracy"]
    subject = None if scored.empty else subject_of(scored)
    if subject is None:
        return
    accuracy, style, f1, majority = (
        _values(rows, subject, metric)
        for metric in (
            "weighted_accuracy", "style_balanced_accuracy", "macro_f1",
            "majority_weighted_accuracy",
        )
    )  # fmt: skip
    best = max(accuracy, key=lambda name: accuracy[name])
    yield (
        f"{best} names the right behaviour in {100 * accuracy[best]:.0f} % of all cases (majority "
        f"class {100 * majority[best]:.0f} %) and the right style in {100 * style[best]:.0f} % "
        "(balanced)."
    )
    if PAPER in accuracy and best != PAPER:
        lift = accuracy[PAPER] - majority[PAPER]
        yield (
            "rows of the eigenvector matrix alone, as in the paper, are "
            f"{'above' if lift > 0 else 'below'} the majority class in accuracy by "
            f"{100 * abs(lift):.1f} percentage points, with macro-F1 {f1[PAPER]:.2f} (chance is "
            "about 0.17)."
        )


def _predictions(rows: pd.DataFrame) -> Iterator[str]:
    scored = rows[rows["metric"] == "ade_m"]
    if scored.empty or "predictor" not in scored:
        return
    horizon_s = float(scored["horizon_s"].max())
    error = _values(scored[scored["horizon_s"] == horizon_s], "predictor", "ade_m")
    for plain, ours in PAIRS:
        if plain in error and ours in error:
            change = 100 * (1 - error[ours] / error[plain])
            yield (
                f"the mean displacement error of {ours} over {horizon_s:g} s is "
                f"{abs(change):.1f} % {'smaller' if change > 0 else 'larger'} than that of {plain} "
                f"({error[ours]:.2f} m against {error[plain]:.2f} m)."
            )
