"""Realism: the features and likelihoods equal a slow reference, and what happened is likeliest."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from behaviors.driver_models import idm_desired_gap, idm_free_acceleration, idm_interaction
from behaviors.errors import InputError
from experiments.benches.realism.bench import BENCH, Settings, _simulated
from experiments.benches.realism.distances import distances, lane_changes
from experiments.benches.realism.kernels import drive_on
from experiments.benches.realism.likelihood import (
    FEATURES,
    Histogram,
    Motion,
    features,
    kinematics,
    likelihoods,
    log_likelihood,
    road_edge,
)
from experiments.benches.realism.simulators import SIMULATORS, simulate
from experiments.benches.realism.start import Start, starts

VEHICLES, STEPS, PAST, FUTURES, STEP_S = 5, 14, 4, 4, 0.1


def motion(rng: np.random.Generator) -> Motion:
    """Vehicles that wander about close to each other; some are not there all the time."""
    speed = rng.uniform(0.0, 12.0, (VEHICLES, 1)) + rng.normal(0.0, 0.5, (VEHICLES, STEPS))
    heading = rng.choice([0.0, 0.1, 1.5, 3.1], (VEHICLES, 1))
    heading = heading + 0.05 * rng.standard_normal((VEHICLES, STEPS)).cumsum(axis=1)
    step = speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1) * STEP_S
    xy = rng.uniform(-12.0, 12.0, (VEHICLES, 1, 2)) * [1.0, 0.2] + step.cumsum(axis=1)
    valid = np.ones((VEHICLES, STEPS), dtype=bool)
    valid[1, 11:] = False
    valid[2, 7] = False
    wrapped = (heading + np.pi) % (2.0 * np.pi) - np.pi
    length, width = rng.uniform(3.0, 12.0, VEHICLES), rng.uniform(1.6, 2.5, VEHICLES)
    return Motion(xy, wrapped, valid, length, width, STEP_S, PAST)


def corners(one: Motion, i: int, t: int, cut: float) -> list[tuple[float, float]]:
    x, y = one.xy[i, t]
    c, s = math.cos(one.heading[i, t]), math.sin(one.heading[i, t])
    long, wide = one.length[i] / 2.0 - cut, one.width[i] / 2.0 - cut
    places = [(long, wide), (-long, wide), (-long, -wide), (long, -wide)]
    return [(x + c * a - s * b, y + s * a + c * b) for a, b in places]


def apart(one: Motion, i: int, j: int, t: int) -> float:
    """Signed distance of two outlines, from the hull of the differences of their corners."""
    cuts = [0.7 * min(one.length[k], one.width[k]) / 2.0 for k in (i, j)]
    a, b = (corners(one, k, t, cut) for k, cut in zip((i, j), cuts, strict=True))
    hull = ConvexHull([(p[0] - q[0], p[1] - q[1]) for p in a for q in b])
    depth = float(hull.equations[:, 2].max())
    if depth > 0.0:  # the origin is outside
        depth = math.inf
        for edge in hull.simplices:
            p, q = hull.points[edge]
            share = np.clip(-(p @ (q - p)) / ((q - p) @ (q - p)), 0.0, 1.0)
            depth = min(depth, float(np.linalg.norm(p + share * (q - p))))
    return depth - sum(cuts)


def slow_features(one: Motion) -> dict[str, np.ndarray]:
    """Every feature but the road's, one vehicle and step at a time."""
    names = [name for name in FEATURES if "road" not in name and "indication" not in name]
    found = {name: np.full((VEHICLES, STEPS), np.nan) for name in names}
    h = one.step_s

    def there(i: int, *steps: int) -> bool:
        return all(0 <= t < STEPS and one.valid[i, t] for t in steps)

    def speed(i: int, t: int) -> float:
        if not there(i, t - 1, t + 1):
            return math.nan
        return math.dist(one.xy[i, t + 1], one.xy[i, t - 1]) / (2.0 * h)

    def turn(i: int, t: int) -> float:
        if not there(i, t - 1, t + 1):
            return math.nan
        change = one.heading[i, t + 1] - one.heading[i, t - 1]
        return math.atan2(math.sin(change), math.cos(change)) / (2.0 * h)

    for i in range(VEHICLES):
        for t in range(STEPS):
            found["linear_speed"][i, t] = speed(i, t)
            found["angular_speed"][i, t] = turn(i, t)
            found["linear_acceleration"][i, t] = (speed(i, t + 1) - speed(i, t - 1)) / (2.0 * h)
            found["angular_acceleration"][i, t] = (turn(i, t + 1) - turn(i, t - 1)) / (2.0 * h)
            near, ahead, ttc = math.inf, math.inf, 5.0
            for j in range(VEHICLES):
                if i == j or not (there(i, t) and there(j, t)):
                    continue
                near = min(near, apart(one, i, j, t))
                angle = one.heading[j, t] - one.heading[i, t]
                angle = abs(math.atan2(math.sin(angle), math.cos(angle)))
                c, s = math.cos(one.heading[i, t]), math.sin(one.heading[i, t])
                places = corners(one, j, t, 0.0) - one.xy[i, t]
                long = min(places @ (c, s)) - one.length[i] / 2.0
                side = places @ (-s, c)
                middle = abs(0.5 * (side.max() + side.min()))
                across = middle - 0.5 * (side.max() - side.min()) - one.width[i] / 2.0
                follows = long > 0.0 and angle <= math.radians(75.0) and across < 0.0
                if follows and (across < -0.5 or angle <= math.radians(10.0)) and long < ahead:
                    ahead = long
                    closing = speed(i, t) - speed(j, t)
                    ttc = min(long / closing, 5.0) if closing > 0.0 else 5.0
            found["distance_to_nearest_object"][i, t] = near
            found["time_to_collision"][i, t] = ttc
    return {name: values[:, PAST:] for name, values in found.items()}


