"""Calibration: simulated drivers' numbers are found again, and files hold what they say."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from behaviors.driver_models import (
    idm_desired_gap,
    idm_free_acceleration,
    idm_interaction,
    krauss_safe_speed,
)
from behaviors.populations import NUMBERS, Population
from graphrqi.calibrate.drives import Drive, Stretch, make_drive
from graphrqi.calibrate.driving_on import (
    CARRIED,
    candidate_weights,
    carried_on,
    driven_places,
    foretold_places,
    gap_errors,
    halves,
    longest_led,
    past_errors,
)
from graphrqi.calibrate.filter import LANES, LEAST_RESIDUAL_MPS2, STARTS_SPEED_MPS, tell
from graphrqi.calibrate.kernels import HARDEST_MPS2, drive_on
from graphrqi.calibrate.laws import FIELDS, Law, prior
from graphrqi.calibrate.posterior import calibrate, moving_on
from graphrqi.calibrate.recorded import recorded_drivers
from graphrqi.calibrate.sampling import sample
from scenarios import get_scenario
from sim.frames import KINDS, AgentKind, Tracks


@pytest.mark.parametrize("law", Law)
def test_drivers_are_calibrated_under_the_laws_of_the_driver_models(law: Law) -> None:
    rng = np.random.default_rng(9)
    h = 0.1
    for _ in range(300):
        v0, headway, s0, a, b = np.array([20.0, 1.3, 2.5, 1.5, 2.0]) * np.exp(
            0.3 * rng.standard_normal(5)
        )
        v, u = rng.uniform(0.0, 25.0, 2)
        gap = float(rng.choice((s0 + rng.uniform(0.0, 60.0), np.inf), p=(0.9, 0.1)))
        if law is Law.IDM:
            wanted = idm_desired_gap(v, u, s0, headway, a, b)
            accel = idm_free_acceleration(v, v0, a) - a * idm_interaction(gap, wanted)
            expected = 0.5 * h * (v + max(v + h * max(accel, -HARDEST_MPS2), 0.0))
        else:
            reached = min(v0, krauss_safe_speed(gap - s0, u, headway, b), v + h * a)
            expected = h * max(reached, v - h * HARDEST_MPS2, 0.0)
        rows = np.array([[0.0] * 2, [0.0] * 2, [v] * 2, [gap] * 2, [u] * 2])
        numbers = np.array([v0, headway, s0, a, b, 0.2, 1.3, 0.0, 0.0])[: len(FIELDS[law])]
        assert drive_on(law.code, numbers, rows, h, 0.0, 1.0)[1] == pytest.approx(
            expected, abs=1e-9
        )


def _leader(rng: np.random.Generator, steps: int, stops: bool) -> np.ndarray:
    """Speeds of someone who drives at changing speeds, and may stop now and then, m/s."""
    speed, accel, wanted = 14.0, 0.0, 14.0
    out = np.empty(steps)
    for i in range(steps):
        if i % 60 == 0:
            wanted = float(rng.choice((0.0 if stops else 9.0, 6.0, 12.0, 18.0, 24.0)))
        accel += (np.clip((wanted - speed) / 3.0, -2.0, 1.2) - accel) * 0.1
        speed = max(speed + 0.1 * accel, 0.0)
        out[i] = speed
    return out


def _idm_drive(
    numbers: np.ndarray, seed: int, noise_m: float = 0.0, stops: bool = True, newer: float = 0.5
) -> Drive:
    """Someone who drives by IDM behind such a leader for 60 s, written out here once more."""
    rng = np.random.default_rng(seed)
    u = _leader(rng, 600, stops)
    rear = 40.0 + np.concatenate([[0.0], np.cumsum(0.1 * (newer * u[1:] + (1.0 - newer) * u[:-1]))])
    v0, headway, s0, a, b = numbers
    x, v, e = rear[0] - s0 - headway * u[0], u[0], 0.0
    place = np.empty(600)
    for i in range(600):
        place[i] = x
        e = 0.926 * e + 0.19 * 0.378 * rng.standard_normal() * (noise_m > 0.0)
        wanted = s0 + max(0.0, v * headway + v * (v - u[i]) / (2.0 * np.sqrt(a * b)))
        accel = a * (1.0 - (v / v0) ** 4 - (wanted / max(rear[i] - x, 0.2)) ** 2) + e
        faster = max(v + 0.1 * accel, 0.0)
        x, v = x + 0.1 * (newer * faster + (1.0 - newer) * v), faster
    shaken = rng.normal(0.0, noise_m, (2, 600))
    drive = make_drive([Stretch(0.1 * np.arange(600), place + shaken[0], rear + shaken[1])])
    assert drive is not None
    return drive


def test_exact_drives_give_their_numbers_back() -> None:
    numbers = np.array([21.0, 1.1, 2.8, 1.7, 1.9])
    fitted = calibrate(Law.IDM, [_idm_drive(numbers, seed) for seed in range(4)])
    told = fitted.summary()
    np.testing.assert_allclose(told.mean[:, 1], 1.1, rtol=0.1)
    np.testing.assert_allclose(told.mean[:, 3], 1.7, rtol=0.15)
    assert told.known[:, 1].all()


@pytest.mark.parametrize("newer", [0.0, 0.5, 1.0])
def test_it_is_found_by_which_speed_a_simulator_moves_on(newer: float) -> None:
    rng = np.random.default_rng(5)
    truth = np.exp(np.log([21.0, 1.3, 2.5, 1.5, 2.0]) + 0.2 * rng.standard_normal((24, 5)))
    drives = [_idm_drive(one, 300 + i, newer=newer) for i, one in enumerate(truth)]
    assert moving_on(Law.IDM, drives) == newer


def test_intervals_of_exact_drives_are_narrower_and_hold_the_truth() -> None:
    rng = np.random.default_rng(78)
    truth = np.exp(np.log([21.0, 1.3, 2.5, 1.5, 2.0]) + 0.3 * rng.standard_normal((40, 5)))
    told = [
        calibrate(Law.IDM, drives).summary()
        for noise_m in (0.0, 0.1)
        for drives in [[_idm_drive(one, 500 + i, noise_m) for i, one in enumerate(truth)]]
    ]
    exact, noisy = (np.median(np.log(one.high / one.low), axis=0) for one in told)
    assert (exact < 0.7 * noisy).all()
    assert ((told[0].low <= truth) & (truth <= told[0].high)).mean() >= 0.85


@pytest.mark.parametrize("frame_s", [0.04, 0.05, 0.1])
def test_krauss_drivers_with_short_steps_are_calibrated(frame_s: float) -> None:
    """Their step is shorter than the filter's; written out here once more."""
    rng = np.random.default_rng(6)
    count = round(40.0 / frame_s)
    u = np.interp(frame_s * np.arange(count), 0.1 * np.arange(600), _leader(rng, 600, True))
    truth = np.exp(np.log([25.0, 1.2, 2.5, 1.8, 2.2]) + 0.2 * rng.standard_normal((16, 5)))
    drives = []
    for v0, headway, s0, a, b in truth:
        rear = 40.0 + np.concatenate([[0.0], np.cumsum(frame_s * u[1:])])
        x, v, place = rear[0] - s0 - headway * u[0], u[0], np.empty(count)
        for i in range(count):
            place[i] = x
            safe = krauss_safe_speed(max(rear[i] - x - s0, 0.0), u[i], headway, b)
            v = max(min(v0, safe, v + frame_s * a), 0.0)
            x += frame_s * v
        drive = make_drive([Stretch(frame_s * np.arange(count), place, rear)])
        assert drive is not None
        drives.append(drive)
    told = calibrate(Law.KRAUSS, drives).summary()
    np.testing.assert_allclose(told.mean[:, 1], truth[:, 1], rtol=0.15)
    assert ((told.low <= truth) & (truth <= told.high)).mean() >= 0.75


