"""Rows of a classifier's answers; the only place of the benchmark that asks for scores."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.benchmarks.statistics import majority_of
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
from graphrqi.samples import Samples
from sim.frames import FloatArray

__all__ = ["difference_rows", "keys_of", "majority_of", "score_rows"]


def keys_of(
    protocol: str, scenario: str, method: str, window_s: float | None, variation: str = ""
) -> dict[str, Cell]:
    """What a row says was measured; an infinite window is a driver's whole track.

    Examples:
        >>> keys_of("inductive", "city", "svm", float("inf"))["variation"]
        'whole track'
    """
    if window_s is not None and not np.isfinite(window_s):
        window_s, variation = None, ", ".join(filter(None, ("whole track", variation)))
    return {
        "protocol": protocol, "scenario": scenario, "method": method, "window_s": window_s,
        "variation": variation,
    }  # fmt: skip


def score_rows(
    samples: Samples, probability: FloatArray, majority: int, keys: Mapping[str, Cell]
) -> list[Row]:
    """Rows of every metric of one method's answers, with intervals over episodes.

    Args:
        samples: n, with the truth.
        probability: (n, 6) the answers.
        majority: the most frequent class of the training data, whose accuracy stands beside.
        keys: what was measured.
    """
    if not len(samples):
        return []
    truth, episode = samples.codes, samples.episode
    matrices = {
        name: confusion(truth, answer(probability), episode)
        for name, (answer, _) in METRICS.items()
    }
    constant = confusion(truth, np.full(len(samples), majority), episode)
    values = {name: bootstrap(metric, matrices[name]) for name, (_, metric) in METRICS.items()}
    values["majority_weighted_accuracy"] = bootstrap(weighted_accuracy, constant)
    values["ece"] = bootstrap(calibration_error, reliability(truth, probability, episode))
    for code in np.unique(truth):
        values[f"recall_{BEHAVIORS[code].value}"] = bootstrap(recall_of(code), matrices["macro_f1"])
    return [tidy_row(keys, metric, *value, len(samples)) for metric, value in values.items()]


def difference_rows(
    samples: Samples, ours: FloatArray, theirs: FloatArray, keys: Mapping[str, Cell]
) -> list[Row]:
    """How much better ours is, on the same drivers, with a paired interval over episodes."""
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
