"""Numbers of drivers while they drive: told where they follow, the population's where not."""

from __future__ import annotations

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.populations import NUMBERS, Population, drivers_of, read_population
from graphrqi.calibrate.live import DriverNumbers, LiveNumbers
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from graphrqi.stream import load_stream
from scenarios import SCENARIOS
from sim.frames import Frame, Tracks

PAIRS, SECONDS, STEP_S = 40, 60.0, 0.1
PEOPLE = Population(
    "people", "an example", "idm", 0, np.array([25.0, 1.3, 2.5, 1.5, 2.0]),
    np.array([0.15, 0.35, 0.35, 0.35, 0.3]), np.eye(5),
)  # fmt: skip


def frames(numbers: np.ndarray, rng: np.random.Generator) -> list[Frame]:
    """Pairs on roads of their own: a leader that changes its speed, and a follower by IDM."""
    n = len(numbers)
    v0, headway, least, a, b = numbers.T
    lead_x, lead_v, wish = np.full(n, 40.0), np.full(n, 15.0), np.full(n, 15.0)
    x, v, residual = np.zeros(n), np.full(n, 14.0), np.zeros(n)
    kept = np.exp(-STEP_S / 1.3)
    made = []
    for k in range(round(SECONDS / STEP_S)):
        if k % 60 == 0:
            wish = rng.choice([0.0, 6.0, 12.0, 18.0, 24.0], n)
        accel = np.clip((wish - lead_v) / 2.0, -2.5, 1.5)
        lead_v = np.maximum(lead_v + STEP_S * accel, 0.0)
        gap = np.maximum(lead_x - x - 4.5, 0.1)
        wanted = least + np.maximum(v * headway + v * (v - lead_v) / (2.0 * np.sqrt(a * b)), 0.0)
        residual = kept * residual + 0.19 * np.sqrt(1.0 - kept**2) * rng.standard_normal(n)
        own = np.maximum(a * (1.0 - (v / v0) ** 4 - (wanted / gap) ** 2), -9.0) + residual
        v = np.maximum(v + STEP_S * own, 0.0)
        lead_x, x = lead_x + STEP_S * lead_v, x + STEP_S * v
        y = 50.0 * np.arange(n)
        xy = np.concatenate([np.stack([x, y], axis=1), np.stack([lead_x, y], axis=1)])
        made.append(
            Frame(
                time_s=k * STEP_S, ids=np.arange(2 * n), xy=xy, heading=np.zeros(2 * n),
                speed=np.concatenate([v, lead_v]), length=np.full(2 * n, 4.5),
                width=np.full(2 * n, 1.8), kind=np.zeros(2 * n, np.int8),
                signals=np.empty(0, np.int8), events=(),
            )
        )  # fmt: skip
    return made


def test_followers_are_told_and_leaders_stay_the_populations() -> None:
    rng = np.random.default_rng(3)
    truth = PEOPLE.median * np.exp(PEOPLE.log_spread * rng.standard_normal((PAIRS, 5)))
    live = LiveNumbers(PEOPLE)
    for frame in frames(truth, rng):
        live.update(frame)
    told = live.numbers()
    assert told.ids.tolist() == list(range(2 * PAIRS))
    follows = slice(0, PAIRS)
    inside = (told.low[follows] <= truth) & (truth <= told.high[follows])
    assert 0.8 <= inside.mean() <= 1.0
    k = NUMBERS.index("time_headway_s")
    assert told.known[follows, k].mean() > 0.9
    error = np.abs(np.log(told.median[follows] / truth)).mean(axis=0)
    blind = np.abs(np.log(PEOPLE.median / truth)).mean(axis=0)
    assert error[k] < 0.5 * blind[k]
    assert (error < 1.05 * blind).all()
    assert not told.known[PAIRS:].any()
    np.testing.assert_array_equal(told.median[PAIRS:], np.tile(PEOPLE.median, (PAIRS, 1)))


def test_drivers_who_leave_are_forgotten_and_empty_frames_do_no_harm() -> None:
    rng = np.random.default_rng(0)
    live = LiveNumbers("us101")
    made = frames(np.tile(PEOPLE.median, (2, 1)), rng)[:60]
    for frame in made:
        live.update(frame)
    assert live.numbers().ids.size == 4
    last = made[-1]
    gone = Frame(
        time_s=last.time_s + 1.0, ids=last.ids[:0], xy=last.xy[:0], heading=last.heading[:0],
        speed=last.speed[:0], length=last.length[:0], width=last.width[:0], kind=last.kind[:0],
        signals=last.signals, events=(),
    )  # fmt: skip
    live.update(gone)
    assert live.numbers().ids.size == 0
    assert not live._told


def test_a_stream_carries_the_numbers_along() -> None:
    rng = np.random.default_rng(1)
    stream = load_stream(population="us101")
    plain = load_stream()
    for frame in frames(np.tile(PEOPLE.median, (3, 1)), rng)[:150]:
        with_numbers, without = stream.update(frame), plain.update(frame)
        np.testing.assert_array_equal(with_numbers.probability, without.probability)
    numbers = stream.numbers()
    assert numbers is not None
    assert numbers.known[:3].any()
    assert plain.numbers() is None
    assert drivers_of(read_population("us101")).population.name == "us101"


def test_rollouts_drive_each_car_by_its_own_numbers() -> None:
    road = SCENARIOS["straight_road"]().road
    lane = next(lane for lane in road.lanes if lane.cars and not lane.walking)
    begin = lane.centerline[0, :2]
    heading = np.arctan2(*(lane.centerline[1, :2] - begin)[::-1])
    ahead = np.array([np.cos(heading), np.sin(heading)])
    made = []
    for k in range(20):
        xy = begin + (np.array([60.0, 72.0]) + 1.0 * k)[:, None] * ahead
        made.append(
            Frame(
                time_s=0.1 * k, ids=np.arange(2), xy=xy, heading=np.full(2, heading),
                speed=np.full(2, 10.0), length=np.full(2, 4.5), width=np.full(2, 1.8),
                kind=np.zeros(2, np.int8),
                signals=np.zeros(len(road.signal_groups), np.int8), events=(),
            )
        )  # fmt: skip
    history = Tracks.from_frames(made)
    nobody = Posterior(np.empty(0, np.int64), np.empty((0, 6)))

    def numbers(factor: float) -> DriverNumbers:
        ones = np.ones((2, 5))
        own = ones.copy()
        own[0, 1] = factor
        return DriverNumbers(np.arange(2), own, ones, ones, own != 1.0, own)

    def reached(factor: float) -> float:
        told = predict(history, nobody, road, 5.0, "car-following", numbers=numbers(factor))
        return float((told.xy[0, 0, -1] - begin) @ ahead)

    assert reached(2.0) < reached(1.2) - 0.5 < reached(1.01) - 0.5
    plain = predict(history, nobody, road, 5.0, "car-following")
    same = predict(history, nobody, road, 5.0, "car-following", numbers=numbers(1.0))
    np.testing.assert_array_equal(same.xy, plain.xy)
    with pytest.raises(InputError, match="expected 'car-following' on a known road"):
        predict(history, nobody, road, 5.0, "constant-velocity", numbers=numbers(1.0))
