"""Prediction without a map: leaders from the traffic, and nothing where gaps are implausible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from graphrqi.predict.map_free.motion import inferred_leaders, plausible, smooth
from graphrqi.predict.map_free.predictor import map_free_inputs, trusted_model
from scenarios import SCENARIOS
from sim.frames import PEDESTRIAN, Frame, Tracks

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))


def recording(x, speed, *, y=None, accel=0.0, kind=None, length=4.5) -> Tracks:
    x, speed = np.array(x, dtype=float), np.array(speed, dtype=float)
    n = x.size
    frames = []
    for ago in np.arange(30, -1, -1) / 10:
        past = speed - accel * ago
        frames.append(
            Frame(
                time_s=10.0 - ago, ids=np.arange(n),
                xy=np.column_stack([x - (speed + past) / 2 * ago, np.zeros(n) if y is None else y]),
                heading=np.zeros(n), speed=past, length=np.full(n, length), width=np.full(n, 1.8),
                kind=np.zeros(n) if kind is None else np.array(kind),
            )
        )  # fmt: skip
    return Tracks.from_frames(frames)


def ends(tracks: Tracks, predictor="car-following"):
    return predict(tracks, NOBODY, None, predictor=predictor).best[:, -1]


def test_leaders_are_found_in_the_own_line_only():
    tracks = recording([0, 30, 20, 60], [10, 10, 10, 10], y=[0.0, 0.3, 3.5, 0.0])
    leader, gap = inferred_leaders(tracks)
    assert leader.tolist() == [1, 3, -1, -1]
    assert gap[:2] == pytest.approx([25.5, 25.5])


def test_steady_drivers_keep_their_speed():
    assert ends(recording([0.0], [12.0]))[0] == pytest.approx([60.0, 0.0])


def test_an_acceleration_fades():
    end = ends(recording([0.0], [8.0], accel=1.0))[0, 0]
    assert 40.0 < end < 40.0 + 0.5 * 1.0 * 25.0


def test_who_brakes_does_not_reverse():
    told = predict(recording([0.0], [1.0], accel=-3.0), NOBODY, None)
    assert (told.xy[0, :, -1, 0] > -0.5).all()


def test_a_slower_leader_slows_its_follower():
    just_met = slice(-11, None)
    alone = ends(recording([0.0], [12.0]).part(np.arange(1), just_met))[0, 0]
    behind = ends(recording([0.0, 25.0], [12.0, 5.0]).part(np.arange(2), just_met))[0, 0]
    assert behind < alone - 5.0


def test_implausible_gaps_switch_leaders_off():
    overlapping = recording([0.0, 2.0, 50.0, 52.0], [12.0, 5.0, 12.0, 5.0])
    assert not plausible(overlapping)
    assert plausible(recording([0.0, 25.0], [12.0, 5.0]))
    assert ends(overlapping)[0, 0] == pytest.approx(60.0)


def test_constant_velocity_keeps_its_meaning():
    end = ends(recording([0.0, 25.0], [12.0, 5.0], accel=0.5), "constant-velocity")
    assert end[:, 0] == pytest.approx([60.0, 50.0])


def test_pedestrians_walk_on():
    tracks = recording([0.0, 3.0], [1.4, 0.0], kind=[PEDESTRIAN, 0])
    told = predict(tracks, NOBODY, None)
    assert told.xy[0, :, -1, 0] == pytest.approx(7.0)
    assert told.probability.sum(axis=1) == pytest.approx(1.0)


def jumping(seconds=5.0) -> Tracks:
    """Two vehicles that go on at 10 m/s on average while their accelerations mean nothing."""
    frames = []
    for step, time_s in enumerate(np.arange(0.0, seconds + 1e-9, 0.1)):
        speed = np.full(2, 10.0 + (1.5 if (step // 8) % 2 else -1.5))
        speed[:] = 10.0 if step >= seconds * 10 or step in (25, 26) else speed
        frames.append(
            Frame(
                time_s=time_s, ids=[0, 1], xy=[[10.0 * time_s, 0.0], [10.0 * time_s, 40.0]],
                heading=[0.0, 0.0], speed=speed, length=[4.5] * 2, width=[1.8] * 2, kind=[0, 0],
            )
        )  # fmt: skip
    return Tracks.from_frames(frames)


def test_a_past_that_only_steady_motion_explains_is_predicted_by_it():
    tracks = jumping()
    assert trusted_model(tracks, believable=False) == "steady"
    assert ends(tracks)[:, 0] == pytest.approx([100.0, 100.0])


def test_a_short_past_is_not_tried():
    assert trusted_model(recording([0.0], [12.0]), believable=True) == "own past"
    frame = next(iter(recording([0.0], [12.0]).frames()))
    alone = Tracks.from_frames([frame])
    assert trusted_model(alone, believable=True) == "own past"
    assert trusted_model(alone, believable=False) == "steady"


def test_shaken_tracks_are_taken_to_go_on_as_they_do():
    tracks = recording([0.0, 60.0, 120.0], [12.0, 11.0, 10.0], accel=1.0)
    assert smooth(tracks)
    shaken = replace(tracks, heading=tracks.heading + 0.1 * (np.arange(31) % 2))
    assert not smooth(shaken)
    assert trusted_model(shaken, believable=True) == "steady"
    slow = replace(shaken, speed=np.minimum(shaken.speed, 1.0))
    assert smooth(slow)


def test_parked_vehicles_tell_nothing_of_clocks():
    assert plausible(recording([0.0, 3.0], [0.0, 0.0]))
    assert not plausible(recording([0.0, 3.0], [5.0, 0.0]))


def test_the_network_sees_no_neighbours_where_gaps_are_implausible():
    tracks = recording([0.0, 25.0], [12.0, 5.0])
    seen, alone = (map_free_inputs(tracks, believable).features for believable in (True, False))
    follower = recording([0.0], [12.0])
    assert not np.allclose(seen[0], alone[0])
    assert np.allclose(alone[0], map_free_inputs(follower, believable=False).features[0])


@pytest.fixture(scope="module")
def told_no_limits():
    """A straight road as a map without limits tells it."""
    road = SCENARIOS["straight_road"]().road
    return replace(road, lanes=tuple(replace(x, speed_limit_mps=np.nan) for x in road.lanes))


@pytest.mark.parametrize("name", ["graphrqi-predict", "graphrqi-predict-unlabelled", "lstm", "mlp"])
def test_networks_take_a_road_without_limits_for_none(name, told_no_limits):
    y = told_no_limits.lanes[told_no_limits.lane_index["east_in_2"]].centerline[0, 1]
    tracks = recording([50, 80], [10, 8], y=[y, y])
    with_road = predict(tracks, NOBODY, told_no_limits, predictor=name)
    assert np.array_equal(with_road.xy, predict(tracks, NOBODY, None, predictor=name).xy)


@pytest.mark.parametrize("name", ["car-following-blind", "behavior-mixture"])
def test_car_following_keeps_to_the_lanes_of_a_road_without_limits(name, told_no_limits):
    y = told_no_limits.lanes[told_no_limits.lane_index["east_in_2"]].centerline[0, 1]
    told = predict(recording([50, 80], [10, 8], y=[y + 0.5, y]), NOBODY, told_no_limits,
                   predictor=name)  # fmt: skip
    assert np.isfinite(told.xy).all()
    assert told.best[:, -1, 1] == pytest.approx([y, y], abs=0.1)
    assert (told.best[:, -1, 0] > [90.0, 110.0]).all()