def test_intervals_of_noisy_drives_hold_the_truth_about_as_often_as_they_say() -> None:
    rng = np.random.default_rng(77)
    truth = np.exp(np.log([21.0, 1.3, 2.5, 1.5, 2.0]) + 0.3 * rng.standard_normal((40, 5)))
    drives = [_idm_drive(one, 100 + i, noise_m=0.1) for i, one in enumerate(truth)]
    told = calibrate(Law.IDM, drives).summary()
    inside = ((told.low <= truth) & (truth <= told.high)).mean()
    assert 0.8 <= inside <= 0.97


def test_always_free_says_nothing_of_the_headway() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    place = 20.0 * t + 0.01 * np.sin(t)
    drive = make_drive([Stretch(t, place, np.full(t.size, np.inf))])
    assert drive is not None
    told = calibrate(Law.IDM, [drive]).summary()
    assert told.known[0, 0]
    assert not told.known[0, [1, 2, 4]].any()


def test_draws_of_unknown_numbers_are_the_populations() -> None:
    rng = np.random.default_rng(12)
    truth = np.exp(np.log([21.0, 1.3, 2.5, 1.5, 2.0]) + 0.3 * rng.standard_normal((6, 5)))
    t = np.arange(0.0, 20.0, 0.1)
    free = make_drive([Stretch(t, 20.0 * t + 0.01 * np.sin(t), np.full(t.size, np.inf))])
    assert free is not None
    followers = [_idm_drive(one, 700 + i) for i, one in enumerate(truth)]
    fitted = calibrate(Law.IDM, [*followers, free, free])
    unknown = ~fitted.known
    assert not unknown[:6, 1].any()  # followers tell their headway
    assert unknown[6:, 1:3].any()
    numbers = fitted.logs[:, :, :5]
    shift = (numbers.mean(axis=1) - fitted.mean[:5]) / fitted.spread[:5]
    width = numbers.std(axis=1) / fitted.spread[:5]
    np.testing.assert_allclose(shift[unknown], 0.0, atol=0.05)
    np.testing.assert_allclose(width[unknown], 1.0, atol=0.05)


