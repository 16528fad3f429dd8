"""Prediction for recordings: the base, what noise does to it, neighbours, and the fallbacks."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict import PREDICTORS, predict
from graphrqi.predict.networks import MODES, Perceptron
from graphrqi.predict.recorded.features import (
    QUEUE,
    feature_count,
    features_of,
    inferred_leaders,
    neighbour_slots,
    plausible,
)
from graphrqi.predict.recorded.motion import Motion, fading
from graphrqi.predict.recorded.network import (
    PER_MODE,
    RecordedNetwork,
    TrainedRange,
    load_network,
    trained_network,
)
from graphrqi.predict.recorded.predictor import predict_recorded
from scenarios import SCENARIOS
from sim.frames import PEDESTRIAN, Frame, Tracks

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
RULES = ("constant-velocity", "constant-acceleration", "kalman")


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
    return tracks.with_dense(
        xy=xy, speed=np.hypot(step[..., 0], step[..., 1]),
        heading=np.arctan2(step[..., 1], step[..., 0]),
    )  # fmt: skip


def ends(tracks: Tracks, predictor: str):
    return predict(tracks, NOBODY, None, predictor=predictor).best[:, -1]


def base_ends(tracks: Tracks):
    """Where the base of the predictor for recordings has everyone in five seconds."""
    motion = Motion.of(tracks)
    return motion.from_own_frame(fading(motion, np.array([5.0])))[:, 0]


def raw_network(raw, trained=None) -> RecordedNetwork:
    """A network that always answers the same."""
    count = feature_count()
    free = Perceptron(
        np.zeros(count), np.ones(count), (np.zeros((count, raw.size), np.float32),),
        (raw.astype(np.float32).ravel(),),
    )  # fmt: skip
    return RecordedNetwork(free, 1.0, trained or TrainedRange(40.0, 0.3, 5.0, 0.6))


def test_leaders_are_found_in_the_own_line_only():
    tracks = recording([0, 30, 20, 60], [10, 10, 10, 10], y=[0.0, 0.3, 3.5, 0.0])
    leader, gap = inferred_leaders(tracks)
    assert leader.tolist() == [1, 3, -1, -1]
    assert gap[:2] == pytest.approx([25.5, 25.5])


def test_neighbours_are_told_apart():
    tracks = recording([0, 30, -20, 10, -10, 15, -15], [10] * 7, y=[0, 0, 0, 3.5, 3.5, -3.5, -3.5])
    rows, gaps = neighbour_slots(tracks, Motion.of(tracks))
    assert rows[0].tolist() == [1, 2, 3, 4, 5, 6]
    assert gaps[0] == pytest.approx([25.5, 15.5, 5.5, 5.5, 10.5, 10.5], abs=0.1)


def test_a_vehicle_that_is_overtaken_by_nobody_has_no_neighbours():
    rows, gaps = neighbour_slots(recording([0.0], [10.0]), Motion.of(recording([0.0], [10.0])))
    assert (rows == -1).all()
    assert np.isinf(gaps).all()


def test_a_queue_that_dissolves_is_seen_by_who_still_stands():
    waiting = recording([0, 10, 20, 30], [0.0] * 4)
    starting = recording([0, 10, 20, 30], [0, 0, 0, 3.0], accel=np.array([0, 0, 0, 1.0]))
    queue = slice(-QUEUE, None)
    stands, starts = (features_of(one, Motion.of(one))[0, queue] for one in (waiting, starting))
    assert stands[[0, 1, 3, 6, 7, 8, 9]] == pytest.approx(0.0, abs=1e-6)
    assert starts[3] == pytest.approx(1.0, abs=0.05)  # the third ahead gains speed,
    assert starts[5] == pytest.approx(-3.0 / 5.0, abs=0.02)  # is faster,
    assert starts[6] == pytest.approx(3.0 / 5.0, abs=0.02)  # and the fastest of them
    assert starts[8] == pytest.approx(1.0 / 3.0, abs=0.02)
    alone = features_of(starting, Motion.of(starting), believable=False)
    assert not alone[:, queue].any()


def test_weights_for_other_inputs_are_refused(tmp_path):
    other = raw_network(np.zeros((MODES, PER_MODE)))
    count = feature_count() - QUEUE
    free = other.free
    free = replace(free, mean=free.mean[:count], weights=(free.weights[0][:count],))
    cut = replace(other, free=free)
    cut.save(tmp_path / "old.safetensors", {})
    with pytest.raises(InputError, match=r"old.safetensors: found a network with .* train it anew"):
        load_network(tmp_path / "old.safetensors")


@pytest.mark.parametrize("rule", RULES)
def test_steady_drivers_keep_their_speed(rule):
    assert ends(recording([0.0], [12.0]), rule)[0] == pytest.approx([60.0, 0.0], abs=1e-3)


def test_an_acceleration_fades():
    end = base_ends(recording([0.0], [8.0], accel=1.0))[0, 0]
    whole = 40.0 + 2.5 * (5.0 - 2.5 * (1.0 - np.exp(-5.0 / 2.5)))  # 1 m/s2 that fades in 2.5 s
    assert 44.0 < end < whole + 0.6


def test_constant_acceleration_is_what_the_kalman_filter_keeps():
    end = ends(recording([0.0], [8.0], accel=1.0), "kalman")[0, 0]
    assert end == pytest.approx(40.0 + 12.5, abs=1.0)


@pytest.mark.parametrize("rule", [*RULES, "graphrqi-predict"])
def test_who_brakes_does_not_reverse(rule):
    told = predict(recording([0.0], [1.0], accel=-3.0), NOBODY, None, predictor=rule)
    assert (told.xy[0, :, -1, 0] > -0.5).all()


def test_a_turn_goes_on_and_fades():
    end = base_ends(turning())[0]
    turned = 0.4 * 0.3 * 1.0  # a share of the rate, fading in 1 s: rad
    assert np.arctan2(end[1], end[0]) == pytest.approx(turned, rel=0.35)
    assert base_ends(turning(-0.3))[0, 1] == pytest.approx(-end[1])


def test_yaw_rates_are_measured():
    assert Motion.of(turning(0.3)).yaw_rate == pytest.approx([0.3], abs=0.05)
    assert Motion.of(recording([0.0], [10.0])).yaw_rate == pytest.approx([0.0], abs=1e-6)


@pytest.mark.parametrize("missing", [(), (5, 11, 12, 20)])
def test_noise_is_measured(missing):
    tracks = recording([0.0, 40.0, 80.0], [12.0, 11.0, 10.0], accel=0.5)
    keep = np.setdiff1d(np.arange(tracks.time_s.size), missing)
    clean = tracks.part(np.arange(3), keep)
    assert Motion.of(clean).noise_m == pytest.approx(0.01)
    measured = [Motion.of(shaken(tracks, 0.1, k).part(np.arange(3), keep)) for k in range(20)]
    assert np.mean([one.noise_m for one in measured]) == pytest.approx(0.1, rel=0.15)


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


def test_wrong_speeds_do_not_count():
    tracks = recording([0.0], [12.0])
    wrong = tracks.with_dense(speed=np.full_like(tracks.speed, 3.0))
    assert Motion.of(wrong).speed == pytest.approx([12.0], rel=0.05)


@pytest.mark.parametrize("noise_m", [0.0, 0.1])
def test_who_stands_stays(noise_m):
    """Standing vehicles are predicted to move by less than half a metre in five seconds."""
    off = []
    for seed in range(5):
        tracks = shaken(recording([0.0, 8.0, 40.0], [0.0, 0.0, 9.0]), noise_m, seed)
        told = predict(tracks, NOBODY, None)
        off.append(np.linalg.norm(told.best[:2, -1] - tracks.xy[:2, 25:].mean(axis=1), axis=-1))
    assert np.mean(off) < 0.5


def test_accelerations_that_did_not_last_do_not_count():
    """Where speeds jump between key frames, what looks like an acceleration says nothing."""
    tracks = recording([0.0, 60.0], [10.0, 10.0])
    jumps = np.where(np.arange(tracks.time_s.size) // 10 % 2 == 0, 1.0, -1.0)
    speed = tracks.speed + jumps
    way = np.cumsum(speed * 0.1, axis=1)
    xy = tracks.xy.copy()
    xy[..., 0] = xy[:, :1, 0] + way
    jumping = tracks.with_dense(xy=xy, speed=speed)
    steady = Motion.of(recording([0.0], [8.0], accel=1.0))
    assert abs(steady.accel[0]) > 0.8 * abs(steady.accel_now[0])
    assert np.all(np.abs(Motion.of(jumping).accel) < 0.6)


def test_coarse_recordings_are_read():
    fine = recording([0.0], [10.0], accel=1.0)
    coarse = recording([0.0], [10.0], accel=1.0, step_s=0.5)
    assert base_ends(coarse)[0] == pytest.approx(base_ends(fine)[0], abs=0.5)


def test_gaps_in_a_track_are_bridged():
    tracks = recording([0.0, 60.0], [10.0, 10.0])
    valid = tracks.valid.copy()
    valid[0, [3, 4, 18, 19]] = False
    gappy = tracks.with_dense(valid=valid, xy=np.where(valid[..., None], tracks.xy, np.nan))
    assert base_ends(gappy)[0] == pytest.approx([50.0, 0.0], abs=1e-3)
    assert np.isfinite(features_of(gappy, Motion.of(gappy))).all()


def test_implausible_gaps_switch_neighbours_off():
    overlapping = recording([0.0, 2.0, 50.0, 52.0], [12.0, 5.0, 12.0, 5.0])
    assert not plausible(overlapping)
    assert plausible(recording([0.0, 25.0], [12.0, 5.0]))
    motion = Motion.of(overlapping)
    alone = features_of(overlapping, motion, believable=False)
    assert not np.allclose(features_of(overlapping, motion)[0], alone[0])
    single = recording([0.0], [12.0])
    assert np.allclose(features_of(single, Motion.of(single), believable=False)[0], alone[0])


def test_parked_vehicles_tell_nothing_of_clocks():
    assert plausible(recording([0.0, 3.0], [0.0, 0.0]))
    assert not plausible(recording([0.0, 3.0], [5.0, 0.0]))


def test_features_are_as_many_as_told():
    tracks = recording([0.0, 25.0], [12.0, 5.0])
    assert features_of(tracks, Motion.of(tracks)).shape == (2, feature_count())


@pytest.mark.parametrize("name", ["theirs", "car-following", "car-following-blind", "lstm"])
def test_a_predictor_that_needs_a_map_says_so(name, monkeypatch):
    monkeypatch.setitem(PREDICTORS, "theirs", PREDICTORS["constant-velocity"])
    with pytest.raises(InputError, match=f"road: found none for the predictor '{name}', expected"):
        predict(recording([0.0], [10.0]), NOBODY, None, predictor=name)


@pytest.mark.parametrize("name", ["constant-velocity", "constant-acceleration", "kalman"])
def test_a_predictor_that_needs_no_map_is_the_same_with_and_without(name):
    tracks = recording([50.0, 80.0], [10.0, 8.0], accel=-0.5)
    road = SCENARIOS["straight_road"]().road
    one, other = (predict(tracks, NOBODY, where, predictor=name) for where in (road, None))
    assert np.array_equal(one.xy, other.xy)
    assert not np.array_equal(other.best, predict(tracks, NOBODY, None).best)


def test_a_scene_that_is_turned_and_moved_is_predicted_the_same():
    tracks = recording([0.0, 25.0, 8.0], [12.0, 9.0, 10.0], y=[0.0, 0.0, 3.5], accel=-0.5)
    told = predict(tracks, NOBODY, None)
    angle, shift = 2.1, np.array([500.0, -80.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    heading = (tracks.heading + angle + np.pi) % (2 * np.pi) - np.pi
    moved = tracks.with_dense(xy=tracks.xy @ turn.T + shift, heading=heading)
    again = predict(moved, NOBODY, None)
    assert again.xy == pytest.approx(told.xy @ turn.T + shift, abs=1e-3)
    assert again.probability == pytest.approx(told.probability, abs=1e-4)


def test_a_slower_leader_slows_its_follower():
    alone = ends(recording([0.0], [12.0]), "graphrqi-predict")[0, 0]
    behind = ends(recording([0.0, 25.0], [12.0, 5.0]), "graphrqi-predict")[0, 0]
    assert behind < alone - 5.0


def test_the_first_future_is_the_likeliest():
    told = predict(recording([0.0, 25.0], [12.0, 9.0]), NOBODY, None)
    assert told.xy.shape[1] == MODES
    assert told.probability.argmax(axis=1).tolist() == [0, 0]
    assert told.probability.sum(axis=1) == pytest.approx(1.0)
    assert (np.diff(told.spread, axis=2) > -1e-9).all()


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
    base = base_ends(tracks)
    assert told.best[:, -1] == pytest.approx(np.maximum(base, [[0.0, -np.inf]]), abs=1e-6)
    assert np.ptp(told.xy[0, :, -1, 0]) > 1.0  # the fan says what else may happen


def test_inside_it_the_network_corrects_the_base():
    raw = np.zeros((MODES, PER_MODE))
    raw[0, 0] = 1.0  # the lowest power of time, ahead
    told = predict_recorded(recording([0.0], [20.0]), 50, raw_network(raw))
    assert told.best[0, -1] == pytest.approx([100.0 + 2.8, 0.0], abs=0.05)


def test_what_is_saved_loads_back_equal(tmp_path):
    network = trained_network()
    network.save(tmp_path / "again.safetensors", {"why": "test"})
    again = load_network(tmp_path / "again.safetensors")
    tracks = recording([0.0, 25.0], [12.0, 9.0])
    one, two = (predict_recorded(tracks, 50, each) for each in (network, again))
    assert np.array_equal(one.xy, two.xy)
    assert again.trained == network.trained


def test_a_file_that_is_no_network_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no\.safetensors: found no file"):
        load_network(tmp_path / "no.safetensors")
    (tmp_path / "broken.safetensors").write_bytes(b"x" * 40)
    with pytest.raises(InputError, match=r"broken\.safetensors: found .*, expected weights"):
        load_network(tmp_path / "broken.safetensors")
    nothing = dataclasses.replace(trained_network(), spread_scale=0.0)
    nothing.save(tmp_path / "nothing.safetensors", {})
    with pytest.raises(InputError, match=r"nothing\.safetensors: found spread_scale: 0"):
        load_network(tmp_path / "nothing.safetensors")


def test_constant_velocity_keeps_its_meaning():
    end = ends(recording([0.0, 25.0], [12.0, 5.0], accel=0.5), "constant-velocity")
    assert end[:, 0] == pytest.approx([60.0, 50.0])


def test_pedestrians_walk_on():
    tracks = recording([0.0, 3.0], [1.4, 0.0], kind=[PEDESTRIAN, 0])
    told = predict(tracks, NOBODY, None)
    assert told.best[0, -1, 0] == pytest.approx(7.0)
    assert told.probability.sum(axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("name", [*RULES, "graphrqi-predict"])
def test_a_single_frame_is_predicted(name):
    frame = next(iter(recording([0.0], [12.0]).frames()))
    end = ends(Tracks.from_frames([frame]), name)
    assert end[0] == pytest.approx([24.0, 0.0], abs=8.0)  # it was 36 m back


@pytest.fixture(scope="module")
def told_no_limits():
    """A straight road as a map without limits tells it."""
    road = SCENARIOS["straight_road"]().road
    return replace(road, lanes=tuple(replace(x, speed_limit_mps=np.nan) for x in road.lanes))


@pytest.fixture(scope="module")
def told_no_signals():
    """The same with limits, as a map that knows no lights tells it."""
    road = SCENARIOS["straight_road"]().road
    return replace(road, knows=replace(road.knows, signals=False))


@pytest.mark.parametrize("name", ["graphrqi-predict", "lstm"])
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


@pytest.mark.parametrize("name", ["graphrqi-predict", "lstm"])
def test_networks_for_home_leave_other_maps_to_the_one_for_recordings(
    name, told_no_limits, told_no_signals
):
    y = told_no_limits.lanes[told_no_limits.lane_index["east_in_2"]].centerline[0, 1]
    tracks = recording([50, 80], [10, 8], y=[y, y])
    for road in (told_no_limits, told_no_signals):
        expected = predict_recorded(tracks, 50, road=road).xy
        assert np.array_equal(predict(tracks, NOBODY, road, predictor=name).xy, expected)


@pytest.mark.parametrize("name", ["car-following-blind", "car-following"])
def test_where_limits_do_not_rule_nobody_is_driven_up_to_them(name):
    road = SCENARIOS["straight_road"]().road
    ignored = replace(road, knows=replace(road.knows, limits_rule=False))
    y = road.lanes[road.lane_index["east_in_2"]].centerline[0, 1]
    tracks = recording([50, 68], [6, 12], y=[y, y])  # behind another: no wish was seen
    up, kept = (predict(tracks, NOBODY, r, predictor=name) for r in (road, ignored))
    way_m = [float(told.best[0, -1, 0] - tracks.xy[0, -1, 0]) for told in (up, kept)]
    assert way_m[0] > 33.0
    assert way_m[1] == pytest.approx(30.0, abs=1.5)


@pytest.mark.parametrize("name", ["car-following-blind", "car-following"])
def test_car_following_keeps_to_the_lanes_of_a_road_without_limits(name, told_no_limits):
    y = told_no_limits.lanes[told_no_limits.lane_index["east_in_2"]].centerline[0, 1]
    told = predict(recording([50, 80], [10, 8], y=[y + 0.5, y]), NOBODY, told_no_limits,
                   predictor=name)  # fmt: skip
    assert np.isfinite(told.xy).all()
    assert told.best[:, -1, 1] == pytest.approx([y, y], abs=0.1)
    assert (told.best[:, -1, 0] > [90.0, 110.0]).all()
