"""Features: their definitions, what they do not depend on, and what they survive."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from graphrqi.features import following_law
from graphrqi.features.drivers import DriverObserver
from graphrqi.features.interaction import NOMINAL_LENGTH_M, differences, interactions
from graphrqi.features.motion import FORGET_S, RawMotion
from graphrqi.features.observer import Observer
from graphrqi.features.scene import FreeFlowSpeed
from graphrqi.features.spectral import (
    EigenvectorObserver,
    SpectrumObserver,
    invariant,
    whole_eigenspaces,
)
from graphrqi.features.statistics import Block, describe, describe_names, spread
from graphrqi.graph import TrafficGraph


def driving(solver: str = "graphrqi") -> DriverObserver:
    return DriverObserver("raw", solver)


OBSERVERS = [Observer, EigenvectorObserver, SpectrumObserver, driving]


def drive(estimator, times, path):
    """Feed one agent's path; return its last motion."""
    for t in times:
        motion = estimator.update(float(t), np.array([4]), np.array([path(t)]), np.array([True]))
    return motion


def test_motion_of_uniform_acceleration():
    motion = drive(RawMotion(), np.arange(31) / 10, lambda t: (5 * t + t * t, 0.0))
    # differences over 0.4 s lag by 0.2 s (velocity) and see the true acceleration
    assert motion.speed[0] == pytest.approx(5 + 2 * (3.0 - 0.2))
    assert motion.acceleration[0] == pytest.approx(2.0)
    assert motion.direction[0] == pytest.approx([1.0, 0.0])
    assert motion.sideways[0] == pytest.approx(0.0)


def test_sideways_is_positive_to_the_left():
    def moved_over(side):
        def path(t):
            return (10 * t, 0.0 if t < 3 else side * 2.0 * (t - 3))

        return drive(RawMotion(), np.arange(41) / 10, path).sideways[0]

    assert moved_over(1) == pytest.approx(-moved_over(-1))
    assert 0.7 < moved_over(1) < 2.0  # less than 2 m: the direction has turned a little too


def test_motion_bridges_missing_frames():
    times = [t / 10 for t in range(31) if t not in (25, 27)]
    assert drive(RawMotion(), times, lambda t: (5 * t, 0.0)).speed[0] == pytest.approx(5.0)


def test_motion_is_unknown_at_first_sight_and_after_a_long_absence():
    estimator = RawMotion()
    assert np.isnan(drive(estimator, [0.0], lambda t: (t, 0.0)).speed[0])
    for t in np.arange(0.1, FORGET_S + 1.0, 0.1):
        estimator.update(float(t), np.array([9]), np.array([[0.0, 0.0]]), np.array([True]))
    again = estimator.update(FORGET_S + 1.0, np.array([4, 9]), np.zeros((2, 2)), np.ones(2, bool))
    assert np.isnan(again.speed[0])


def scene(positions, velocity=(10.0, 0.0), steps=30):
    """Vehicles in rigid motion for three seconds; their motion at the end."""
    estimator = RawMotion()
    for t in range(steps + 1):
        xy = np.asarray(positions, float) + np.asarray(velocity) * t / 10
        motion = estimator.update(t / 10, np.arange(len(xy)), xy, np.ones(len(xy), bool))
    return motion


def complete(n):
    return TrafficGraph.from_edges(range(n), list(itertools.combinations(range(n), 2)))


def test_leader_follower_beside_and_gap():
    motion = scene([(0, 0), (20, 0.3), (60, 0), (3, 3.2), (8, 40)])
    around = interactions(motion, np.ones(5, bool), complete(5))
    assert around.leader.tolist() == [1, 2, -1, -1, -1]
    assert around.follower.tolist() == [-1, 0, 1, -1, -1]
    assert around.gap[0] == pytest.approx(20 - NOMINAL_LENGTH_M)
    assert around.rear_gap[1] == pytest.approx(20 - NOMINAL_LENGTH_M)
    assert around.leader_speed[0] == pytest.approx(10.0)
    assert around.beside.tolist() == [1, 0, 0, 1, 0]


def test_interaction_turns_with_the_road():
    east = scene([(0, 0), (20, 0)])
    angle = 2.1
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = scene(np.array([(0, 0), (20, 0)]) @ turn, np.array([10.0, 0.0]) @ turn)
    for one in ("gap", "leader_speed"):
        a = getattr(interactions(east, np.ones(2, bool), complete(2)), one)
        b = getattr(interactions(turned, np.ones(2, bool), complete(2)), one)
        assert a == pytest.approx(b, nan_ok=True)