def _idm_slowly(logs: np.ndarray, drive: Drive) -> float:
    """The filter in matrices, with derivatives by differences."""
    v0, headway, s0, a, b, sigma, forgotten = np.exp(logs)
    h, rho = drive.step_s, np.exp(-drive.step_s / forgotten)
    variance = sigma**2 + LEAST_RESIDUAL_MPS2**2

    def moved(state: np.ndarray, i: int) -> np.ndarray:
        x, v, e = state
        wanted = idm_desired_gap(v, drive.rows[4, i], s0, headway, a, b)
        gap = max(drive.rows[3, i] - x, 0.2)
        pushed = idm_free_acceleration(v, v0, a) - a * idm_interaction(gap, wanted) + e
        return np.array([x + v * h + 0.5 * h * h * pushed, v + h * pushed, rho * e])

    state = np.array([drive.rows[0, 0], drive.rows[2, 0], 0.0])
    p = np.diag([drive.rows[1, 0] ** 2 + 1e-6, STARTS_SPEED_MPS**2, variance])
    total = 0.0
    for i in range(1, drive.rows.shape[1]):
        steps = 1e-6 * np.eye(3)
        f = np.stack([(moved(state + d, i - 1) - moved(state - d, i - 1)) / 2e-6 for d in steps], 1)
        state, p = moved(state, i - 1), f @ p @ f.T
        p[2, 2] += variance * (1.0 - rho**2)
        if drive.rows[1, i] > 0.0:
            s = p[0, 0] + drive.rows[1, i] ** 2
            miss, k = drive.rows[0, i] - state[0], p[:, 0] / s
            total -= 0.5 * (miss**2 / s + np.log(s))
            state, p = state + k * miss, p - np.outer(k, p[0])
    return total


