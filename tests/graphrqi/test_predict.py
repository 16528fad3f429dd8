"""Predictions on hand-made scenes with known answers, and one contract over all predictors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from graphrqi.networks.weights import save_weights
from graphrqi.posterior import Posterior
from graphrqi.predict import PREDICTORS, predict
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.rollout.driver_table import (
    DRIVER_FIELDS,
    DriverParameters,
    DriverTable,
    initial_table,
    load_table,
    save_table,
)
from graphrqi.predict.rollout.following import agreement
from graphrqi.predict.rollout.rollout import positions, roll
from graphrqi.predict.scene.scene import make_scene
from graphrqi.predict.scene.stop_constraints import PROCEED, STOP
from scenarios import SCENARIOS
from sim.frames import PEDESTRIAN, Frame, Signal, Tracks

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))


@pytest.fixture(scope="module")
def straight():
    return SCENARIOS["straight_road"]().road


@pytest.fixture(scope="module")
def four_way():
    return SCENARIOS["four_way_intersection"]().road


def history(xy, heading, speed, *, accel=0.0, kind=None, signals=None, seconds=1.0, end_s=100.0):
    """Agents that have kept heading and acceleration until now."""
    xy, heading = np.array(xy, dtype=float), np.array(heading, dtype=float)
    speed = np.array(speed, dtype=float)
    n = len(xy)
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    frames = []
    for ago in np.arange(round(seconds * 10), -1, -1) / 10:
        past = speed - accel * ago
        frames.append(
            Frame(
                time_s=end_s - ago,
                ids=np.arange(n) * 3,
                xy=xy - ((speed + past) / 2 * ago)[:, None] * facing,
                heading=heading,
                speed=past,
                length=np.full(n, 4.5),
                width=np.full(n, 1.8),
                kind=np.zeros(n) if kind is None else np.array(kind),
                signals=np.empty(0) if signals is None else np.array(signals),
            )
        )
    return Tracks.from_frames(frames, {3 * i: Behavior.CAREFUL for i in range(n)})


def on_lane(road, lane, s, offset=0.0):
    """Place and heading at a distance along a lane, by its id."""
    line = next(x.centerline for x in road.lanes if x.id == lane)
    forward = line[-1] - line[0]
    forward = forward / np.hypot(*forward)
    left = np.array([-forward[1], forward[0]])
    return line[0] + s * forward + offset * left, float(np.arctan2(forward[1], forward[0]))


def driver(scene, **numbers) -> DriverParameters:
    """Everyone drives by the profiles' average but for some numbers, and keeps its lane."""
    average = dict(
        zip(DRIVER_FIELDS, np.exp(np.log(initial_table().behavior).mean(axis=0)), strict=True)
    )
    n = scene.ids.size
    return DriverParameters(
        following=np.tile([{**average, **numbers}[f] for f in DRIVER_FIELDS], (n, 1)),
        ignores=np.zeros((n, 2), dtype=bool),
    )


def believing(ids, behavior: Behavior) -> Posterior:
    ids = np.asarray(ids)
    return Posterior(ids, np.tile(np.eye(len(BEHAVIORS))[behavior.code], (ids.size, 1)))


@pytest.mark.parametrize("name", PREDICTORS)
def test_every_predictor_keeps_the_contract(name, four_way):
    place, heading = on_lane(four_way, "west_in_1", 60.0)
    other, _ = on_lane(four_way, "west_in_1", 30.0)
    past = history(
        [place, other, [5.0, -12.0], [400.0, 400.0]],
        [heading, heading, 1.0, 0.3],
        [9.0, 12.0, 1.3, 20.0],
        kind=[0, 0, PEDESTRIAN, 0],
        signals=np.full(len(four_way.signal_groups), Signal.GREEN.code),
    )
    told = predict(past, NOBODY, four_way, horizon_s=4.0, predictor=name)
    assert told.ids.tolist() == [0, 3, 6, 9]
    assert told.time_s == pytest.approx(np.arange(1, 41) * 0.1)
    assert told.xy.shape == (4, told.modes, 40, 2)
    assert np.isfinite(told.xy).all()
    assert told.probability.sum(axis=1) == pytest.approx(1.0)
    first_step = np.linalg.norm(told.xy[:, :, 0] - past.xy[:, None, -1], axis=2)
    assert (first_step <= past.speed[:, -1][:, None] * 0.1 + 0.25).all()
    again = predict(past, NOBODY, four_way, horizon_s=4.0, predictor=name)
    assert np.array_equal(told.xy, again.xy)


@pytest.mark.parametrize("name", PREDICTORS)
def test_nobody_present_predicts_nobody(name, straight):
    empty = history(np.empty((0, 2)), [], [])
    assert predict(empty, NOBODY, straight, predictor=name).xy.shape[0] == 0


