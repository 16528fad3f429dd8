"""Streams, predictors and solvers under abuse: each call answers well or refuses in one line.

What a call refuses leaves everything as it was. No warning of numpy is tolerated: it would mean a
number that overflowed or was none.
"""

from __future__ import annotations

import copy
import os
import pickle
import signal
import threading
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from behaviors.errors import InputError
from graphrqi.graph import TrafficGraph
from graphrqi.model_files import load_model
from graphrqi.posterior import Posterior
from graphrqi.predict import PREDICTORS, predict
from graphrqi.spectrum import SOLVERS
from graphrqi.stream import DEFAULT_MODEL, BehaviorStream, load_stream
from scenarios import get_scenario
from sim.frames import Frame, Tracks

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

ABUSE = settings(
    deadline=None, max_examples=20, derandomize=True, suppress_health_check=list(HealthCheck)
)
CROWD = 100_000
LONGEST_S = 120

numbers = st.sampled_from(
    [0.0, -0.0, -5.0, 5e-324, 1e9, 1e10, 1e150, 1e308, -1e300, np.nan, np.inf, -np.inf]
)
types = st.sampled_from(["f2", "f4", "i4", "u1", "?", "O", "U", "c16"])
strange = st.sampled_from([None, "x", [], {}, 3, (1.0, 2.0), b"y"])


def fields(time_s: float, n: int) -> dict[str, Any]:
    """Those of a frame of n cars, one behind the other."""
    return {
        "time_s": time_s, "ids": np.arange(n) * 3,
        "xy": np.stack([9.0 * np.arange(n) + 12.0 * time_s, 4.0 * (np.arange(n) % 3)], 1),
        "heading": np.zeros(n), "speed": np.full(n, 12.0), "length": np.full(n, 4.5),
        "width": np.full(n, 1.8), "kind": np.zeros(n, np.int8),
    }  # fmt: skip


@st.composite
def broken_fields(draw: st.DrawFn, time_s: float, n: int) -> dict[str, Any]:
    """Those of a frame, one of them other than it should be."""
    found = fields(time_s, n)
    name = draw(st.sampled_from(sorted(found)))
    if name == "time_s":
        earlier = st.sampled_from([time_s - 0.1, time_s, 0.0, 10**400, True])
        return found | {name: draw(numbers | strange | earlier)}
    values = found[name]
    how = draw(st.sampled_from(["cut", "type", "shape", "number", "order", "again", "strange"]))
    if how == "cut":
        values = values[:-1]
    elif how == "type":
        values = values.astype(draw(types))
    elif how == "shape":
        values = values[..., None]
    elif how == "number":
        values = values.astype(float)
        values.ravel()[draw(st.integers(0, values.size - 1))] = draw(numbers)
    elif how == "order":
        values = values[::-1]
    elif how == "again":
        values = np.repeat(values[:1], len(values), axis=0)
    return found | {name: draw(strange) if how == "strange" else values}


@cache
def model() -> Any:
    return load_model(DEFAULT_MODEL)


def same(one: Posterior, two: Posterior) -> bool:
    return np.array_equal(one.ids, two.ids) and np.array_equal(one.probability, two.probability)


def keeps_contract(posterior: Posterior, frame: Frame) -> None:
    assert np.isin(posterior.ids, frame.ids).all()
    assert np.isfinite(posterior.probability).all()
    np.testing.assert_allclose(posterior.probability.sum(axis=1), 1.0, atol=1e-6)
    assert repr(posterior)


def refused(call: Any, *given: Any) -> Any:
    """What a call answers; None where it refuses in one line."""
    try:
        return call(*given)
    except ValueError as error:
        return None if "\n" not in str(error) else pytest.fail(f"not one line: {error}")