def test_pedestrians_are_seen_but_are_no_leaders():
    motion = scene([(0, 0), (15, 2.0)])
    around = interactions(motion, np.array([True, False]), complete(2))
    assert around.leader[0] == -1
    assert around.pedestrian_m[0] == pytest.approx(15.0)
    assert np.isnan(around.pedestrian_m[1])


def test_oncoming_traffic_is_no_leader():
    estimator = RawMotion()
    for t in range(31):
        xy = np.array([[t, 0.0], [100.0 - t, 0.0]])
        motion = estimator.update(t / 10, np.arange(2), xy, np.ones(2, bool))
    assert interactions(motion, np.ones(2, bool), complete(2)).leader.tolist() == [-1, -1]


def test_spread_conserves_time_and_describe_recovers_the_mean():
    block = Block("x", (0.0, 1.0, 4.0))
    values = np.array([[0.5, 2.0, 9.0, -3.0, np.nan]])
    out = np.zeros((5, 3))
    spread(values, np.ones((1, 5), bool), (block,), 1.0, np.arange(5), out)
    assert out.sum(axis=1).tolist() == [1, 1, 1, 1, 0]
    features = dict(zip(describe_names((block,)), describe(out, (block,)).T, strict=True))
    assert features["x:mean"] == pytest.approx([0.5, 2.0, 4.0, 0.0, -1.0])


def test_pace_is_of_free_drivers_and_forgets():
    pace = FreeFlowSpeed()
    assert np.isnan(pace.update(0.0, np.array([10.0]), np.array([True])))
    for step in range(1, 200):
        found = pace.update(0.1 * step, np.array([10.0, 2.0]), np.array([True, False]))
    assert found == pytest.approx(10.0)
    for step in range(200, 40000):
        found = pace.update(0.1 * step, np.array([20.0]), np.array([True]))
    assert found == pytest.approx(20.0, abs=0.1)


def test_graph_signal_of_a_constant_is_zero_and_lonely_is_unknown():
    ring = TrafficGraph.from_edges(range(4), [(0, 1), (1, 2), (2, 3), (3, 0)])
    assert np.abs(differences(ring, np.full(4, 7.0), np.ones(4, bool))).max() < 1e-12
    alone = differences(
        TrafficGraph.from_edges(range(2), []), np.array([1.0, 2.0]), np.ones(2, bool)
    )
    assert np.isnan(alone).all()


def eigenpairs(graph, k):
    values, vectors = np.linalg.eigh(graph.laplacian.toarray())
    return values[::-1][:k], vectors[:, ::-1][:, :k]


@pytest.fixture
def graph():
    rng = np.random.default_rng(3)
    return TrafficGraph.empty().observe(np.arange(30), rng.uniform(0, 100, (30, 2)))


def test_invariant_features_ignore_sign_rotation_and_order(graph):
    values, vectors = eigenpairs(graph, 9)
    plain = invariant(values, vectors, graph.degree)
    flipped = vectors * np.array([-1, 1, 1, -1, -1, 1, -1, 1, 1])
    assert invariant(values, flipped, graph.degree) == pytest.approx(plain)
    order = np.random.default_rng(0).permutation(30)
    assert invariant(values, vectors[order], graph.degree[order]) == pytest.approx(plain[order])


def test_invariant_features_ignore_rotation_inside_an_eigenspace():
    ring = TrafficGraph.from_edges(range(6), [(i, (i + 1) % 6) for i in range(6)])
    values, vectors = eigenpairs(ring, 4)  # 4, 3, 3, 1: the last space (1, 1) is cut
    assert whole_eigenspaces(values, complete=False) == 3
    turned = vectors.copy()
    c, s = np.cos(0.7), np.sin(0.7)
    turned[:, 1:3] = vectors[:, 1:3] @ np.array([[c, -s], [s, c]])
    plain = invariant(values, vectors, ring.degree)
    assert invariant(values, turned, ring.degree) == pytest.approx(plain)
    assert plain == pytest.approx(np.tile(plain[0], (6, 1)))  # all vertices of a ring are alike


def test_following_law_is_recovered_from_braking_too():
    rng = np.random.default_rng(1)
    v, u = rng.uniform(3, 15, 400), rng.uniform(3, 15, 400)
    gap = 2.8 + 1.1 * v + (v * v - u * u) / (2 * 3.0)
    sums = following_law.products(v, u, gap).sum(axis=0)
    found = following_law.infer(sums[None])[0]
    assert found[:3] == pytest.approx([2.8, 1.1, 1 / 3.0], rel=0.05)
    assert found[6] < 0.2


