"""Slow checks: agents can be trained on the environments."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest

from scenarios import ENVIRONMENTS

pytestmark = pytest.mark.slow

EPISODES = 100
"""Episodes that a policy is judged by; the same traffic before and after training."""

LEARNED = ("graphrqi/StraightRoad-v0", "graphrqi/Motorway-v0", "graphrqi/MotorwayRamps-v0")
"""Where PPO, as it comes, drives better after 40,000 steps than it began."""


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_ppo_trains_for_five_thousand_steps(name):
    baselines = pytest.importorskip("stable_baselines3", reason="needs stable-baselines3")
    model = baselines.PPO(
        "MultiInputPolicy", gymnasium.make(name), n_steps=500, batch_size=100, seed=0, device="cpu"
    )
    model.learn(5000)
    assert model.num_timesteps == 5000
    rewards = [episode["r"] for episode in model.ep_info_buffer]
    assert rewards
    assert np.isfinite(rewards).all()


def rewards_of(policy, name: str) -> np.ndarray:
    """The sum of the rewards of each of some episodes, which nobody was trained on."""
    env, found = gymnasium.make(name), []
    for seed in range(10_000, 10_000 + EPISODES):
        observation, _ = env.reset(seed=seed)
        total, done = 0.0, False
        while not done:
            action, _ = policy.predict(observation, deterministic=False)
            observation, reward, ended, cut, _ = env.step(action)
            total, done = total + float(reward), ended or cut
        found.append(total)
    return np.array(found)


@pytest.mark.parametrize("name", LEARNED)
def test_ppo_drives_better_than_it_began(name):
    baselines = pytest.importorskip("stable_baselines3", reason="needs stable-baselines3")
    model = baselines.PPO(
        "MultiInputPolicy", gymnasium.make(name), n_steps=1024, batch_size=128, gamma=0.97,
        seed=0, device="cpu",
    )  # fmt: skip
    before = rewards_of(model.policy, name)
    model.learn(40_000)
    after = rewards_of(model.policy, name)
    gain = after - before
    error = gain.std(ddof=1) / math.sqrt(EPISODES)
    assert gain.mean() > 3.0 * error
