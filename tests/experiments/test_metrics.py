"""Scores with known answers."""

from __future__ import annotations

import numpy as np

from experiments.score.metrics import auc_over_episodes


def test_auc_compares_only_inside_groups():
    score = np.array([1.0, 2.0, 11.0, 12.0])
    truth = np.array([False, True, False, True])
    value, low, high = auc_over_episodes(score, truth, np.arange(4), np.array([0, 0, 1, 1]))
    assert (value, low, high) == (1.0, 1.0, 1.0)
    assert auc_over_episodes(score, truth, np.arange(4))[0] == 0.75
    assert np.isnan(auc_over_episodes(score, truth, np.arange(4), np.arange(4))[0])