@ABUSE
@given(st.data(), st.integers(1, 5))
def test_a_stream_answers_or_stays_as_it_was(data: st.DataObject, n: int) -> None:
    stream = load_stream()
    time_s = 0.0
    for _ in range(6):
        time_s += data.draw(st.sampled_from([0.1, 0.1, 0.2, 1.0, 1e-6, 70.0]))
        usual = Frame(**fields(time_s, n))
        keeps_contract(stream.update(usual), usual)
        before = stream.posterior()
        bad = data.draw(broken_fields(time_s + 0.05, n))
        frame = refused(lambda given: Frame(**given), bad)
        answered = None if frame is None else refused(stream.update, frame)
        if answered is None:
            assert same(stream.posterior(), before)
        else:
            keeps_contract(answered, frame)
            time_s = frame.time_s
        assert repr(stream)


def drive(stream: BehaviorStream, frames: int = 25) -> list[Posterior]:
    return [stream.update(Frame(**fields(0.1 * k, 4))) for k in range(frames)]


def test_two_streams_in_two_threads_answer_as_one_alone() -> None:
    alone = drive(BehaviorStream(model()))
    answers: dict[int, list[Posterior]] = {}
    threads = [
        threading.Thread(target=lambda i=i: answers.setdefault(i, drive(BehaviorStream(model()))))
        for i in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONGEST_S)
    assert sorted(answers) == [0, 1]
    for found in answers.values():
        assert all(map(same, found, alone))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:This process")
