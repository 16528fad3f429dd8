"""Several agents on one road: PettingZoo's contract, and agents that come and go."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

pytest.importorskip("pettingzoo")
from pettingzoo.test import parallel_api_test

from scenarios import ENVIRONMENTS
from scenarios.environments.parallel import parallel_env

QUICK = {"warmup_s": 1.0, "duration_s": 4.0, "flow": "light"}


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_keeps_pettingzoos_contract(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        parallel_api_test(parallel_env(name, egos=3, every_s=1.0, config=QUICK), num_cycles=60)


def episode(seed: int, egos: int = 3):
    env = parallel_env("graphrqi/Roundabout-v0", egos=egos, every_s=1.0, config=QUICK)
    observations, _ = env.reset(seed=seed)
    seen, present, rewards = [observations], [set(env.agents)], []
    while env.agents:
        observations, reward, *_ = env.step(dict.fromkeys(env.agents, 3))
        seen.append(observations)
        present.append(set(env.agents))
        rewards.append(reward)
    return seen, present, rewards


def test_agents_come_one_after_another_and_go():
    _, present, _ = episode(seed=1)
    assert len(present[0]) == 1
    assert set().union(*present) == {"ego_0", "ego_1", "ego_2"}
    assert max(map(len, present)) > 1
    assert present[-1] == set()


def test_the_same_seed_gives_the_same_episode():
    (one, _, first), (two, _, second) = episode(seed=2), episode(seed=2)
    assert first == second
    for a, b in zip(one, two, strict=True):
        assert a.keys() == b.keys()
        for agent in a:
            for key, value in a[agent].items():
                np.testing.assert_array_equal(value, b[agent][key])


def test_one_agent_sees_what_the_environment_for_one_shows():
    import gymnasium

    config = {**QUICK, "seed": 7}
    alone = gymnasium.make("graphrqi/StraightRoad-v0", config=config).unwrapped
    shared = parallel_env("graphrqi/StraightRoad-v0", egos=1, config=config)
    first, _ = alone.reset(seed=3)
    both, _ = shared.reset(seed=3)
    np.testing.assert_array_equal(first["agents"], both["ego_0"]["agents"])
    for _ in range(10):
        observation, reward, ended, cut, _ = alone.step(3)
        observations, rewards, terminated, truncated, _ = shared.step({"ego_0": 3})
        np.testing.assert_array_equal(observation["ego"], observations["ego_0"]["ego"])
        np.testing.assert_array_equal(observation["agents"], observations["ego_0"]["agents"])
        assert (reward, ended, cut) == (
            rewards["ego_0"], terminated["ego_0"], truncated["ego_0"]
        )  # fmt: skip
        if ended or cut:
            break
