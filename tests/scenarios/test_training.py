"""A slow check: an agent can be trained on the environments. Set GRAPHRQI_SLOW=1 to run it."""

from __future__ import annotations

import os

import gymnasium
import numpy as np
import pytest

from scenarios import ENVIRONMENTS

pytestmark = pytest.mark.skipif(
    "GRAPHRQI_SLOW" not in os.environ, reason="takes minutes; set GRAPHRQI_SLOW=1 to run it"
)


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