def test_constant_velocity_goes_straight_on(straight):
    told = predict(
        history([[100.0, 50.0]], [np.pi / 2], [4.0]),
        NOBODY,
        straight,
        predictor="constant-velocity",
    )
    assert told.xy[0, 0, -1] == pytest.approx([100.0, 70.0])


def test_constant_acceleration_stops_rather_than_reverses(straight):
    past = history([[100.0, 0.0]], [0.0], [4.0], accel=-2.0)
    told = predict(past, NOBODY, straight, predictor="constant-acceleration")
    assert told.xy[0, 0, -1] == pytest.approx([104.0, 0.0], abs=1e-6)


def free_scene(road, speed=10.0, accel=0.0, lane="east_in_1", s=60.0):
    place, heading = on_lane(road, lane, s)
    return make_scene(history([place], [heading], [speed], accel=accel), road)


def test_free_driver_reaches_its_wished_speed(straight):
    scene = free_scene(straight)
    result = roll(scene, driver(scene, speed_factor=1.0, max_accel_mps2=2.0), decay_s=0.0)
    assert result.speed[0, 9] == pytest.approx(12.0)
    assert result.speed[0, -1] == pytest.approx(13.89)
    assert np.diff(result.travelled[0]) == pytest.approx(
        (result.speed[0, 1:] + result.speed[0, :-1]) / 20
    )


def test_residual_acceleration_fades(straight):
    scene = free_scene(straight, speed=5.0, accel=2.0)
    drivers = driver(scene, speed_factor=1.5, max_accel_mps2=1.0)
    lasting = roll(scene, drivers, decay_s=2.0)
    gained = np.diff(lasting.speed[0], prepend=5.0) / 0.1
    assert gained == pytest.approx(1.0 + np.exp(-np.arange(50) * 0.1 / 2.0))


def test_followers_stop_behind_a_standing_vehicle_in_the_order_of_their_gaps(straight):
    a, heading = on_lane(straight, "east_in_1", 150.0)
    b, _ = on_lane(straight, "east_in_1", 100.0)
    scene = make_scene(history([a, b], [heading] * 2, [0.0, 13.0]), straight, horizon_s=15.0)
    scene = dataclasses.replace(scene, accel=np.zeros(2))
    gaps = []
    for min_gap in (1.0, 3.0):
        drivers = driver(scene, min_gap_m=min_gap, max_accel_mps2=2.0)
        drivers.following[0, 3] = 1e-6  # the leader stays
        result = roll(scene, drivers, decay_s=0.0)
        gaps.append(result.s[0, -1] - result.s[1, -1] - 4.5)
        assert result.speed[1, -1] < 0.1
    assert gaps == pytest.approx([1.0, 3.0], abs=0.3)


def test_longer_headway_keeps_a_longer_gap(straight):
    a, heading = on_lane(straight, "east_in_1", 90.0)
    b, _ = on_lane(straight, "east_in_1", 60.0)
    past = history([a, b], [heading] * 2, [10.0, 12.0])
    scene = make_scene(past, straight, horizon_s=10.0)
    final = []
    for headway in (0.5, 2.5):
        drivers = driver(scene, time_headway_s=headway)
        drivers.following[0, 0] = 10.0 / 13.89
        result = roll(dataclasses.replace(scene, accel=np.zeros(2)), drivers, decay_s=0.0)
        final.append(result.s[0, -1] - result.s[1, -1])
    assert final[1] > final[0] + 10.0


def test_stops_at_red_and_goes_at_green(four_way):
    group = next(
        c.signal for c in four_way.connections if c.from_lane == "west_in_2" and c.signal >= 0
    )
    length = next(x.length_m for x in four_way.lanes if x.id == "west_in_2")
    place, heading = on_lane(four_way, "west_in_2", length - 40.0)
    scene = make_scene(history([place], [heading], [12.0]), four_way, horizon_s=8.0)
    ends = {}
    for state in (STOP, PROCEED):
        closed = scene.stop_state.copy()
        closed[group] = state
        ends[state] = roll(
            dataclasses.replace(scene, stop_state=closed), driver(scene), decay_s=0.0
        )
    assert ends[STOP].speed[0, -1] < 0.5
    assert ends[STOP].travelled[0, -1] <= 40.0 - 2.25 + 1e-6
    assert ends[PROCEED].travelled[0, -1] > 50.0


def test_who_cannot_stop_any_more_goes_through(four_way):
    length = next(x.length_m for x in four_way.lanes if x.id == "west_in_2")
    place, heading = on_lane(four_way, "west_in_2", length - 6.0)
    scene = make_scene(history([place], [heading], [13.0]), four_way)
    closed = np.zeros_like(scene.stop_state)
    closed[: len(four_way.signal_groups)] = STOP
    result = roll(dataclasses.replace(scene, stop_state=closed), driver(scene), decay_s=0.0)
    assert result.travelled[0, -1] > 26.0


