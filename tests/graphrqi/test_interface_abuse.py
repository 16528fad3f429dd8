"""Streams under abuse: each call answers well, or refuses in one line and leaves all as it was."""

from __future__ import annotations

import os
import signal
import threading
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from graphrqi.graph import TrafficGraph
from graphrqi.model_files import load_model
from graphrqi.posterior import Posterior
from graphrqi.spectrum import SOLVERS
from graphrqi.stream import DEFAULT_MODEL, BehaviorStream, load_stream
from sim.frames import Frame

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

ABUSE = settings(
    deadline=None, max_examples=20, derandomize=True, suppress_health_check=list(HealthCheck)
)


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
