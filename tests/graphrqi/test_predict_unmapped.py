"""Prediction for recordings: the base, what noise does to it, neighbours, and the fallbacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from graphrqi.predict.recorded.features import (
    feature_count,
    features_of,
)
from graphrqi.predict.recorded.motion import Motion, fading
from graphrqi.predict.recorded.network import (
    MODES,
    PER_MODE,
    RecordedNetwork,
    TrainedRange,
    load_network,
    shipped_network,
)
from graphrqi.predict.recorded.predictor import predict_recorded
from scenarios import SCENARIOS
from sim.frames import Frame, Tracks

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
RULES = ("constant-velocity", "fading", "turn-rate", "kalman")


def recording(
    x, speed, *, y=None, accel=0.0, kind=None, length=4.5, step_s=0.1, seconds=3.0
) -> Tracks:
    x, speed = np.array(x, dtype=float), np.array(speed, dtype=float)
    n = x.size
    frames = []
    for ago in np.arange(seconds, -1e-9, -step_s):
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


def turning(rate=0.3, speed=8.0, seconds=3.0) -> Tracks:
    frames = []
    for time_s in np.arange(-seconds, 1e-9, 0.1):
        angle = rate * time_s
        xy = speed / rate * np.array([[np.sin(angle), 1.0 - np.cos(angle)]])
        frames.append(
            Frame(time_s=time_s, ids=[0], xy=xy, heading=[angle], speed=[speed], length=[4.5],
                  width=[1.8], kind=[0])
        )  # fmt: skip
    return Tracks.from_frames(frames)


def shaken(tracks: Tracks, noise_m=0.1, seed=0) -> Tracks:
    """Noisy positions, and the speeds and headings that follow from them."""
    rng = np.random.default_rng(seed)
    xy = tracks.xy + rng.normal(0.0, noise_m, tracks.xy.shape)
    step = np.diff(xy, axis=1, prepend=xy[:, :1] - (xy[:, 1:2] - xy[:, :1])) / tracks.step_s
    return replace(
        tracks, xy=xy, speed=np.hypot(step[..., 0], step[..., 1]),
        heading=np.arctan2(step[..., 1], step[..., 0]),
    )  # fmt: skip


def ends(tracks: Tracks, predictor="fading"):
    return predict(tracks, NOBODY, None, predictor=predictor).best[:, -1]


def raw_network(raw, trained=None) -> RecordedNetwork:
    """A network that always answers the same."""
    count = feature_count()
    return RecordedNetwork(
        np.zeros(count), np.ones(count), (np.zeros((count, raw.size), np.float32),),
        (raw.astype(np.float32).ravel(),), 1.0, trained or TrainedRange(40.0, 0.3, 5.0, 0.6),
    )  # fmt: skip


@pytest.mark.parametrize("rule", RULES)
def test_steady_drivers_keep_their_speed(rule):
    assert ends(recording([0.0], [12.0]), rule)[0] == pytest.approx([60.0, 0.0], abs=1e-3)


def test_constant_acceleration_is_what_the_kalman_filter_keeps():
    end = ends(recording([0.0], [8.0], accel=1.0), "kalman")[0, 0]
    assert end == pytest.approx(40.0 + 12.5, abs=1.0)


@pytest.mark.parametrize("rule", [*RULES, "graphrqi-predict"])
def test_who_brakes_does_not_reverse(rule):
    told = predict(recording([0.0], [1.0], accel=-3.0), NOBODY, None, predictor=rule)
    assert (told.xy[0, :, -1, 0] > -0.5).all()


@pytest.mark.parametrize("rule", ["fading", "turn-rate"])
def test_a_turn_goes_on_and_fades(rule):
    end = ends(turning(), rule)[0]
    turned = 0.5 * 0.3 * 1.0  # half of the rate, fading in 1 s: rad
    assert np.arctan2(end[1], end[0]) == pytest.approx(turned, rel=0.35)
    assert ends(turning(-0.3), rule)[0, 1] == pytest.approx(-end[1])


def test_noise_moves_the_base_less_than_constant_velocity():
    tracks = recording([0.0, 60.0, 120.0], [12.0, 12.0, 12.0])
    time_s = np.array([5.0])
    off_base, off_steady = [], []
    for seed in range(20):
        noisy = shaken(tracks, 0.1, seed)
        motion = Motion.of(noisy)
        at = motion.from_own_frame(fading(motion, time_s))[:, 0]
        off_base.append(at - tracks.xy[:, -1] - [60.0, 0.0])
        last, before = noisy.xy[:, -1], noisy.xy[:, -6]
        off_steady.append(last + 10.0 * (last - before) - tracks.xy[:, -1] - [60.0, 0.0])
    assert np.square(off_base).mean() < 0.85 * np.square(off_steady).mean()


def test_gaps_in_a_track_are_bridged():
    tracks = recording([0.0, 60.0], [10.0, 10.0])
    valid = tracks.valid.copy()
    valid[0, [3, 4, 18, 19]] = False
    gappy = replace(tracks, valid=valid, xy=np.where(valid[..., None], tracks.xy, np.nan))
    assert ends(gappy)[0] == pytest.approx([50.0, 0.0], abs=1e-3)
    assert np.isfinite(features_of(gappy, Motion.of(gappy))).all()


def test_a_scene_that_is_turned_and_moved_is_predicted_the_same():
    tracks = recording([0.0, 25.0, 8.0], [12.0, 9.0, 10.0], y=[0.0, 0.0, 3.5], accel=-0.5)
    told = predict(tracks, NOBODY, None)
    angle, shift = 2.1, np.array([500.0, -80.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    heading = (tracks.heading + angle + np.pi) % (2 * np.pi) - np.pi
    moved = replace(tracks, xy=tracks.xy @ turn.T + shift, heading=heading)
    again = predict(moved, NOBODY, None)
    assert again.xy == pytest.approx(told.xy @ turn.T + shift, abs=1e-3)
    assert again.probability == pytest.approx(told.probability, abs=1e-4)


def test_a_slower_leader_slows_its_follower():
    alone = ends(recording([0.0], [12.0]), "graphrqi-predict")[0, 0]
    behind = ends(recording([0.0, 25.0], [12.0, 5.0]), "graphrqi-predict")[0, 0]
    assert behind < alone - 5.0


@pytest.mark.parametrize(
    "tracks",
    [
        recording([0.0], [60.0]),
        recording([0.0], [12.0], step_s=1.0, seconds=5.0),
        shaken(recording([0.0], [12.0]), noise_m=1.0),
    ],
    ids=["fast", "coarse", "noisy"],
)
def test_outside_the_trained_range_the_base_answers(tracks):
    told = predict_recorded(tracks, 50, raw_network(np.full((MODES, PER_MODE), 3.0)))
    base = ends(tracks, "fading")
    assert told.best[:, -1] == pytest.approx(np.maximum(base, [[0.0, -np.inf]]), abs=1e-6)
    assert np.ptp(told.xy[0, :, -1, 0]) > 1.0  # the fan says what else may happen


def test_inside_it_the_network_corrects_the_base():
    raw = np.zeros((MODES, PER_MODE))
    raw[0, 0] = 1.0  # the first power of time, ahead
    told = predict_recorded(recording([0.0], [20.0]), 50, raw_network(raw))
    assert told.best[0, -1] == pytest.approx([100.0 + 2.8, 0.0], abs=0.05)


def test_what_is_saved_loads_back_equal(tmp_path):
    network = shipped_network()
    network.save(tmp_path / "again.safetensors", {"why": "test"})
    again = load_network(tmp_path / "again.safetensors")
    tracks = recording([0.0, 25.0], [12.0, 9.0])
    one, two = (predict_recorded(tracks, 50, each) for each in (network, again))
    assert np.array_equal(one.xy, two.xy)
    assert again.trained == network.trained


@pytest.mark.parametrize("name", [*RULES, "graphrqi-predict"])
def test_a_single_frame_is_predicted(name):
    frame = next(iter(recording([0.0], [12.0]).frames()))
    end = ends(Tracks.from_frames([frame]), name)
    assert end[0] == pytest.approx([24.0, 0.0], abs=8.0)  # it was 36 m back


@pytest.mark.parametrize("name", ["graphrqi-predict", "lstm", "mlp"])
def test_drivers_on_fast_roads_are_predicted_as_recorded_ones(name):
    """On a motorway all of them; on a fast road those who come to no light or crossing."""
    road = SCENARIOS["motorway"](limit_mps=33.3).road
    y = next(lane for lane in road.lanes if not lane.walking).centerline[0, 1]
    tracks = recording([300, 360], [30, 25], y=[y, y])
    expected = predict_recorded(tracks, 50, road=road)
    told = predict(tracks, NOBODY, road, predictor=name)
    assert np.array_equal(told.xy, expected.xy)
    usual = SCENARIOS["straight_road"](limit_mps=13.89).road
    fast = SCENARIOS["straight_road"](limit_mps=25.0).road
    y = fast.lanes[fast.lane_index["east_in_2"]].centerline[0, 1]
    tracks = recording([50, 300], [12, 12], y=[y, y])
    for road, far_away in ((usual, False), (fast, True)):
        recorded = predict_recorded(tracks, 50, road=road).xy
        told = predict(tracks, NOBODY, road, predictor=name).xy
        assert np.array_equal(told[0], recorded[0]) == far_away
