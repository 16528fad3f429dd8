"""What every method promises, and what the features of the others are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from graphrqi.features.embedding import EmbeddingObserver, embedded
from graphrqi.features.trajectory import TrajectoryObserver
from graphrqi.methods import METHODS, Model, train
from graphrqi.model_files import load_model, save_model
from graphrqi.samples import collect
from graphrqi.stream import BehaviorStream
from sim.frames import Tracks


def platoons(seed: int, agents: int = 18, seconds: float = 12.0) -> Tracks:
    """Three lanes of vehicles at 10 Hz; a behaviour decides speed, unrest and sideways movement."""
    rng = np.random.default_rng(seed)
    behavior = np.arange(agents, dtype=np.int8) % 6
    rng.shuffle(behavior)
    time_s = np.arange(round(seconds * 10)) / 10.0
    speed = 9.0 + 1.5 * behavior + rng.normal(0.0, 0.2, agents)
    wave = np.sin(time_s[None] * (0.5 + 0.2 * behavior[:, None]) + rng.uniform(0, 6, (agents, 1)))
    x = 12.0 * (np.arange(agents) // 3)[:, None] + speed[:, None] * time_s + wave
    y = 3.2 * (np.arange(agents) % 3)[:, None] + 0.1 * behavior[:, None] * wave
    there = np.ones((agents, time_s.size), dtype=bool)
    return Tracks.of_dense(
        ids=np.arange(agents) * 3,
        names=tuple(f"car {i}" for i in range(agents)),
        kind=np.zeros(agents, dtype=np.int8),
        length=np.full(agents, 4.5),
        width=np.full(agents, 1.8),
        time_s=time_s,
        xy=np.stack([x, y], axis=2),
        heading=np.zeros_like(x),
        speed=np.tile(speed[:, None], (1, time_s.size)),
        valid=there,
        signals=np.empty((0, time_s.size), dtype=np.int8),
        behavior=behavior,
    )


def renumbered(tracks: Tracks, order: np.ndarray) -> Tracks:
    """The same traffic, rows in another order under ids that keep ascending."""
    return tracks.with_dense(
        names=tuple(tracks.names[i] for i in order),
        xy=tracks.xy[order],
        heading=tracks.heading[order],
        speed=tracks.speed[order],
        behavior=tracks.behavior[order],
    )


@pytest.fixture(scope="module", params=sorted(METHODS))
def trained(request):
    with pytest.MonkeyPatch.context() as patch:
        if METHODS[request.param].classifier == "boosted":  # few rounds show the contract
            few = dataclasses.replace(METHODS[request.param], options={"rounds": 8})
            patch.setitem(METHODS, request.param, few)
        return made(request.param)


def made(name: str) -> Model:
    observer = METHODS[name].observer
    parts = [collect(platoons(s), observer("eigh"), s, (2.0, 5.0), every_s=1.0) for s in range(3)]
    samples = type(parts[0]).join(parts)
    return train(
        name,
        samples.where(samples.episode < 2),
        samples.where(samples.episode == 2),
        solver="eigh",
        seed=1,
    )


def test_every_driver_gets_a_distribution(trained):
    tracks, stream = platoons(7, seconds=4.0), BehaviorStream(trained)
    for frame in tracks.frames():
        posterior = stream.update(frame)
    np.testing.assert_array_equal(posterior.ids, tracks.ids)
    np.testing.assert_allclose(posterior.probability.sum(axis=1), 1.0, atol=1e-9)


def test_saved_and_loaded_answer_alike(trained, tmp_path):
    save_model(trained, tmp_path / "model")
    again = load_model(tmp_path / "model")
    observer = trained.method.observer("eigh")
    for frame in platoons(8, seconds=3.0).frames():
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
    seen = observer.observation()
    features = observer.features(seen.seconds, seen.sums, seen.instant)
    assert features.shape == (18, len(observer.feature_names))
    np.testing.assert_array_equal(
        again.classifier.posterior(features), trained.classifier.posterior(features)
    )


@pytest.mark.parametrize(
    "observer", [METHODS["forest"].observer, TrajectoryObserver, EmbeddingObserver]
)
def test_order_of_the_agents_does_not_matter(observer):
    tracks = platoons(9, seconds=5.0)
    order = np.random.default_rng(0).permutation(tracks.ids.size)
    found = []
    for traffic in (tracks, renumbered(tracks, order)):
        watching = observer("eigh")
        for frame in traffic.frames():
            watching.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        seen = watching.observation()
        found.append(watching.features(seen.seconds, seen.sums, seen.instant))
    np.testing.assert_allclose(found[1], found[0][order], atol=1e-6)


def test_trajectory_means_and_deviations():
    """Two cars on one lane, the rear one at 12 m/s behind one at 10 m/s."""
    observer = TrajectoryObserver()
    for step in range(60):
        time_s = step / 10.0
        xy = np.array([[12.0 * time_s, 0.0], [40.0 + 10.0 * time_s, 0.0]])
        observer.update(time_s, np.array([0, 1]), xy, np.ones(2, dtype=bool))
    seen = observer.observation()
    table = dict(
        zip(
            observer.feature_names,
            observer.features(seen.seconds, seen.sums, seen.instant)[0],
            strict=True,
        )
    )
    assert table["speed:mean"] == pytest.approx(12.0, abs=1e-6)
    assert table["speed:deviation"] == pytest.approx(0.0, abs=1e-5)
    assert table["speed over leader:mean"] == pytest.approx(2.0, abs=1e-6)
    assert 23.0 < table["front distance:mean"] < 35.4
    assert table["rear distance:share"] == 0.0
    assert table["jerk:mean"] == pytest.approx(0.0, abs=1e-6)


def test_the_embedding_solves_the_generalised_problem():
    rng = np.random.default_rng(0)
    weight = np.triu(rng.uniform(0.2, 1.0, (12, 12)) * (rng.random((12, 12)) < 0.5), 1)
    adjacency = weight + weight.T
    vectors = embedded(adjacency, 5)
    degree = np.diag(adjacency.sum(axis=1) + 1e-6)
    laplacian = degree - np.eye(12) * 1e-6 - adjacency
    values = np.diag(vectors.T @ laplacian @ vectors)
    assert np.abs(laplacian @ vectors - degree @ vectors * values).max() < 1e-5
    np.testing.assert_allclose(vectors.T @ degree @ vectors, np.eye(5), atol=1e-9)
