"""Environments under abuse: what no agent should send is refused, and the episode goes on."""

from __future__ import annotations

import copy
import os
import pickle
import signal
from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import scenarios  # noqa: F401
from behaviors.errors import InputError

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

ABUSE = settings(
    deadline=None, max_examples=30, derandomize=True, suppress_health_check=list(HealthCheck)
)
QUICK = {"warmup_s": 0.0, "duration_s": 4.0, "flow": "light"}
KINDS = [{}, {"action": {"type": "ContinuousAction"}}, {"action": {"type": "DiscreteAction"}}]
LONGEST_S = 120

odd = st.sampled_from(
    [
        None, "x", "", [], {}, True, b"y", -1, -5.0, 99, 10**400, 1e308, 5e-324, np.nan, np.inf,
        (1, 2), np.full(2, np.nan), np.zeros(3), np.zeros((2, 1)), np.array(["a", "b"]),
        np.array([1.0]), object(),
    ]
)  # fmt: skip


def make(name: str = "StraightRoad", **config: Any) -> Any:
    return gymnasium.make(
        f"graphrqi/{name}-v0", config={**QUICK, **config}, disable_env_checker=True
    ).unwrapped


def refused(call: Any, *given: Any, **named: Any) -> Any:
    """What a call answers; None where it refuses in one line."""
    try:
        return call(*given, **named)
    except InputError as error:
        return None if "\n" not in str(error) else pytest.fail(f"not one line: {error}")


def usable(environment: Any, answered: tuple[Any, float, bool, bool, dict[str, Any]]) -> None:
    seen, reward, *_ = answered
    assert environment.observation_space.contains(seen)
    assert all(np.isfinite(part).all() for part in seen.values())
    assert np.isfinite(reward)


def run(environment: Any, steps: int = 6) -> list[Any]:
    seen, _ = environment.reset(seed=3)
    environment.action_space.seed(0)
    return [seen, *(environment.step(environment.action_space.sample()) for _ in range(steps))]


def alike(one: list[Any], other: list[Any]) -> bool:
    return pickle.dumps(one) == pickle.dumps(other)


@ABUSE
@given(st.data(), st.sampled_from(["StraightRoad", "FourWayIntersection"]), st.sampled_from(KINDS))
def test_actions_are_taken_or_change_nothing(
    data: st.DataObject, name: str, config: dict[str, Any]
) -> None:
    environment, undisturbed = make(name, **config), make(name, **config)
    for one in (environment, undisturbed):
        one.reset(seed=1)
        one.action_space.seed(2)
    for _ in range(4):
        if refused(environment.step, data.draw(odd)) is not None:
            return  # it was one of the actions that there are
        usual = environment.action_space.sample()
        answered = environment.step(usual)
        usable(environment, answered)
        assert alike([answered[:4]], [undisturbed.step(usual)[:4]])
    environment.close()
    undisturbed.close()


@ABUSE
@given(st.data(), st.sampled_from(sorted(make().default_config())), odd)
def test_a_configuration_is_refused_or_drives(data: st.DataObject, key: str, value: Any) -> None:
    environment = refused(make, **{key: value})
    if environment is None:
        return
    if refused(environment.reset, seed=1) is not None:
        answered = refused(environment.step, environment.action_space.sample())
        if answered is not None:
            usable(environment, answered)
    environment.close()


def test_calls_out_of_order_are_refused_or_harmless() -> None:
    environment = make()
    with pytest.raises(InputError, match="step: found no episode, expected reset before"):
        environment.step(0)
    with pytest.raises(InputError, match="seed: found 'a', expected a whole number"):
        environment.reset(seed="a")
    environment.reset(seed=np.int64(3))
    environment.close()
    environment.close()
    assert alike(run(environment), run(make()))


@pytest.mark.parametrize("again", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_of_an_environment_go_on_alike(again: Any) -> None:
    environment = make()
    run(environment)
    other = again(environment)
    for action in (0, 1, 2):
        assert alike([environment.step(action)], [other.step(action)])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:This process")
def test_an_environment_drives_in_a_process_that_is_forked() -> None:
    environment = make()
    wanted = run(environment)
    child = os.fork()
    if child == 0:  # no exception may leave this branch
        code = 1
        try:
            signal.alarm(LONGEST_S)
            code = 0 if alike(run(environment), wanted) and alike(run(make()), wanted) else 2
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
