"""Many worlds that one call steps."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import scenarios  # noqa: F401
from behaviors import InputError

NAME = "graphrqi/TwoWayRoad-v0"
CONFIG = {"warmup_s": 5.0, "duration_s": 3.0}


def episodes(mode: str) -> list:
    """What worlds return for the same seeds and actions, past the end of their first episodes."""
    worlds = gymnasium.make_vec(NAME, num_envs=3, vectorization_mode=mode, config=CONFIG)
    rng = np.random.default_rng(0)
    seen = [worlds.reset(seed=5)[0]]
    for _ in range(20):
        observation, reward, ended, cut, info = worlds.step(rng.integers(0, 5, 3))
        seen += [observation, {"reward": reward, "ended": ended, "cut": cut, **info}]
    assert cut.dtype == bool
    worlds.close()
    return seen


def test_a_batch_is_the_single_worlds_to_the_bit():
    batch, single = episodes("vector_entry_point"), episodes("sync")
    for one, other in zip(batch, single, strict=True):
        for key in ("ego", "agents", "reward", "ended", "cut", "time_s", "speed"):
            assert (key in one) == (key in other)
            if key in one:
                assert np.asarray(one[key]).tobytes() == np.asarray(other[key]).tobytes(), key


def test_some_worlds_can_begin_anew():
    worlds = gymnasium.make_vec(NAME, num_envs=2, config=CONFIG)
    before, _ = worlds.reset(seed=[1, 2])
    worlds.step([3, 3])
    again, _ = worlds.reset(seed=[1, 9], options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(again["ego"][0], before["ego"][0])
    with pytest.raises(InputError, match="seed: found 1 seeds, expected 2"):
        worlds.reset(seed=[1])
    with pytest.raises(InputError, match="action: found 7"):
        worlds.step([0, 7])