def test_waits_for_a_pedestrian_and_reckless_does_not(straight):
    crossing = straight.crossings[0]
    lane = "east_in_2"
    length = next(x.length_m for x in straight.lanes if x.id == lane)
    place, heading = on_lane(straight, lane, length - 45.0)
    line = crossing.centerline
    toward = (line[-1] - line[0]) / np.hypot(*(line[-1] - line[0]))
    walk = float(np.arctan2(toward[1], toward[0]))
    past = history(
        [place, line[0] + 1.0 * toward], [heading, walk], [11.0, 1.0], kind=[0, PEDESTRIAN]
    )
    ends = {}
    for behavior in (Behavior.CAREFUL, Behavior.RECKLESS):
        told = predict(past, believing([0], behavior), straight, predictor="car-following")
        ends[behavior] = told.xy[0, 0, -1, 0]
    assert ends[Behavior.RECKLESS] > place[0] + 45.0
    assert ends[Behavior.CAREFUL] < place[0] + 45.0


def test_aggressive_belief_predicts_farther_than_timid_on_a_free_road(straight):
    place, heading = on_lane(straight, "east_in_1", 60.0)
    past = history([place], [heading], [8.0], accel=1.0)
    ends = [
        predict(past, believing([0], b), straight, predictor="car-following").xy[0, 0, -1, 0]
        for b in (Behavior.IMPATIENT, Behavior.RECKLESS, Behavior.CAREFUL, Behavior.TIMID)
    ]
    assert min(ends[:2]) > ends[2] > ends[3]


def test_blind_does_not_listen(straight):
    place, heading = on_lane(straight, "east_in_1", 60.0)
    past = history([place], [heading], [8.0])
    one, other = (
        predict(past, believing([0], b), straight, predictor="car-following-blind").xy
        for b in (Behavior.THREATENING, Behavior.TIMID)
    )
    assert np.array_equal(one, other)


def test_places_follow_the_lane_and_return_to_its_centre(straight):
    place, heading = on_lane(straight, "east_in_2", 60.0, offset=0.5)
    scene = make_scene(history([place], [heading], [10.0]), straight)
    xy = positions(scene, roll(scene, driver(scene), decay_s=0.0))
    centre, _ = on_lane(straight, "east_in_2", 0.0)
    assert xy[0, 0, 1] - centre[1] == pytest.approx(0.5, abs=0.06)
    assert xy[0, -1, 1] - centre[1] == pytest.approx(0.0, abs=0.05)


def test_signals_follow_their_programme(four_way):
    plan = four_way.signal_plans[0]
    change_s = plan.duration_s[0] + 1000 * sum(plan.duration_s)
    place, heading = on_lane(four_way, four_way.connections[0].from_lane, 100.0)
    frames = []
    for time_s in np.arange(change_s - 6.0, change_s - 2.0, 0.1):
        signals = np.zeros(len(four_way.signal_groups), dtype=np.int8)
        signals[list(plan.groups)] = plan.state_at(time_s)
        frames.append(
            Frame(
                time_s=time_s, ids=[0], xy=[place], heading=[heading], speed=[1.0], length=[4.0],
                width=[2.0], kind=[0], signals=signals,
            )
        )  # fmt: skip
    scene = make_scene(Tracks.from_frames(frames), four_way)
    gate = {0: STOP, 1: 1, 2: PROCEED, 3: PROCEED}
    for j, group in enumerate(plan.groups):
        assert scene.stop_state[group, 0] == gate[plan.states[0][j]]
        assert scene.stop_state[group, -1] == gate[plan.state_at(change_s + 2.9)[j]]


def test_signals_off_their_programme_are_held(four_way):
    red = np.full(len(four_way.signal_groups), Signal.RED.code)
    scene = make_scene(history([[0.0, 0.0]], [0.0], [1.0], signals=red), four_way)
    groups = len(four_way.signal_groups)
    assert (scene.stop_state[:groups] == STOP).all()