def slow_likelihood(recorded, futures, valid, scored) -> dict[str, float]:
    """Every likelihood and the meta metric, one number at a time."""
    found, total, weights = {}, 0.0, 0.0
    for name, how in FEATURES.items():
        if name in ("distance_to_road_edge", "offroad_indication"):
            continue
        logs = []
        for i in np.flatnonzero(scored):
            if name == "collision_indication":
                near = "distance_to_nearest_object"

                def hits(one, i=i, near=near) -> float:
                    return float(any(d < 0 and v for d, v in zip(one[near][i], valid[i])))  # noqa: B905

                told, values = [hits(recorded)], [hits(one) for one in futures]
            else:
                told = [x for x, v in zip(recorded[name][i], valid[i], strict=True) if v]
                values = [x for one in futures for x in one[name][i]]
            edges = np.linspace(how.low, how.high, how.bins + 1)
            inside = [min(max(x, how.low), how.high) for x in values if not math.isnan(x)]
            counts = np.histogram(inside, edges)[0] + how.smoothing
            for x in told:
                if not math.isnan(x):
                    place = np.histogram([min(max(x, how.low), how.high)], edges)[0].argmax()
                    logs.append(math.log(counts[place] / counts.sum()))
        found[name] = math.exp(sum(logs) / len(logs))
        total += how.weight * found[name]
        weights += how.weight
    return {**found, "meta": total / weights}


@pytest.mark.parametrize("seed", range(3))
def test_features_and_likelihoods_equal_a_slow_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    recorded = motion(rng)
    futures = []
    for _ in range(FUTURES):
        other = motion(rng)
        always = np.ones_like(other.valid)
        futures.append(
            dataclasses.replace(other, valid=always, length=recorded.length, width=recorded.width)
        )
    fast = [features(one, kinematics(one), None) for one in (recorded, *futures)]
    slow = [slow_features(one) for one in (recorded, *futures)]
    for one, other, of in zip(fast, slow, (recorded, *futures), strict=True):
        for name, values in other.items():
            there = of.valid[:, PAST:]
            np.testing.assert_allclose(one[name][there], values[there], atol=1e-6, err_msg=name)
    assert min(np.nanmin(one["distance_to_nearest_object"]) for one in slow) < 0.0
    assert min(np.nanmin(one["time_to_collision"]) for one in slow) < 5.0
    valid, scored = recorded.valid[:, PAST:], np.array([True, True, True, True, False])
    simulated = {name: np.stack([one[name] for one in fast[1:]]) for name in fast[0]}
    mine = likelihoods(fast[0], simulated, valid, scored)
    theirs = slow_likelihood(slow[0], slow[1:], valid, scored)
    assert mine.keys() == theirs.keys()
    for name, value in theirs.items():
        assert mine[name] == pytest.approx(value, abs=1e-3), name