def test_a_start_in_a_queue_shows_lag_gap_and_pull():
    """The leader starts after 4 s with 2 m/s2, the follower 1.5 s later with 1.2 m/s2."""
    watching = driving("eigh")

    def place(t, begins, pull):
        return 0.5 * pull * max(t - begins, 0.0) ** 2

    for step in range(90):
        t = step / 10
        roll = 3.0 * min(t, 1.0)  # so that both have a direction of travel
        xy = [(roll + place(t, 5.5, 1.2), 0.0), (roll + 7.6 + place(t, 4.0, 2.0), 0.0)]
        watching.update(t, np.arange(2), np.array(xy), np.ones(2, bool))
    seen = watching.observation()
    found = dict(
        zip(
            watching.feature_names,
            watching.features(seen.seconds, seen.sums, seen.instant)[0],
            strict=True,
        )
    )
    assert found["standstill gap:50%"] == pytest.approx(7.6 - NOMINAL_LENGTH_M, abs=0.3)
    lag_s = np.expm1(found["leader's speed before starting:evidence"]) / 10
    assert lag_s == pytest.approx(1.5, abs=0.4)
    assert found["gap before starting:95%"] > found["standstill gap:95%"] + 1.0
    assert found["pull-away when slow:95%"] == pytest.approx(1.2, abs=0.2)


def test_braking_to_a_stop_shows_how_long_it_takes():
    """From 12 m/s with 3 m/s2: four seconds at first, then ever fewer."""
    watching = driving("eigh")
    for step in range(70):
        t = step / 10
        after = np.clip(t - 3.0, 0.0, 4.0)
        x = 12.0 * min(t, 3.0) + 12.0 * after - 1.5 * after * after
        watching.update(t, np.arange(1), np.array([[x, 0.0]]), np.ones(1, bool))
    seen = watching.observation()
    features = watching.features(seen.seconds, seen.sums, seen.instant)[0]
    found = dict(zip(watching.feature_names, features, strict=True))
    assert 2.0 < found["time to standing, fast:50%"] < 4.0
    assert 0.0 < found["time to standing, slow:50%"] < 2.0
    assert found["law's headway, close:evidence"] == 0.0  # nobody ahead


def test_implied_headway_bounds_the_own_one():
    rng = np.random.default_rng(2)
    v, u = rng.uniform(3, 15, 400), rng.uniform(3, 15, 400)
    held = 2.0 + 1.3 * v + (v * v - u * u) / (2 * 3.0)
    implied = following_law.implied_headway(v, u, held, 2.0, 3.0)
    np.testing.assert_allclose(implied, 1.3)
    farther = following_law.implied_headway(v, u, held + rng.uniform(0, 20, 400), 2.0, 3.0)
    assert (farther >= 1.3).all()


def traffic(seconds=12.0, n=12, seed=0):
    rng = np.random.default_rng(seed)
    start, speed = rng.uniform(0, 150, n), rng.uniform(5, 15, n)
    lane = 3.2 * rng.integers(0, 3, n)
    for step in range(round(seconds * 10)):
        t = step / 10
        yield t, np.arange(n), np.stack([start + speed * t, lane], axis=1), np.arange(n) != 5


@pytest.mark.parametrize("observer", OBSERVERS)
def test_observers_describe_drivers_only_with_finite_named_features(observer):
    one = observer("eigh")
    for t, ids, xy, drives in traffic():
        one.update(t, ids, xy, drives)
        seen = one.observation()
        features = one.features(seen.seconds, seen.sums, seen.instant)
        assert seen.ids.tolist() == [i for i in range(12) if i != 5]
        assert features.shape == (11, len(one.feature_names))
        assert np.isfinite(features).all()
    assert seen.seconds == pytest.approx(np.full(11, 11.9))


@pytest.mark.parametrize("observer", [SpectrumObserver, driving])
def test_evidence_does_not_depend_on_who_is_called_what(observer):
    first, second = observer("eigh"), observer("eigh")
    order = np.random.default_rng(2).permutation(12)
    for t, ids, xy, drives in traffic():
        first.update(t, ids, xy, drives)
        second.update(t, ids, xy[order], drives[order])
    a, b = first.observation(), second.observation()
    row = {int(agent): i for i, agent in enumerate(a.ids)}
    same = [row[int(order[agent])] for agent in b.ids]
    assert b.sums == pytest.approx(a.sums[same])
