"""Paths along a map's lanes: which there are, and futures along them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from graphrqi.predict.networks import MODES, TIME_S, Futures, Perceptron
from graphrqi.predict.recorded.features import feature_count
from graphrqi.predict.recorded.lanes_ahead import (
    MOST,
    PATH_FEATURES,
    lanes_ahead,
)
from graphrqi.predict.recorded.motion import Motion
from graphrqi.predict.recorded.network import (
    PATH_OUTPUTS,
    PER_MODE,
    PER_PATH,
    RecordedNetwork,
    TrainedRange,
)
from graphrqi.predict.recorded.predictor import beside_paths, join_lanes, predict_recorded
from scenarios import SCENARIOS
from sim.frames import Frame, Tracks
from sim.road.lane_graph import LaneGraph


@pytest.fixture(scope="module")
def crossing():
    return SCENARIOS["four_way_intersection"]().road


def driving(road, lane: int, *, speed=10.0, back_m=40.0, aside_m=0.0, kind=0, others=()) -> Tracks:
    """A vehicle, and others so far ahead of it, that has come along a lane for three seconds."""
    graph = LaneGraph.of(road)
    end = graph.length[lane] - back_m
    frames = []
    for ago in np.arange(3.0, -1e-9, -0.1):
        s = np.array([end, *(end + gap for gap in others)]) - speed * ago
        n = s.size
        xy, heading = graph.position(np.full(n, lane), s, np.r_[aside_m, np.zeros(n - 1)])
        frames.append(
            Frame(time_s=10.0 - ago, ids=np.arange(n), xy=xy, heading=heading,
                  speed=np.full(n, speed), length=np.full(n, 4.5), width=np.full(n, 1.8),
                  kind=np.full(n, kind))
        )  # fmt: skip
    return Tracks.from_frames(frames)


def approach(road) -> int:
    """A lane from which more than one way leads on."""
    graph = LaneGraph.of(road)
    ways = (graph.successors >= 0).sum(axis=1)
    fits = graph.drivable & ~graph.internal & (ways > 1) & (graph.length > 80.0)
    return int(np.flatnonzero(fits)[0])


def raw_lanes(score=0.0, along=0.0, aside=0.0) -> Perceptron:
    """A network that says the same of every path: its score, and constant corrections."""
    inputs = feature_count() + PATH_FEATURES
    numbers = np.zeros((PER_PATH, PER_MODE))
    numbers[:, 0], numbers[:, 1] = along, aside
    return Perceptron(
        np.zeros(inputs), np.ones(inputs), (np.zeros((inputs, PATH_OUTPUTS), np.float32),),
        (np.append(numbers.ravel(), score).astype(np.float32),),
    )  # fmt: skip


def network(lanes: Perceptron | None) -> RecordedNetwork:
    inputs, outputs = feature_count(), MODES * PER_MODE
    free = Perceptron(
        np.zeros(inputs), np.ones(inputs), (np.zeros((inputs, outputs), np.float32),),
        (np.zeros(outputs, np.float32),),
    )  # fmt: skip
    return RecordedNetwork(free, 1.0, TrainedRange(40.0, 0.5, 5.0, 0.5), lanes)


def test_every_way_through_a_junction_is_a_path(crossing):
    lane = approach(crossing)
    history = driving(crossing, lane, back_m=15.0)
    ahead = lanes_ahead(history, Motion.of(history), crossing)
    graph = LaneGraph.of(crossing)
    ways = graph.successors[lane][graph.successors[lane] >= 0]
    assert ahead.exists.sum() >= ways.size
    ends = ahead.points[ahead.exists][:, -1]
    headings = np.arctan2(ends[:, 1], ends[:, 0])
    assert headings.max() - headings.min() > np.radians(30)


def test_the_path_that_fits_best_is_the_own_lane(crossing):
    history = driving(crossing, approach(crossing), aside_m=0.4, back_m=70.0)
    ahead = lanes_ahead(history, Motion.of(history), crossing)
    assert ahead.offset_m[0, 0] == pytest.approx(0.4, abs=0.05)
    np.testing.assert_allclose(ahead.points[0, 0, 0], [0.0, -0.4], atol=0.05)
    step = np.linalg.norm(np.diff(ahead.points[0, 0], axis=0), axis=1)
    np.testing.assert_allclose(step[:4], ahead.spacing_m[0], rtol=0.02)


@pytest.mark.parametrize("turned", [0.3, -2.0])
def test_a_map_that_is_turned_and_moved_with_the_traffic_tells_the_same(crossing, turned):
    history = driving(crossing, approach(crossing), back_m=20.0)
    motion = Motion.of(history)
    before = lanes_ahead(history, motion, crossing)
    cos, sin = np.cos(turned), np.sin(turned)
    turn = np.array([[cos, sin], [-sin, cos]])
    lanes = tuple(
        replace(lane, centerline=lane.centerline @ turn + (500.0, -80.0)) for lane in crossing.lanes
    )
    road = replace(crossing, name=f"turned by {turned}", lanes=lanes)
    there = replace(motion, xy=motion.xy @ turn + (500.0, -80.0), heading=motion.heading + turned)
    after = lanes_ahead(history, there, road)
    np.testing.assert_array_equal(before.exists, after.exists)
    np.testing.assert_allclose(before.points, after.points, atol=1e-6)
    np.testing.assert_allclose(before.features, after.features, atol=1e-6)


def test_a_future_comes_to_its_path_and_keeps_near_it(crossing):
    history = driving(crossing, approach(crossing), back_m=20.0, aside_m=0.5)
    motion = Motion.of(history)
    ahead = lanes_ahead(history, motion, crossing)
    each = np.zeros((1, MOST, PER_PATH, PER_MODE))
    gone = np.linspace(1.0, 40.0, TIME_S.size)[None]
    own = beside_paths(each, ahead, gone, np.ones(1), motion.speed, TIME_S)
    for path in np.flatnonzero(ahead.exists[0]):
        line = ahead.points[0, path]
        fine = np.concatenate([np.linspace(a, b, 40) for a, b in itertools.pairwise(line)])
        off = np.linalg.norm(own[0, path, 0][:, None] - fine, axis=-1).min(axis=1)
        assert off[-1] < 0.8 + 0.3 * abs(ahead.offset_m[0, path])


@pytest.mark.parametrize("name", ["four_way_intersection", "roundabout", "motorway_ramps"])
def test_futures_along_lanes_begin_where_the_vehicle_is_as_it_moves(name):
    """Place and velocity go on at time 0, beside lanes, before their begin and beyond their end."""
    road = SCENARIOS[name]().road
    graph = LaneGraph.of(road)
    lanes = np.flatnonzero(graph.drivable & (graph.length > 12.0))[:20]
    time_s = np.array([0.0, 1e-3])
    for lane in lanes:
        for back_m, aside_m, speed in ((-3.0, 0.4, 8.0), (6.0, -2.0, 8.0), (6.0, 3.0, 0.0)):
            history = driving(road, lane, back_m=back_m, aside_m=aside_m, speed=speed)
            motion = Motion.of(history)
            ahead = lanes_ahead(history, motion, road)
            each = np.ones((1, MOST, PER_PATH, PER_MODE))
            gone = motion.speed[:, None] * time_s
            own = beside_paths(each, ahead, gone, np.ones(1), motion.speed, time_s)
            own = own[0, ahead.exists[0]]
            np.testing.assert_allclose(own[..., 0, :], 0.0, atol=1e-6)
            velocity = (own[..., 1, :] - own[..., 0, :]) / 1e-3
            expected = np.broadcast_to([motion.speed[0], 0.0], velocity.shape)
            np.testing.assert_allclose(velocity, expected, atol=0.05)


def test_what_leaves_all_paths_is_predicted_as_without_a_map(crossing):
    history = driving(crossing, approach(crossing), back_m=20.0)
    without = predict_recorded(history, 50, network(None))
    lanes = raw_lanes(score=0.0)
    lanes.biases[-1][-1] = 0.0
    sure = predict_recorded(history, 50, network(lanes), crossing)
    ahead = lanes_ahead(history, Motion.of(history), crossing)
    free = Futures(np.zeros((1, MODES, 10, 2)), np.ones((1, MODES, 10)), np.full((1, MODES), 1 / 6))
    raw = np.zeros((1, MOST + 1, PATH_OUTPUTS))
    nowhere = join_lanes(raw, ahead, free, np.ones(1), np.zeros(1), TIME_S)
    assert nowhere is free  # nobody is trusted
    assert not np.allclose(sure.xy, without.xy)
    away = history.with_dense(xy=history.xy + 1000.0)
    np.testing.assert_array_equal(
        predict_recorded(away, 50, network(lanes), crossing).xy,
        predict_recorded(away, 50, network(lanes)).xy,
    )
