"""Scores with known answers."""

from __future__ import annotations

import numpy as np

from experiments.benchmarks.real_data import auc_within
from experiments.score.metrics import calibration_error, reliability


def test_calibration_of_answers_that_are_as_sure_as_right():
    rng = np.random.default_rng(0)
    p = rng.uniform(0.5, 1.0, 20000)
    truth = (rng.random(20000) > p).astype(np.int8)
    honest = np.stack([p, 1 - p], axis=1)
    assert float(calibration_error(reliability(truth, honest, np.zeros(20000)).sum(0))) < 0.02
    boastful = np.stack([p**0.1, 1 - p**0.1], axis=1)
    assert float(calibration_error(reliability(truth, boastful, np.zeros(20000)).sum(0))) > 0.15


def test_auc_compares_only_inside_groups():
    score = np.array([1.0, 2.0, 11.0, 12.0])
    truth = np.array([False, True, False, True])
    value, low, high = auc_within(score, truth, np.array([0, 0, 1, 1]))
    assert (value, low, high) == (1.0, 1.0, 1.0)
    assert auc_within(score, truth, np.zeros(4))[0] == 0.75
    assert np.isnan(auc_within(score, truth, np.arange(4))[0])