def test_the_compiled_filter_is_the_kalman_filter() -> None:
    drive = _idm_drive(np.array([22.0, 1.2, 2.5, 1.5, 2.0]), 8, noise_m=0.1, stops=False)
    mean, covariance = prior(Law.IDM)
    mean[0] = np.log(25.0)
    logs = np.random.default_rng(4).multivariate_normal(mean, 0.3 * covariance, LANES)
    out = np.empty(LANES)
    tell(Law.IDM.code, logs, 0.0, drive.rows, drive.begins, drive.steps(0.5), out)
    assert out[:4] == pytest.approx([_idm_slowly(one, drive) for one in logs[:4]], abs=1e-4)


def test_what_nothing_is_known_of_is_drawn_from_the_population() -> None:
    mean, covariance = prior(Law.KRAUSS)
    covariance[1, 2] = covariance[2, 1] = -0.5 * np.sqrt(covariance[1, 1] * covariance[2, 2])
    rng = np.random.default_rng(0)
    start = rng.multivariate_normal(mean, covariance, 128)
    rows = np.array([[0.0, 0.2], [0.1, 0.0], [2.0, 2.0], [1e9] * 2, [0.0] * 2])
    drawn, evidence = sample(
        Law.KRAUSS.code, start, 3.0, 1.0, mean, np.linalg.inv(covariance), 4, 80, rng, rows,
        np.array([0, 2]), np.array([0.1, 0.1, 1.0]),
    )  # fmt: skip
    assert evidence == pytest.approx(0.0, abs=1e-9)
    spread = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((drawn.mean(0) - mean) / spread, 0.0, atol=0.15)
    np.testing.assert_allclose(drawn.std(0) / spread, 1.0, atol=0.12)
    assert np.corrcoef(drawn[:, 1], drawn[:, 2])[0, 1] == pytest.approx(-0.5, abs=0.12)


PEOPLE = Population(
    "road", "an example", "idm", 60, np.array([30.0, 1.3, 2.5, 1.2, 2.0]),
    np.array([0.2, 0.4, 0.5, 0.6, 0.3]), 0.7 * np.eye(5) + 0.3,
)  # fmt: skip


def test_a_populations_text_holds_its_numbers() -> None:
    told = tomllib.loads(PEOPLE.to_toml())
    assert {key: told[key] for key in ("schema_version", "name", "source", "law", "drivers")} == {
        "schema_version": 1, "name": "road", "source": "an example", "law": "idm", "drivers": 60,
    }  # fmt: skip
    numbers = [told["numbers"][name] for name in NUMBERS]
    np.testing.assert_allclose([one["median"] for one in numbers], PEOPLE.median, rtol=1e-5)
    np.testing.assert_allclose([one["log_spread"] for one in numbers], PEOPLE.log_spread, rtol=1e-5)
    correlation = [one["correlation"] for one in numbers]
    np.testing.assert_allclose(correlation, PEOPLE.correlation, atol=1e-5)


def test_the_true_numbers_drive_on_best() -> None:
    numbers = np.array([21.0, 1.2, 2.5, 1.6, 2.0])
    cut = halves(_idm_drive(numbers, 11))
    assert cut is not None
    first, second = cut
    assert first.rows[0, -1] == second.rows[0, 0]
    tried = np.log(np.stack([numbers, numbers * 1.3, numbers * 0.7]))
    errors = gap_errors(driven_places(Law.IDM, tried, first), first)
    assert errors[0] < 0.1 < errors[1:].min()
    assert past_errors(Law.IDM, tried, first).argmin() == 0
    weight = candidate_weights(errors[None])[0]
    assert weight[0] > 0.99
    assert gap_errors(driven_places(Law.IDM, tried, second), second).argmin() == 0
    told = foretold_places(Law.IDM, tried, weight, first, second)
    assert gap_errors(told[None], second)[0] < 0.3


