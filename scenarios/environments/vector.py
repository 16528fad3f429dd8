"""Many worlds of one environment in one process, stepped by one call.

``gymnasium.make_vec(id, num_envs=16)`` makes it for every environment of
`scenarios.environments.ENVIRONMENTS`; ``vectorization_mode="sync"`` or ``"async"`` makes
gymnasium's own instead. Each world is the environment of that id with the same seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate
from numpy.typing import NDArray

from behaviors.errors import InputError
from scenarios.environments.environment import TrafficEnv
from sim.highway.ego import as_mapping

MOST_WORLDS = 10_000
"""Most worlds of one batch."""


class TrafficVectorEnv(VectorEnv[Any, Any, Any]):
    """A batch of worlds with one ego vehicle each.

    A world whose episode has ended begins the next one at the following step, whatever the action
    (`gymnasium.vector.AutoresetMode.NEXT_STEP`). All worlds move before any of them is observed.

    Args:
        num_envs: how many worlds.
        config: the environment's configuration.
        render_mode: None or ``"rgb_array"``.
        row: what the environment's id stands for, see `ENVIRONMENTS`.

    Raises:
        InputError: if an argument is not usable; the message names it.

    Examples:
        >>> import gymnasium, scenarios
        >>> worlds = gymnasium.make_vec("graphrqi/TwoWayRoad-v0", num_envs=2,
        ...                             config={"warmup_s": 0.0})
        >>> observations, infos = worlds.reset(seed=0)
        >>> observations["agents"].shape
        (2, 15, 10)
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        **row: Any,
    ) -> None:
        if isinstance(num_envs, bool) or not 1 <= num_envs <= MOST_WORLDS:
            raise InputError(f"num_envs: found {num_envs!r}, expected 1 to {MOST_WORLDS}")
        if render_mode == "human":
            raise InputError("render_mode: found 'human', expected None or rgb_array")
        self.envs = [TrafficEnv(config, render_mode, **row) for _ in range(num_envs)]
        self.num_envs, self.render_mode = num_envs, render_mode
        first = self.envs[0]
        self.metadata = {**first.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}
        self._ended = np.zeros(num_envs, bool)
        self._take_spaces()

    def _take_spaces(self) -> None:
        """Take the spaces of the worlds."""
        self.single_observation_space = self.envs[0].observation_space
        self.single_action_space = self.envs[0].action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every world, or in some of them.

        Args:
            seed: of each world; an integer is the first world's, and the others count on from it.
            options: as of the environment; ``reset_mask``, (num_envs,) of bool, says which worlds.

        Returns:
            Observations of all worlds, and infos.
        """
        given = dict(as_mapping("options", options))
        mask = np.asarray(given.pop("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise InputError(f"reset_mask: found {mask!r:.60}, expected {self.num_envs} booleans")
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(f"seed: found {len(seeds)} seeds, expected {self.num_envs}")
        infos: dict[str, Any] = {}
        for i in np.flatnonzero(mask).tolist():
            _, info = self.envs[i].reset(seed=seeds[i], options=given or None)
            infos = self._add_info(infos, info, i)
        self._ended[mask] = False
        self._take_spaces()
        return self._observed(), infos

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Drive on for one policy step in every world.

        Args:
            actions: one of the action space for each world.

        Returns:
            Observations, rewards, whether the episode has ended, whether its time is up, and infos.

        Raises:
            InputError: if an action is not of the action space; no vehicle has moved.
        """
        begins, infos = self._ended.copy(), dict[str, Any]()
        rewards = np.zeros(self.num_envs)
        ended, cut = np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        chosen = [
            None if begin else env.checked(action)
            for env, action, begin in zip(
                self.envs, iterate(self.action_space, actions), begins, strict=True
            )
        ]
        for i, (env, action) in enumerate(zip(self.envs, chosen, strict=True)):
            if begins[i]:
                _, info = env.reset()
            else:
                env.drive({env.egos[0].id: action})
                rewards[i], ended[i], cut[i], info = env.judged(env.egos[0])
            infos = self._add_info(infos, info, i)
        self._ended = ended | cut
        return self._observed(), rewards, ended, cut, infos

    def _observed(self) -> Any:
        """The observations of all worlds as they are now."""
        seen = [env.observe(env.egos[0]) for env in self.envs]
        out: Any = create_empty_array(self.single_observation_space, n=self.num_envs)
        return concatenate(self.single_observation_space, seen, out)

    def render(self) -> tuple[Any, ...]:
        """An image of each world."""
        return tuple(env.render() for env in self.envs)

    def close_extras(self, **options: Any) -> None:
        """Close the windows of all worlds."""
        for env in self.envs:
            env.close()