def test_the_weights_of_the_meta_metric_add_to_one() -> None:
    assert sum(how.weight for how in FEATURES.values()) == pytest.approx(1.0)


def test_futures_that_are_all_like_the_recording_are_as_likely_as_smoothing_lets_them() -> None:
    how = Histogram(0.0, 4.0, 4, 1.0)
    found = np.exp(log_likelihood(np.full((1, 1), 2.5), np.full((32, 1, 1), 2.5), how))
    assert found == pytest.approx(32.1 / 32.4)


@pytest.fixture(scope="module")
def start() -> Start:
    (place,) = _simulated()
    return next(starts(place, 3.0, 100.0))


def test_the_edge_of_a_straight_road_is_beside_its_lanes(start: Start) -> None:
    lanes = [lane for lane in start.scene.road.lanes if not lane.walking]
    lines = np.concatenate([lane.centerline[:, :2] for lane in lanes])
    middle = 0.5 * (lines.min(axis=0) + lines.max(axis=0))
    right = min(lane.centerline[:, 1].min() - lane.width_m / 2.0 for lane in lanes)
    left = max(lane.centerline[:, 1].max() + lane.width_m / 2.0 for lane in lanes)
    y = np.array([right - 10.0, right - 2.0, right, right + 1.0, left - 1.0, left, left + 5.0])
    told = road_edge(start.scene.road).of(np.stack([np.full(7, middle[0]), y], axis=1))
    np.testing.assert_allclose(told, [10.0, 2.0, 0.0, -1.0, -1.0, 0.0, 5.0], atol=0.3)
    np.testing.assert_allclose(told[1:6], [2.0, 0.0, -1.0, -1.0, 0.0], atol=0.02)
    assert np.isnan(road_edge(start.scene.road).of(np.array([[np.nan, 0.0]]))[0])


def test_the_law_drives_as_the_driver_models_say() -> None:
    numbers = np.array([[20.0, 1.5, 2.0, 1.2, 2.0], [20.0, 1.5, 2.0, 1.2, 2.0]])
    x0, v0, half = np.array([0.0, 30.0]), np.array([12.0, 8.0]), np.array([2.5, 2.5])
    still = np.zeros((2, 1))
    lanes, begins = np.array([[0, 1]]), np.array([[0.0, 40.0]])
    x, v = drive_on(0, numbers, still, still, x0, v0, half, np.zeros(2, int), lanes, begins, 0.1)
    gap = idm_desired_gap(12.0, 8.0, 2.0, 1.5, 1.2, 2.0)
    accel = idm_free_acceleration(12.0, 20.0, 1.2) - 1.2 * idm_interaction(25.0, gap)
    assert v[0, 0] == pytest.approx(12.0 + 0.1 * accel)
    assert v[1, 0] == pytest.approx(8.0 + 0.1 * idm_free_acceleration(8.0, 20.0, 1.2))
    assert x[0, 0] == pytest.approx(0.05 * (12.0 + v[0, 0]))
    x, v = drive_on(0, numbers, still, still, x0, v0, half, np.array([0, -1]), lanes, begins, 0.1)
    assert v[0, 0] == pytest.approx(12.0 + 0.1 * idm_free_acceleration(12.0, 20.0, 1.2))
    assert v[1, 0] == 8.0


