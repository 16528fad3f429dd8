"""Learned predictors: training learns what can be learned, splines, and files."""

from __future__ import annotations

import numpy as np
import pytest

from graphrqi.predict.learned.lstm import TrajectoryLstm
from graphrqi.predict.metrics import covered, log_density
from graphrqi.predict.networks import (
    ANCHORS,
    KNOT_S,
    KNOTS,
    MODES,
    PER_MODE,
    Perceptron,
    PredictorInputs,
    _spline,
    decode,
    load_futures_network,
)
from graphrqi.predict.training import fit
from graphrqi.predict.training.fit import Examples, train_lstm, train_perceptron

INPUTS = 72


def made_up(count: int, seed: int) -> Examples:
    """Drivers that go one of the first two anchors' way, as their first input says."""
    rng = np.random.default_rng(seed)
    inputs = np.zeros((count, INPUTS), dtype=np.float32)
    inputs[:, 0] = rng.standard_normal(count)
    speed = rng.uniform(5, 15, count)
    time_s = np.arange(1, KNOTS + 1) * KNOT_S
    straight = np.stack([speed[:, None] * time_s, np.zeros((count, KNOTS))], axis=-1)
    anchors = np.repeat(straight[:, None], ANCHORS, axis=1)
    anchors[:, 1, :, 1] += time_s
    left = inputs[:, 0] > 0
    truth = np.where(left[:, None, None], anchors[:, 1], anchors[:, 0])
    return Examples(inputs, anchors.astype(np.float32), truth.astype(np.float32))


@pytest.fixture(scope="module", autouse=True)
def small_and_quick():
    """The training of the module at a size that suits made-up examples."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit, "HIDDEN", (32, 32))
        patch.setattr(fit, "BATCH", 64)
        patch.setattr(fit, "LEARNING_RATE", 5e-3)
        yield


@pytest.fixture(scope="module")
def perceptron(small_and_quick):
    return train_perceptron(made_up(2048, 0), made_up(300, 1), epochs=10)


def inputs_of(examples: Examples) -> PredictorInputs:
    return PredictorInputs(
        examples.features.astype(np.float64), examples.anchors.astype(np.float64)
    )


def ade(futures, examples: Examples) -> float:
    return float(np.linalg.norm(futures.own[:, 0] - examples.truth, axis=-1).mean())


def test_perceptron_learns_which_way_drivers_go(perceptron):
    test = made_up(500, 2)
    untold = float(np.linalg.norm(test.anchors[:, 0] - test.truth, axis=-1).mean())
    assert ade(perceptron(inputs_of(test)), test) < 0.5 * untold


def test_networks_survive_their_files(perceptron, tmp_path):
    path = tmp_path / "network.safetensors"
    perceptron.save(path, {"split": "train"})
    again = load_futures_network(path, Perceptron.read)
    test = inputs_of(made_up(50, 3))
    assert np.allclose(again(test).own, perceptron(test).own, atol=1e-3)
    rival = train_lstm(made_up(256, 0), made_up(100, 1), epochs=1)
    rival.save(tmp_path / "lstm.safetensors", {})
    again = load_futures_network(tmp_path / "lstm.safetensors", TrajectoryLstm.read)
    assert np.allclose(again(test).own, rival(test).own, atol=1e-3)
    (tmp_path / "usual").touch()
    usual = (tmp_path / "usual").stat().st_mode
    assert {one.stat().st_mode for one in tmp_path.iterdir()} == {usual}, "others may read them"


def test_decoded_futures_are_distributions_with_the_first_the_likeliest():
    rng = np.random.default_rng(0)
    raw = rng.standard_normal((40, MODES * PER_MODE))
    futures = decode(raw, rng.standard_normal((40, ANCHORS, KNOTS, 2)), 1.0)
    assert futures.probability.sum(axis=1) == pytest.approx(1.0)
    assert (futures.probability.argmax(axis=1) == 0).all()
    assert (futures.spread > 0).all()


@pytest.mark.parametrize("steps", [20, 50, 60])
def test_spline_runs_through_the_knots_and_starts_at_the_present_speed(steps):
    matrix, start = _spline(steps)
    time_s = np.arange(1, steps + 1) * 0.1
    knots = np.arange(1, KNOTS + 1) * KNOT_S
    way = 8.0 * knots - 0.5 * knots**2
    told = way @ matrix + 8.0 * start
    at = time_s[time_s <= 5.0]
    assert told[: at.size] == pytest.approx(8.0 * at - 0.5 * at**2, abs=0.05)


def test_sets_cover_what_they_promise():
    rng = np.random.default_rng(1)
    n = 2500
    xy = rng.normal(0, 5, (n, 3, 2))
    probability = np.tile([0.5, 0.3, 0.2], (n, 1))
    spread = np.full((n, 3), 1.5)
    mode = rng.choice(3, n, p=[0.5, 0.3, 0.2])
    truth = xy[np.arange(n), mode] + 1.5 * rng.standard_normal((n, 2))
    assert covered(xy, spread, probability, truth).mean() == pytest.approx(0.9, abs=0.02)
    assert covered(xy, spread * 0.5, probability, truth).mean() < 0.75


def test_log_density_integrates_to_one():
    grid = np.stack(np.meshgrid(*[np.linspace(-12, 12, 241)] * 2), axis=-1).reshape(1, -1, 2)
    xy = np.array([[[0.0, 0.0], [3.0, 1.0]]])
    density = log_density(grid, xy, np.array([[1.0, 0.7]]), np.array([[0.6, 0.4]]))
    assert np.exp(density).sum() * 0.01 == pytest.approx(1.0, abs=1e-3)
