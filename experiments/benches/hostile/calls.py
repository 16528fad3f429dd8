"""The Python interface, called with what no caller should give: streams, solvers, environments.

Each input is a sequence of calls that its number decides. A call answers or refuses by a
`ValueError` (an `InputError` is one); what it answers keeps the contract, and what it refuses
leaves everything as it was.
"""

from __future__ import annotations

import pickle
import random
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, Final

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.model_files import load_model
from graphrqi.posterior import Posterior
from graphrqi.spectrum import SOLVERS
from graphrqi.stream import DEFAULT_MODEL, BehaviorStream
from sim.frames import Frame

CROWD: Final = 100_000
"""Agents of a crowd, which one input in some hundreds has."""

CITY_M: Final = 6000.0
"""Side of the square in which the crowd is, m (400 square metres each)."""

BAD: Final = (float("nan"), float("inf"), -float("inf"), 1e308, -1e300, 1e9, -0.0)

ARRAYS: Final = ("ids", "xy", "heading", "speed", "length", "width", "kind")


@cache
def _model() -> Any:
    return load_model(DEFAULT_MODEL)


def _frame(time_s: float, n: int, numbers: np.random.Generator) -> dict[str, Any]:
    """The fields of a frame of n agents that drive along x."""
    return {
        "time_s": time_s, "ids": np.arange(n) * 3,
        "xy": np.stack([9.0 * np.arange(n) + 12.0 * (time_s % 1e4), 4.0 * (np.arange(n) % 3)], 1)
        + numbers.normal(0, 0.01, (n, 2)),
        "heading": np.zeros(n), "speed": np.full(n, 12.0), "length": np.full(n, 4.5),
        "width": np.full(n, 1.8), "kind": np.zeros(n, np.int8),
    }  # fmt: skip


def _broken(fields: dict[str, Any], choose: random.Random) -> dict[str, Any]:
    """The fields with one of them other than it should be."""
    found = dict(fields)
    name = choose.choice([*ARRAYS, "time_s"])
    if name == "time_s":
        found[name] = choose.choice([-1.0, 0.0, *BAD[:5], fields[name] - 0.1, fields[name] + 1e7])
        return found
    values = np.array(found[name])
    how = choose.randrange(6)
    if how == 0:
        values = values[:-1]
    elif how == 1:
        values = values.astype(choose.choice([np.float16, np.int32, object, str, complex]))
    elif how == 2:
        values = values[..., None]
    elif how == 3 and values.size:
        flat = values.astype(float).ravel()
        flat[choose.randrange(flat.size)] = choose.choice(BAD)
        values = flat.reshape(values.shape)
    elif how == 4:
        values = values[::-1]
    elif values.size > 1:
        values[1:] = values[:1]
    found[name] = values
    return found


def _keeps_contract(posterior: Posterior, frame: Frame) -> None:
    ids, probability = posterior.ids, posterior.probability
    assert np.isin(ids, frame.ids).all(), "somebody who is not there"
    assert (np.diff(ids) > 0).all(), "ids out of order"
    assert np.isfinite(probability).all(), "a probability that is not finite"
    assert np.allclose(probability.sum(axis=1), 1.0, atol=1e-6), "rows that do not add to 1"


def _drive(stream: BehaviorStream, number: int, frames: int = 14) -> list[Posterior]:
    """A stream through usual and broken frames."""
    choose, numbers = random.Random(f"stream:{number}"), np.random.default_rng(number)
    found: list[Posterior] = []
    n, time_s = choose.choice([0, 1, 2, 5, 12]), 0.0
    for _ in range(frames):
        time_s += choose.choice([0.1, 0.1, 0.1, 0.2, 1.0, 1e-6, 70.0])
        n = max(0, n + choose.choice([0, 0, 0, 1, -1]))
        fields = _frame(time_s, n, numbers)
        if choose.random() < 0.4:
            before = stream.posterior() if found else None
            try:
                frame = Frame(**_broken(fields, choose))
                found.append(stream.update(frame))
                _keeps_contract(found[-1], frame)
                time_s = max(time_s, frame.time_s)
            except ValueError:
                if before is not None:
                    _same(before, stream.posterior())
            time_s += 0.1
        frame = Frame(**(fields | {"time_s": time_s}))
        posterior = stream.update(frame)
        _keeps_contract(posterior, frame)
        found.append(posterior)
        if choose.random() < 0.1:
            stream = pickle.loads(pickle.dumps(stream))
            _same(stream.posterior(), posterior)
    return found