def test_wrong_input_is_refused_by_name(straight):
    past = history([[0.0, 0.0]], [0.0], [1.0])
    with pytest.raises(InputError, match="did you mean 'car-following'"):
        predict(past, NOBODY, straight, predictor="car-folowing")
    with pytest.raises(InputError, match="horizon_s: found 0"):
        predict(past, NOBODY, straight, horizon_s=0)
    with pytest.raises(InputError, match="horizon_s: found '5'"):
        predict(past, NOBODY, straight, horizon_s="5")
    for unknown in ("time_s", "xy", "heading", "speed", "length", "width"):
        nothing = {unknown: np.full_like(getattr(past, unknown), np.nan)}
        dense = unknown in ("xy", "heading", "speed")
        blank = past.with_dense(**nothing) if dense else dataclasses.replace(past, **nothing)
        for road in (straight, None):
            with pytest.raises(InputError, match=rf"history\.{unknown}: found"):
                predict(blank, NOBODY, road)
    with pytest.raises(InputError, match=r"Prediction\.xy"):
        Prediction([1], [1.0], np.zeros((2, 1, 1, 2)), [[1.0]])
    with pytest.raises(InputError, match="not finite"):
        Prediction([1], [1.0], np.full((1, 1, 1, 2), np.nan), [[1.0]])
    with pytest.raises(InputError, match="sum to 1"):
        Prediction([1], [1.0], np.zeros((1, 2, 1, 2)), [[0.2, 0.2]])
    with pytest.raises(InputError, match="negative ones"):
        Prediction([1], [1.0], np.zeros((1, 2, 1, 2)), [[-0.5, 1.5]])
    with pytest.raises(InputError, match=r"Prediction\.ids"):
        Prediction([1, 1], [1.0], np.zeros((2, 1, 1, 2)), [[1.0]] * 2)
    with pytest.raises(InputError, match=r"Prediction\.spread"):
        Prediction([1], [1.0], np.zeros((1, 1, 1, 2)), [[1.0]], np.zeros((1, 1, 1)))


def test_driver_numbers_survive_their_file(tmp_path):
    table, path = load_table(), tmp_path / "drivers.safetensors"
    save_table(path, table, {})
    again = load_table(path)
    assert np.array_equal(again.behavior, table.behavior)
    assert np.array_equal(again.average, table.average)
    assert again.decay_s == table.decay_s


def test_broken_driver_files_are_refused(tmp_path):
    save_weights(tmp_path / "drivers.safetensors", "drivers", {}, {})
    with pytest.raises(InputError, match="expected weights of the kind 'drivers'"):
        load_table(tmp_path / "drivers.safetensors")


def test_calibrated_profiles_are_ordered_as_the_behaviours_are():
    table = load_table()
    assert isinstance(table, DriverTable)
    headway = table.behavior[:, DRIVER_FIELDS.index("time_headway_s")]
    aggressive, conservative = headway[:3], headway[3:]
    assert aggressive.max() < conservative.min()


def test_every_predictor_is_found():
    assert all(callable(one) for one in PREDICTORS.values())


def test_beliefs_agree_with_what_drivers_are_seen_doing(straight):
    table = load_table()
    wish = dict(zip(BEHAVIORS, table.behavior[:, 0], strict=True))
    fast, slow = max(wish, key=wish.__getitem__), min(wish, key=wish.__getitem__)
    a, heading = on_lane(straight, "east_in_1", 60.0)
    b, _ = on_lane(straight, "east_in_2", 60.0)
    speed = float(wish[fast]) * 13.89
    scene = make_scene(history([a, b], [heading] * 2, [speed] * 2, seconds=5.0), straight)
    asked = np.zeros((len(BEHAVIORS), 2))
    right, wrong, half = (
        agreement(scene, np.eye(len(BEHAVIORS))[codes], asked, table)
        for codes in ([fast.code] * 2, [slow.code] * 2, [fast.code, slow.code])
    )
    assert (right > 0).all()
    assert (wrong < 0).all()
    assert half[0, 0] == right[0, 0]
    assert half[0, 1] == wrong[1, 0]
    unknown = np.full((2, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
    assert (agreement(scene, unknown, asked, table) == 0).all()


def test_scenes_and_predictions_say_what_they_hold(straight):
    place, heading = on_lane(straight, "east_in_1", 60.0)
    past = history([place, [400.0, 400.0]], [heading, 0.0], [10.0, 5.0])
    scene = repr(make_scene(past, straight))
    assert "2 agents, 1 of them on a path, at 100 s" in scene
    assert len(scene) < 400
    found = predict(past, NOBODY, straight, predictor="graphrqi-predict")
    assert repr(found) == "Prediction(2 agents, 6 futures each, 50 times up to 5 s, with spread)"


@pytest.mark.parametrize("name", ["lstm", "graphrqi-predict"])
def test_networks_go_on_after_their_last_knot(name, straight):
    place, heading = on_lane(straight, "east_in_1", 60.0)
    past = history([place], [heading], [10.0])
    far, near = (predict(past, NOBODY, straight, h, name) for h in (8.0, 5.0))
    assert far.xy.shape[2] == 80
    assert far.until(5.0).xy == pytest.approx(near.xy)
