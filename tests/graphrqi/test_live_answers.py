"""Answers frame by frame: those elsewhere are kept until motion is measured again."""

import itertools

import numpy as np
import pytest

from graphrqi.elsewhere import FOREIGN, HOME, Elsewhere
from graphrqi.features.relative.observer import EVERY_S
from graphrqi.live_answers import LiveAnswers
from graphrqi.model_files import load_model


def positions(time_s):
    """Eight cars behind one another at 12 to 15 m/s."""
    speed = 12.0 + 3.0 * np.arange(8) / 7.0
    return np.stack([40.0 * np.arange(8) + speed * time_s, np.zeros(8)], axis=1)


@pytest.fixture
def asked(monkeypatch):
    """Times at which foreign traffic was asked about; all traffic counts as foreign."""
    times = []
    answered = Elsewhere.answers_among

    def counted(self, relative, kinds, seen, time_s, *places):
        times.append(time_s)
        return answered(self, relative, kinds, seen, time_s, *places)

    monkeypatch.setattr(Elsewhere, "answers_among", counted)
    monkeypatch.setattr(
        Elsewhere, "kinds", lambda self, rows: np.tile(np.eye(4)[FOREIGN], (len(rows), 1))
    )
    return times


def test_foreign_answers_are_kept_between_measurements(asked):
    live, drives = LiveAnswers(load_model("graphrqi-plus"), 1.0), np.ones(8, dtype=bool)
    found = []
    for step in range(60):
        live.update(0.1 * step, np.arange(8), positions(0.1 * step), drives)
        ids, probability, domain = live.now()
        if step >= 20:
            assert ids.tolist() == list(range(8))
            assert np.allclose(probability.sum(axis=1), 1.0)
            assert domain == 1.0
            found.append(probability)
    assert len(asked) == pytest.approx(6.0 / EVERY_S, abs=1)
    assert np.diff(asked).min() >= EVERY_S - 1e-6
    changes = [not np.array_equal(a, b) for a, b in itertools.pairwise(found)]
    assert 0 < sum(changes) <= 4.0 / EVERY_S + 1


def test_home_alone_asks_nobody_else(monkeypatch):
    monkeypatch.setattr(
        Elsewhere, "kinds", lambda self, rows: np.tile(np.eye(4)[HOME], (len(rows), 1))
    )
    model = load_model("graphrqi-plus")
    live, drives = LiveAnswers(model, 1.0), np.ones(8, dtype=bool)
    home = LiveAnswers(
        type(model)(model.method, model.solver, model.classifier, model.shares, model.card), 1.0
    )
    for step in range(30):
        for each in (live, home):
            each.update(0.1 * step, np.arange(8), positions(0.1 * step), drives)
    assert np.array_equal(live.now()[1], home.now()[1])


def test_at_first_nobody_is_surely_told():
    """One second of cars says neither where they drive nor whether they are simulated."""
    live, drives = LiveAnswers(load_model("graphrqi-plus"), 0.5), np.ones(8, dtype=bool)
    for step in range(11):
        live.update(0.1 * step, np.arange(8), positions(0.1 * step), drives)
    _, probability, domain = live.now()
    assert domain == pytest.approx(2.0 / 3.0)
    assert probability.shape == (8, 6)
    aggressive = probability[:, :3].sum(axis=1)
    assert (np.maximum(aggressive, 1.0 - aggressive) <= 2.0 / 3.0 + 1e-9).all()