def test_a_process_that_is_forked_after_compiling_answers_alike() -> None:
    stream = BehaviorStream(model())
    drive(stream)
    graph = TrafficGraph.empty().observe(np.arange(9), np.arange(18.0).reshape(9, 2))
    wanted = SOLVERS["graphrqi"](graph, 3).eigenvalues
    child = os.fork()
    if child == 0:  # no exception may leave this branch
        code = 1
        try:
            signal.alarm(LONGEST_S)
            mine = stream.update(Frame(**fields(2.5, 4)))
            fresh = drive(BehaviorStream(model()), 26)[-1]
            found = SOLVERS["graphrqi"](graph, 3).eigenvalues
            code = 0 if same(mine, fresh) and np.array_equal(found, wanted) else 2
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.parametrize("again", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_of_a_stream_go_on_alike_and_apart(again: Any) -> None:
    stream = load_stream()
    drive(stream, 15)
    other = again(stream)
    assert same(other.update(Frame(**fields(1.5, 4))), stream.update(Frame(**fields(1.5, 4))))
    other.update(Frame(**fields(9.0, 1)))
    assert stream.posterior().ids.size == 4


def test_a_crowd_is_answered_in_one_update() -> None:
    stream = BehaviorStream(model(), min_seconds=0.0)
    found = fields(0.0, CROWD)
    found["xy"] = np.random.default_rng(0).uniform(0.0, 6000.0, (CROWD, 2))
    frame = Frame(**found)
    keeps_contract(stream.update(frame), frame)


@st.composite
def histories(draw: st.DrawFn) -> Tracks:
    """Of few cars for few or many times, sometimes with a strange number or a gap."""
    n, times = draw(st.sampled_from([0, 1, 3, 7])), draw(st.sampled_from([1, 2, 3, 20]))
    gap = draw(st.sampled_from([0.0, 0.0, 3.0, 30.0]))
    frames = [fields(0.1 * k + gap * (2 * k > times), n) for k in range(times)]
    scale = draw(st.sampled_from([1.0, 1.0, 0.0, 1e-9, 1e4]))
    for one in frames:
        one["xy"] = one["xy"] * scale
    if n and draw(st.booleans()):
        one = draw(st.sampled_from(frames))
        name = draw(st.sampled_from(["xy", "heading", "speed", "length", "width"]))
        one[name].ravel()[draw(st.integers(0, one[name].size - 1))] = draw(numbers)
    return Tracks.from_frames([Frame(**one) for one in frames])


@cache
def road(name: str | None) -> Any:
    return None if name is None else get_scenario(name)().road


@settings(ABUSE, max_examples=60)
@given(
    histories(),
    st.sampled_from(sorted(PREDICTORS)),
    st.sampled_from([None, "straight_road", "four_way_intersection"]),
    st.sampled_from([0.1, 1.0, 5.0, 5.0, 30.0])
    | numbers
    | st.sampled_from(["5", None, True, 31, []]),
    st.sampled_from(["of all", "of one", "of strangers", "of nobody"]),
)
def test_a_predictor_answers_for_those_present_or_refuses(
    history: Tracks, name: str, place: str | None, horizon_s: Any, whose: str
) -> None:
    ids = {"of all": history.ids, "of one": history.ids[:1], "of strangers": np.array([1, 10**15])}
    known = ids.get(whose, history.ids[:0])
    posterior = Posterior(known, np.full((known.size, 6), 1 / 6))
    found = refused(predict, history, posterior, road(place), horizon_s, name)
    if found is not None:
        assert np.array_equal(found.ids, history.ids[history.valid[:, -1]])
        assert np.isfinite(found.xy).all()
        assert (found.probability >= 0.0).all()
        assert found.time_s[-1] == pytest.approx(horizon_s)
        assert repr(found)


@ABUSE
@given(st.data())
def test_a_solver_answers_about_its_graph_or_refuses(data: st.DataObject) -> None:
    choose = lambda *options: data.draw(st.sampled_from(options))  # noqa: E731
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    kind = choose("accumulated", "instantaneous")
    graph = TrafficGraph.empty(neighbors=choose(1, 4, 30), reset=choose(1, 50), kind=kind)
    previous: Any = None
    for _ in range(3):
        n = choose(0, 1, 2, 3, 8, 30)
        ids = np.sort(rng.choice(100, n, replace=False))
        xy = rng.normal(0.0, choose(0.0, 1e-9, 50.0, 1e8, 1e200), (n, 2))
        if n > 1 and data.draw(st.booleans()):
            place = choose("nan", "twice", "order", "type", "shape")
            if place == "nan":
                xy[0] = data.draw(numbers)
            elif place == "shape":
                xy = choose(xy[:, :1], xy[:-1], xy[..., None])
            elif place == "type":
                ids = ids.astype(data.draw(types))
            else:
                ids = np.repeat(ids[:1], n) if place == "twice" else ids[::-1]
        graph = refused(graph.observe, ids, xy) or graph
        solve = SOLVERS[choose(*sorted(SOLVERS))]
        options = (
            choose(1, 2, 5, n, n + 1, 10**9, 0, -1, 1.5, True, None, "3", np.int8(3)),
            choose("largest", "smallest", "largest", "middle", None, 3),
            choose(previous, previous, previous, "x", 3),
            choose(1e-8, 1e-8, 1e-8, 0.0, 1e-300, np.nan, "x", None),
        )
        found = refused(solve, graph, *options)
        if found is None:
            continue
        previous = found
        assert np.isfinite(found.eigenvalues).all()
        assert np.isfinite(found.eigenvectors).all()
        assert found.eigenvectors.shape == (graph.ids.size, found.eigenvalues.size)


def test_what_was_no_error_of_ours_is_one() -> None:
    with pytest.raises(InputError, match=r"Frame\.time_s: found None, expected seconds"):
        Frame(**fields(0.0, 1) | {"time_s": None})
    graph = TrafficGraph.from_edges([1, 2], [(1, 2)])
    for solve in SOLVERS.values():
        with pytest.raises(InputError, match="previous: found 'x', expected a Spectrum or None"):
            solve(graph, 1, previous="x")  # type: ignore[arg-type]
    stream = BehaviorStream(model())
    with pytest.raises(InputError, match=r"frame.speed: found agent 3 beyond 1e\+09"):
        stream.update(Frame(**fields(0.0, 2) | {"speed": np.array([1.0, np.inf])}))
    history = Tracks.from_frames([Frame(**fields(0.0, 1) | {"speed": np.array([1e150])})])
    nobody = Posterior(np.empty(0, int), np.empty((0, 6)))
    with pytest.raises(InputError, match=r"history.speed: found a number beyond 1e\+09"):
        predict(history, nobody, None)