def test_what_a_driver_does_beside_its_law_is_carried_on_and_fades() -> None:
    numbers = np.array([21.0, 1.2, 2.5, 1.6, 2.0])
    cut = halves(_idm_drive(numbers, 11))
    assert cut is not None
    first, second = cut
    logs = np.log(numbers)[None]
    assert carried_on(Law.IDM, logs, first)[0] == pytest.approx(0.0, abs=0.1)
    wished = first.rows.copy()
    wished[2] += 0.4 * first.step_s * np.arange(wished.shape[1])  # gains .4 m/s2 on what it does
    pressed = carried_on(Law.IDM, logs, Drive(wished, first.begins, first.step_s, first.frame_s))
    assert pressed[0] > 0.2 * CARRIED
    law, pushed = (driven_places(Law.IDM, logs, second, r)[0] for r in (0.0, 0.4))
    ahead = pushed - law
    assert ahead[round(2.0 / second.step_s)] > 0.3
    assert abs(ahead[-1]) < 0.5 * ahead.max()


def test_rare_frames_are_driven_in_fine_steps() -> None:
    time_s = np.arange(0.0, 20.0, 0.5)
    leader = 30.0 + 12.0 * time_s + 10.0 * np.cos(0.3 * time_s)
    drive = make_drive([Stretch(time_s, 12.0 * time_s, leader)])
    assert drive is not None
    found = longest_led(drive)
    assert found is not None
    assert found.step_s == pytest.approx(0.1)
    at_s = 0.1 * np.arange(found.rows.shape[1])
    exact = 30.0 + 12.0 * at_s + 10.0 * np.cos(0.3 * at_s)
    np.testing.assert_allclose(found.rows[3], exact, atol=0.1)
    np.testing.assert_array_equal(found.rows[1, 1::5], 0.0)


def test_a_recording_that_trembles_is_one_drive() -> None:
    """Places to .01 m at 10 Hz, as NGSIM's are: no moment counts as a bend."""
    rng = np.random.default_rng(4)
    time_s = np.linspace(0.0, 11.9, 120)
    x = np.stack([12.0 * time_s, 12.0 * time_s + 25.0])
    y = 0.06 * np.cumsum(rng.normal(0.0, 0.2, (2, 120)), axis=1)
    xy = np.stack([x, y], axis=2).round(2)
    tracks = Tracks(
        ids=np.arange(2), names=("a", "b"), kind=np.full(2, KINDS.index(AgentKind.CAR)),
        length=np.full(2, 4.5), width=np.full(2, 1.8), time_s=time_s, xy=xy,
        heading=np.zeros((2, 120)), speed=np.full((2, 120), 12.0),
        valid=np.ones((2, 120), dtype=bool), signals=np.zeros((0, 120), dtype=np.int8),
    )  # fmt: skip
    (driver,) = recorded_drivers(tracks)
    assert driver.name == "a"
    assert driver.drive.begins.size == 2
    assert driver.drive.seconds > 11.0


def test_a_leader_that_jumps_is_two_stretches() -> None:
    """Where the leader's place is off by a frame at first, as on US-101, speeds would be wrong."""
    time_s = np.linspace(0.0, 11.9, 120)
    x = np.stack([12.0 * time_s, 12.0 * time_s + 25.0])
    x[1, :50] -= 1.2
    tracks = Tracks(
        ids=np.arange(2), names=("a", "b"), kind=np.full(2, KINDS.index(AgentKind.CAR)),
        length=np.full(2, 4.5), width=np.full(2, 1.8), time_s=time_s,
        xy=np.stack([x, np.zeros((2, 120))], axis=2), heading=np.zeros((2, 120)),
        speed=np.full((2, 120), 12.0), valid=np.ones((2, 120), dtype=bool),
        signals=np.zeros((0, 120), dtype=np.int8),
    )  # fmt: skip
    (driver,) = recorded_drivers(tracks)
    assert driver.drive.begins.size == 3
    np.testing.assert_allclose(driver.drive.rows[4], 12.0, atol=0.05)