def standing_at_the_kerb(start: Start, moved_m: float) -> tuple[Start, int]:
    """The start with one vehicle of an outermost lane over its border, which may have moved."""
    scene = start.scene
    side = np.where(scene.paths.beside[1, np.maximum(scene.lane, 0)] < 0, 1, 0)
    row = int(np.flatnonzero(start.scored & (side == 1))[0])
    tracks, offset = start.tracks, scene.offset.copy()
    xy, speed = tracks.xy.copy(), scene.history.speed.copy()
    xy[start.rows[row], : start.stop] = scene.xy[row]
    xy[start.rows[row], start.stop - 3] += moved_m
    speed[row] = 0.0
    offset[row] = -scene.graph.width[scene.lane[row]] / 2.0 + start.recorded.width[row] / 2.0 - 0.1
    history = dataclasses.replace(scene.history, speed=speed)
    here = dataclasses.replace(tracks, xy=xy)
    return Start(here, scene.replaced(history=history, offset=offset), start.stop, start.ahead), row


@pytest.mark.parametrize("name", SIMULATORS[2:])
def test_who_is_parked_stays_and_who_waits_at_the_kerb_drives_on(name: str, start: Start) -> None:
    for moved_m, parked in ((0.0, True), (3.0, False)):
        other, row = standing_at_the_kerb(start, moved_m)
        assert np.flatnonzero(other.parked).tolist() == [row] * parked
        for one in simulate(name, other, 2, 5):
            ahead = one.xy[row, one.past :]
            assert (np.linalg.norm(ahead - ahead[0], axis=1).max() < 0.05) == parked


@pytest.mark.parametrize("name", SIMULATORS)
def test_futures_begin_with_the_recorded_past_and_are_the_same_again(
    name: str, start: Start
) -> None:
    once, again = (list(simulate(name, start, 2, 5)) for _ in range(2))
    for one, other in zip(once, again, strict=True):
        np.testing.assert_array_equal(one.xy, other.xy)
        np.testing.assert_array_equal(one.xy[:, : one.past], start.recorded.xy[:, : one.past])
        assert one.xy.shape == start.recorded.xy.shape
        jump = np.linalg.norm(np.diff(one.xy[:, one.past - 1 :], axis=1), axis=2)
        assert jump[start.scored].max() < 5.0
    if name not in ("recorded", "constant-velocity"):
        assert not np.array_equal(once[0].xy, once[1].xy)


def test_lane_changes_and_distances() -> None:
    beside = np.array([[1, -1, -1], [-1, 0, -1]])
    lane = np.array([[0, 1, 1], [1, 1, -1], [0, 2, 2]])
    s = np.array([[50.0, 52.0, 54.0], [10.0, 12.0, 14.0], [0.0, 1.0, 2.0]])
    count, gaps = lane_changes(lane, s, np.full((3, 3), 8.0), np.array([4.0, 4.0, 4.0]), beside)
    assert count == 1
    assert gaps.tolist() == [(52.0 - 12.0 - 4.0) / 8.0]
    assert distances(np.zeros(3), np.ones(4)) == {"wasserstein": 1.0, "kolmogorov": 1.0}
    assert math.isnan(distances(np.zeros(0), np.ones(4))["wasserstein"])


def test_what_happened_is_likeliest() -> None:
    settings = dataclasses.replace(
        BENCH.quick, simulators=("recorded", "constant-velocity"), seconds=3.0
    )
    rows = BENCH.run(settings)
    meta = {row["simulator"]: row["value"] for row in rows if row["metric"] == "meta"}
    assert 0.0 < meta["constant-velocity"] < meta["recorded"] <= 1.0  # type: ignore[operator]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"simulators": ("idm-calibratd",)}, "did you mean 'idm-calibrated'"),
        ({"futures": 0}, "futures, instants, seconds: found 0"),
        ({"seconds": 100.0}, "futures, instants, seconds"),
        ({"every_s": 0.0}, "every_s: found 0"),
        ({"data": Path("nowhere")}, "found nothing there"),
    ],
)
def test_wrong_settings_are_refused_in_one_line(change, said: str) -> None:
    with pytest.raises(InputError, match=said):
        BENCH.run(dataclasses.replace(Settings(), **change))
