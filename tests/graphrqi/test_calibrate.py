"""Calibration: known drivers are found again, and intervals hold the truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from behaviors.populations import NUMBERS
from graphrqi.calibrate.fit import Law, calibrate, forecast, second_half_errors, simulated
from graphrqi.calibrate.following import STEP_S, Stretch, recorded_drivers
from sim.frames import KINDS, AgentKind, Tracks

FloatArray = NDArray[np.float64]

MEDIAN = np.log([22.0, 1.3, 2.6, 1.6, 2.1])
SPREAD = np.array([0.2, 0.35, 0.35, 0.35, 0.3])


def leader_motion(rng: np.random.Generator, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Times and places of a leader whose wished speed changes every 4 to 12 s."""
    time_s = np.arange(0.0, seconds, STEP_S)
    base, speed, wanted, until = rng.uniform(8.0, 20.0), 10.0, 10.0, 0
    driven = np.empty(time_s.size)
    for i in range(time_s.size):
        if i >= until:
            wanted, until = base * rng.choice((0.2, 0.6, 1.0, 1.3)), i + int(rng.integers(40, 120))
        speed = max(speed + STEP_S * np.clip((wanted - speed) / 3.0, -2.5, 1.5), 0.0)
        driven[i] = speed
    return time_s, 60.0 + np.cumsum(driven) * STEP_S


def idm_drive(numbers: FloatArray, rear: FloatArray) -> FloatArray:
    """Places of an IDM driver behind a leader, written out once more."""
    v0, headway, s0, a, b = numbers
    ahead = np.gradient(rear, STEP_S)
    v = float(ahead[0])
    x = rear[0] - (s0 + headway * v) * 1.2
    place = np.empty(rear.size)
    for i in range(rear.size):
        place[i] = x
        wish = s0 + max(0.0, v * headway + v * (v - ahead[i]) / (2.0 * np.sqrt(a * b)))
        accel = max(a * (1.0 - (v / v0) ** 4 - (wish / max(rear[i] - x, 0.2)) ** 2), -10.0)
        faster = max(v + STEP_S * accel, 0.0)
        x, v = x + 0.5 * STEP_S * (v + faster), faster
    return place


@pytest.fixture(scope="module")
def drivers() -> tuple[FloatArray, list[list[Stretch]]]:
    """Logarithms of the numbers of 40 drivers, and their stretches with noise of 5 cm."""
    rng = np.random.default_rng(0)
    logs = MEDIAN + SPREAD * rng.standard_normal((40, 5))
    stretches = []
    for one in logs:
        time_s, rear = leader_motion(rng, 60.0)
        noise = rng.normal(0.0, 0.05, (2, time_s.size))
        place = idm_drive(np.exp(one), rear)
        stretches.append([Stretch.of(time_s, place + noise[0], rear + noise[1])])
    return logs, stretches


def test_simulation_is_the_law_written_out_once_more():
    _, rear = leader_motion(np.random.default_rng(1), 30.0)
    place = idm_drive(np.exp(MEDIAN), rear)
    exact = Stretch(place, np.gradient(rear, STEP_S)[:1].repeat(rear.size), rear,
                    np.gradient(rear, STEP_S))  # fmt: skip
    np.testing.assert_allclose(simulated(Law.IDM, MEDIAN[None], exact)[0], place, atol=1e-9)


def test_known_drivers_and_their_population_are_found_again(drivers):
    logs, stretches = drivers
    found = calibrate(Law.IDM, stretches)
    headway = NUMBERS.index("time_headway_s")
    np.testing.assert_allclose(found.mean, logs.mean(axis=0), atol=0.35)
    assert np.sqrt(found.covariance[headway, headway]) == pytest.approx(SPREAD[headway], rel=0.4)
    assert np.corrcoef(found.logs[:, headway], logs[:, headway])[0, 1] > 0.9
    inside = np.abs(found.logs - logs) <= 1.6449 * found.deviation
    assert 0.75 < inside.mean() <= 1.0
    assert found.known[:, headway].mean() > 0.5


def test_own_numbers_foretell_better_than_those_of_others(drivers):
    _, stretches = drivers
    own = second_half_errors(Law.IDM, [one[0] for one in stretches])
    found = calibrate(Law.IDM, stretches)
    halves = [(one[0].part(0, 301), one[0].part(300, one[0].place.size)) for one in stretches]
    others = [
        forecast(Law.IDM, found.logs[i - 1], found.spread[i - 1], past, ahead) - ahead.place
        for i, (past, ahead) in enumerate(halves)
    ]
    assert np.median(own) < 0.5 * np.median(np.sqrt((np.array(others) ** 2).mean(axis=1)))


def recording(gap_m: float, seconds: float, jump_at: int | None = None) -> Tracks:
    """Two cars behind one another on a straight line."""
    time_s = np.arange(0.0, seconds, 0.1)
    x = np.stack([10.0 * time_s + gap_m + 4.5, 10.0 * time_s])
    if jump_at is not None:
        x[0, jump_at:] += 20.0
    xy = np.stack([x, np.zeros_like(x)], axis=2)
    shape = x.shape
    return Tracks.of_dense(
        ids=np.arange(2), names=("a", "b"), kind=np.full(2, KINDS.index(AgentKind.CAR)),
        length=np.full(2, 4.5), width=np.full(2, 1.8), time_s=time_s, xy=xy,
        heading=np.zeros(shape), speed=np.full(shape, 10.0), valid=np.ones(shape, dtype=bool),
        signals=np.zeros((0, time_s.size), dtype=np.int8),
    )  # fmt: skip


def test_followers_of_a_recording_are_found_with_their_gaps():
    found = recorded_drivers(recording(20.0, 12.0))
    assert [driver.name for driver in found] == ["b"]
    (stretch,) = found[0].stretches
    assert stretch.seconds == pytest.approx(11.9, abs=0.05)
    np.testing.assert_allclose(stretch.speed, 10.0, atol=1e-6)
    gaps = stretch.leader - stretch.place
    assert gaps.std() < 1e-6