def test_everybody_is_heard_of_the_population() -> None:
    """Drivers beside those among whom the population is sought correct it."""
    rng = np.random.default_rng(2)
    drives = [
        _idm_drive(np.array([22.0, headway, 2.5, 1.5, 2.0]), seed)
        for seed, headway in enumerate(np.exp(rng.normal(np.log(1.3), 0.2, 6)))
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graphrqi.calibrate.posterior.MOST_FIRST", 2)
        some = calibrate(Law.IDM, drives)
    told = calibrate(Law.IDM, drives)
    few = calibrate(Law.IDM, [drives[i] for i in np.random.default_rng(0).permutation(6)[:2]])
    assert abs(some.mean[1] - told.mean[1]) < abs(few.mean[1] - told.mean[1])


def test_where_a_map_begins_after_the_follower_nothing_is_told_of_its_gap() -> None:
    """It is at the lane's beginning all the while, so that its leader seems twice as fast."""
    road = get_scenario("straight_road")().road
    first = min((lane for lane in road.lanes if lane.cars), key=lambda one: one.centerline[0, 0])
    begins, y = first.centerline[0]
    time_s = np.linspace(0.0, 11.9, 120)
    x = begins - 3.0 + 12.0 * time_s + np.array([[0.0], [25.0]])
    tracks = Tracks(
        ids=np.arange(2), names=("a", "b"), kind=np.full(2, KINDS.index(AgentKind.CAR)),
        length=np.full(2, 4.5), width=np.full(2, 1.8), time_s=time_s,
        xy=np.stack([x, np.full((2, 120), y)], axis=2), heading=np.zeros((2, 120)),
        speed=np.full((2, 120), 12.0), valid=np.ones((2, 120), dtype=bool),
        signals=np.zeros((0, 120), dtype=np.int8),
    )  # fmt: skip
    driver = next(one for one in recorded_drivers(tracks, road) if one.name == "a")
    np.testing.assert_allclose(driver.drive.rows[4], 12.0, atol=0.05)


def test_level_speeds_that_change_in_steps_are_no_accelerations() -> None:
    """Tracks that were cut into level speeds (as US-101's are) leave the population's as it is."""
    rng = np.random.default_rng(13)
    truth = np.exp(np.log([21.0, 1.3, 2.5, 1.5, 2.0]) + 0.3 * rng.standard_normal((40, 5)))
    drives = []
    for i, numbers in enumerate(truth):
        smooth = _idm_drive(numbers, 900 + i)
        time_s = smooth.step_s * np.arange(smooth.rows.shape[1])
        watched = smooth.rows[1] > 0.0
        place = np.interp(time_s, time_s[watched], smooth.rows[0, watched])
        edges = np.unique([0, *np.cumsum(rng.integers(8, 16, 60)), time_s.size - 1])
        edges = edges[edges < time_s.size]
        level = np.interp(time_s, time_s[edges], place[edges] + rng.normal(0.0, 0.1, edges.size))
        drive = make_drive([Stretch(time_s, level, smooth.rows[3])])
        assert drive is not None
        drives.append(drive)
    fitted = calibrate(Law.IDM, drives)
    np.testing.assert_allclose(np.exp(fitted.mean[1:4]), [1.3, 2.5, 1.5], rtol=0.25)


@pytest.mark.parametrize("changes", [False, True], ids=["one mind", "many minds"])
def test_short_drives_count_by_what_their_parts_say(changes: bool) -> None:
    """Drives of 8 s are too short for parts of 10 s."""
    rng = np.random.default_rng(14)
    drives = []
    for i in range(40):
        numbers = np.exp(np.log([21.0, 1.3, 2.5, 1.5, 2.0]) + 0.2 * rng.standard_normal(5))
        whole = _idm_drive(numbers, 1000 + i, noise_m=0.05, stops=False)
        begin = 100 * (i % 5)
        drive = whole.part(begin, begin + 81)
        if changes:  # comes nearer and falls back by 4 m, whatever the leader does
            time_s = drive.step_s * np.arange(81)
            drive.rows[0] += 4.0 * np.sin(1.6 * time_s + i)
        drives.append(drive)
    counts = calibrate(Law.IDM, drives).counts
    assert counts < 0.5 if changes else counts == 1.0
