"""Rows of a method's answers: scores, calibration, and paired differences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.benches.classification.recordings import FloatArray
from experiments.score.metrics import (
    METRICS,
    Statistic,
    bootstrap,
    calibration_error,
    confusion,
    recall_of,
    reliability,
    weighted_accuracy,
)
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.classify import Classifier
from graphrqi.methods import Model
from graphrqi.samples import Samples


def keys_of(
    protocol: str, scenario: str, method: str, window_s: float | None, variation: str = ""
) -> dict[str, Cell]:
    """What a row says was measured; an infinite window is a driver's whole life."""
    if window_s is not None and not np.isfinite(window_s):
        window_s, variation = None, ", ".join(filter(None, ("whole life", variation)))
    return {
        "protocol": protocol,
        "scenario": scenario,
        "method": method,
        "window_s": window_s,
        "variation": variation,
    }


def posterior(model: Model | Classifier, samples: Samples) -> FloatArray:
    """(n, 6) the answers of a model or classifier to samples."""
    return model.posterior(samples.features.astype(np.float64))


def as_long_as(samples: Samples, window_s: float) -> NDArray[np.bool_]:
    """Which samples were observed for this long."""
    return np.asarray(samples.window_s == window_s)


def score_rows(
    samples: Samples, probability: FloatArray, majority: int, keys: Mapping[str, Cell]
) -> list[Row]:
    """Rows of every metric of one method's answers."""
    matrices = {
        name: confusion(samples.codes, answer(probability), samples.episode)
        for name, (answer, _) in METRICS.items()
    }
    constant = confusion(samples.codes, np.full(len(samples), majority), samples.episode)
    bins = reliability(samples.codes, probability, samples.episode)
    values = {name: bootstrap(metric, matrices[name]) for name, (_, metric) in METRICS.items()}
    values["majority_weighted_accuracy"] = bootstrap(weighted_accuracy, constant)
    values["ece"] = bootstrap(calibration_error, bins)
    for code in np.unique(samples.codes):
        values[f"recall_{BEHAVIORS[code].value}"] = bootstrap(recall_of(code), matrices["macro_f1"])
    return [tidy_row(keys, metric, *value, len(samples)) for metric, value in values.items()]


def reliability_rows(
    samples: Samples, probability: FloatArray, keys: Mapping[str, Cell]
) -> list[Row]:
    """How often answers given with each confidence are right."""
    bins = reliability(samples.codes, probability, samples.episode)
    edges = np.linspace(0.0, 1.0, bins.shape[1] + 1)
    rows = []
    for number in np.flatnonzero(bins[..., 0].sum(axis=0)):
        value = bootstrap(_share_right, bins[:, number])
        about = f"confidence {edges[number]:.2f} to {edges[number + 1]:.2f}"
        n = int(bins[:, number, 0].sum())
        rows.append(tidy_row({**keys, "variation": about}, "share_right", *value, n))
    return rows


def _share_right(counts: FloatArray) -> FloatArray:
    """(...) of answers, confidences and right answers (..., 3); NaN where there is no answer."""
    with np.errstate(invalid="ignore"):
        return np.asarray(counts[..., 2] / counts[..., 0])


def difference_rows(
    samples: Samples, ours: FloatArray, theirs: FloatArray, keys: Mapping[str, Cell]
) -> list[Row]:
    """How much better ours is, on the same windows, with a paired interval."""
    rows = []
    for name in ("macro_f1", "style_balanced_accuracy"):
        answer, metric = METRICS[name]
        pair = np.stack(
            [confusion(samples.codes, answer(p), samples.episode) for p in (ours, theirs)], axis=1
        )

        def statistic(counts: FloatArray, metric: Statistic = metric) -> FloatArray:
            both = metric(counts)
            return np.asarray(both[..., 0] - both[..., 1])

        value = bootstrap(statistic, pair)
        rows.append(tidy_row(keys, f"{name}_difference", *value, len(samples)))
    return rows
