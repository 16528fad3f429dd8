"""Metrics against their definitions, and against Argoverse 2's own code where it is installed."""

from __future__ import annotations

import numpy as np
import pytest

from graphrqi.predict.metrics import displacement_errors, distances


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(30, 60, 2)).cumsum(axis=1)
    xy = truth[:, None] + rng.normal(size=(30, 6, 60, 2)).cumsum(axis=2) * 0.3
    probability = rng.dirichlet(np.ones(6), 30)
    return xy, truth, probability


def told(case):
    xy, truth, probability = case
    return displacement_errors(distances(xy, truth), probability)


def test_metrics_by_their_definitions(case):
    xy, truth, probability = case
    found = told(case)
    for i in range(len(xy)):
        error = [
            [float(np.hypot(*(p - q))) for p, q in zip(m, truth[i], strict=True)] for m in xy[i]
        ]
        ade, fde = [sum(e) / len(e) for e in error], [e[-1] for e in error]
        likeliest, best = int(np.argmax(probability[i])), int(np.argmin(fde))
        assert found["ade_m"][i] == pytest.approx(ade[likeliest])
        assert found["fde_m"][i] == pytest.approx(fde[likeliest])
        assert found["rmse_m"][i] == pytest.approx(fde[likeliest] ** 2)
        assert found["min_ade_m"][i] == pytest.approx(min(ade))
        assert found["min_fde_m"][i] == pytest.approx(min(fde))
        assert found["miss_rate"][i] == float(min(fde) > 2.0)
        expected = min(fde) + (1 - probability[i, best]) ** 2
        assert found["brier_min_fde_m"][i] == pytest.approx(expected)


def test_metrics_agree_with_argoverse_2(case):
    av2 = pytest.importorskip(
        "av2.datasets.motion_forecasting.eval.metrics",
        reason="av2 is not installed; it needs Python < 3.13",
    )
    xy, truth, probability = case
    found = told(case)
    for i in range(len(xy)):
        assert found["min_ade_m"][i] == pytest.approx(av2.compute_ade(xy[i], truth[i]).min())
        assert found["min_fde_m"][i] == pytest.approx(av2.compute_fde(xy[i], truth[i]).min())
        missed = av2.compute_is_missed_prediction(xy[i], truth[i], 2.0).all()
        assert found["miss_rate"][i] == float(missed)
        brier = av2.compute_brier_fde(xy[i], truth[i], probability[i])
        best = av2.compute_fde(xy[i], truth[i]).argmin()
        assert found["brier_min_fde_m"][i] == pytest.approx(brier[best])
