"""A window of interest: who is in it, and what it costs."""

from __future__ import annotations

import numpy as np
import pytest

from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from graphrqi.stream import load_stream
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.episode.live import Window
from sim.frames import Frame
from sim.scenario import sample_agents


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    scenario = SCENARIOS["straight_road"](duration_s=40.0, flow="dense")
    return list(get_engine("sumo")(scenario, sample_agents(scenario, 0), 0))


def test_conditions_admit_whom_they_say(frames: list[Frame]) -> None:
    frame = frames[-1]
    middle = frame.ids[np.argsort(frame.xy[:, 0])[len(frame) // 2]]
    ego = frame.xy[frame.ids == middle][0]
    near = np.hypot(*(frame.xy - ego).T) <= 80.0
    assert 1 < near.sum() < len(frame)
    around = Window(around=int(middle), radius_m=80.0)
    assert around.of(frame).ids.tolist() == frame.ids[near].tolist()
    east = Window(region=(ego[0], -1e6, 1e6, 1e6)).of(frame)
    assert east.ids.tolist() == frame.ids[frame.xy[:, 0] >= ego[0]].tolist()
    chosen = Window(agents={int(frame.ids[0]), int(frame.ids[2]), 10**9}).of(frame)
    assert chosen.ids.tolist() == [frame.ids[0], frame.ids[2]]
    assert np.array_equal(chosen.speed, frame.speed[[0, 2]])
    assert len(Window(around=10**9).of(frame)) == 0
    assert Window().of(frame) is frame


def test_a_stream_sees_the_window_only(frames: list[Frame]) -> None:
    middle = int(frames[-1].ids[np.argsort(frames[-1].xy[:, 0])[len(frames[-1]) // 2]])
    window = Window(around=middle, radius_m=60.0)
    watched, plain = load_stream(window=window), load_stream()
    for frame in frames[-60:]:
        posterior = watched.update(frame)
        same = plain.update(window.of(frame))
    assert watched.history.ids.tolist() == window.of(frames[-1]).ids.tolist()
    assert middle in posterior.ids
    assert np.array_equal(posterior.probability, same.probability)


def test_predictions_are_those_of_the_window_alone(frames: list[Frame]) -> None:
    road = SCENARIOS["straight_road"]().road
    stream = load_stream()
    for frame in frames[-60:]:
        posterior = stream.update(frame)
    ego = int(stream.history.ids[3])
    window = Window(around=ego, radius_m=100.0)
    some = predict(stream.history, posterior, road, window=window)
    assert some.ids.tolist() == window.of(frames[-1]).ids.tolist()
    assert 1 <= some.ids.size < len(frames[-1])
    everyone = predict(stream.history, posterior, road)
    away = some.best[some.ids == ego][0] - everyone.best[everyone.ids == ego][0]
    assert np.hypot(*away.T).max() < 3.0
    nobody = predict(
        stream.history, Posterior(np.empty(0, np.int64), np.empty((0, 6))), road,
        window=Window(around=10**9),
    )  # fmt: skip
    assert nobody.ids.size == 0
