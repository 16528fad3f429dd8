"""Answers frame by frame: who answers in which traffic, and when a network is asked again."""

import itertools

import numpy as np
import pytest

from graphrqi.features.relative.observer import EVERY_S
from graphrqi.live_answers import LiveAnswers
from graphrqi.model_files import load_model
from graphrqi.places.other_traffic import OtherTraffic


def positions(time_s, noise_m=0.0, rng=None):
    """Eight cars behind one another at 12 to 15 m/s."""
    speed = 12.0 + 3.0 * np.arange(8) / 7.0
    xy = np.stack([40.0 * np.arange(8) + speed * time_s, np.zeros(8)], axis=1)
    return xy if rng is None else xy + rng.normal(0.0, noise_m, xy.shape)


@pytest.fixture
def asked(monkeypatch):
    """Kinds of traffic and times at which a network was asked."""
    calls = []
    answered = OtherTraffic.among

    def counted(self, relative, traffic, seen, time_s, place):
        calls.append((traffic, time_s))
        return answered(self, relative, traffic, seen, time_s, place)

    monkeypatch.setattr(OtherTraffic, "among", counted)
    return calls


@pytest.mark.parametrize("traffic", ["recorded", "other"])
def test_answers_of_networks_are_kept_between_measurements(asked, traffic):
    live = LiveAnswers(load_model("graphrqi-plus"), 1.0, traffic)
    drives, found = np.ones(8, dtype=bool), []
    for step in range(60):
        live.update(0.1 * step, np.arange(8), positions(0.1 * step), drives)
        ids, probability, domain = live.now()
        if step >= 20:
            assert ids.tolist() == list(range(8))
            assert np.allclose(probability.sum(axis=1), 1.0)
            assert domain == 1.0
            found.append(probability)
    times = [time_s for _, time_s in asked]
    assert {kind for kind, _ in asked} == {traffic}
    assert len(times) == pytest.approx(6.0 / EVERY_S, abs=1)
    assert np.diff(times).min() >= EVERY_S - 1e-6
    changes = [not np.array_equal(a, b) for a, b in itertools.pairwise(found)]
    assert 0 < sum(changes) <= 4.0 / EVERY_S + 1


@pytest.mark.parametrize(
    ("noise_m", "step_s", "is_noisy"), [(0.0, 0.1, False), (0.02, 0.1, True), (0.0, 0.04, True)]
)
def test_the_classifier_answers_in_exact_simulated_traffic_alone(asked, noise_m, step_s, is_noisy):
    model = load_model("graphrqi-plus")
    live, drives = LiveAnswers(model, 1.0), np.ones(8, dtype=bool)
    plain = LiveAnswers(
        type(model)(model.method, model.solver, model.classifier, model.shares, model.card), 1.0
    )
    rng = np.random.default_rng(0)
    for step in range(round(4.0 / step_s)):
        xy = positions(step_s * step, noise_m, rng)
        for each in (live, plain):
            each.update(step_s * step, np.arange(8), xy, drives)
    assert live.is_noisy is is_noisy
    assert np.array_equal(live.now()[1], plain.now()[1]) is not is_noisy
    assert bool(asked) is is_noisy


def test_drivers_are_classified_after_a_second():
    live, drives = LiveAnswers(load_model("graphrqi-plus"), 1.0), np.ones(8, dtype=bool)
    shown = []
    for step in range(12):
        live.update(0.1 * step, np.arange(8), positions(0.1 * step), drives)
        shown.append(live.now()[0].size)
    assert shown == [0] * 10 + [8, 8]