def _same(one: Posterior, two: Posterior) -> None:
    assert np.array_equal(one.ids, two.ids), "other agents"
    assert np.array_equal(one.probability, two.probability), "another answer"


def abuse_stream(number: int) -> None:
    """Streams: broken frames, refused and pickled between usual ones; two in two threads."""
    alone = _drive(BehaviorStream(_model()), number)
    if number % 10 == 3:
        together: dict[int, list[Posterior]] = {}
        threads = [
            threading.Thread(
                target=lambda i=i: together.setdefault(i, _drive(BehaviorStream(_model()), number))
            )
            for i in range(2)
        ]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
        assert len(together) == 2, "a thread that failed"
        for answers in together.values():
            assert len(answers) == len(alone), "another number of answers in a thread"
            for one_answer, other in zip(answers, alone, strict=True):
                _same(one_answer, other)
    if number % 200 == 199:
        crowd = BehaviorStream(_model())
        for step in range(2):
            numbers = np.random.default_rng(number)
            fields = _frame(0.1 * step, CROWD, numbers)
            fields["xy"] = numbers.uniform(0.0, CITY_M, (CROWD, 2))
            frame = Frame(**fields)
            _keeps_contract(crowd.update(frame), frame)


def abuse_solver(number: int) -> None:
    """Every solver on graphs of any places, asked for any number of pairs."""
    choose, numbers = random.Random(f"solver:{number}"), np.random.default_rng(number)
    kind: Any = choose.choice(["accumulated", "instantaneous"])
    graph = TrafficGraph.empty(neighbors=choose.choice([1, 4, 30]), reset=50, kind=kind)
    name = choose.choice(sorted(SOLVERS))
    previous = None
    for _ in range(5):
        n = choose.choice([0, 1, 2, 3, 8, 40])
        ids = np.sort(numbers.choice(100, n, replace=False))
        xy = numbers.normal(0, choose.choice([0.0, 1e-9, 50.0, 1e8]), (n, 2))
        if choose.random() < 0.1 and n:
            xy[choose.randrange(n)] = choose.choice(BAD)
        if choose.random() < 0.1 and n > 1:
            ids[1] = ids[0]
        try:
            graph = graph.observe(ids, xy)
        except ValueError:
            continue
        pairs = choose.choice([-1, 0, 1, 2, 5, n, n + 1, 10**9])
        end: Any = choose.choice(["largest", "smallest", "middle"])
        try:
            previous = SOLVERS[name](graph, num_pairs=pairs, end=end, previous=previous)
        except ValueError:
            continue
        assert np.isfinite(previous.eigenvalues).all(), f"{name}: an eigenvalue is not finite"
        assert np.isfinite(previous.eigenvectors).all(), f"{name}: a vector is not finite"
        assert previous.eigenvectors.shape[0] == graph.ids.size, f"{name}: rows of others"


def abuse_environment(number: int) -> None:
    """Environments: actions of any kind between usual ones."""
    import gymnasium

    import scenarios  # noqa: F401

    choose = random.Random(f"environment:{number}")
    name = choose.choice(["StraightRoad-v0", "FourWayIntersection-v0"])
    environment: Any = gymnasium.make(f"graphrqi/{name}", disable_env_checker=True)
    try:
        environment.reset(seed=number % 7)
        for _ in range(8):
            action = environment.action_space.sample()
            if choose.random() < 0.4:
                action = choose.choice(
                    [*BAD, np.full(2, np.nan), np.zeros(3), None, "left", -1, 99]
                )
            try:
                seen, reward, ended, cut, _ = environment.step(action)
            except ValueError:
                continue
            for part in seen.values() if isinstance(seen, dict) else [seen]:
                assert np.isfinite(np.asarray(part, dtype=np.float64)).all(), "seen: not finite"
            assert np.isfinite(reward), "reward: not finite"
            if ended or cut:
                environment.reset()
    finally:
        environment.close()


CALLS: Final[dict[str, Callable[[int], None]]] = {
    "stream": abuse_stream,
    "solver": abuse_solver,
    "environment": abuse_environment,
}
"""What is called, by family; given the number of an input."""
