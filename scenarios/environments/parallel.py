"""Several ego vehicles on one road: a PettingZoo ``parallel_env`` of any of the environments.

Needs ``pip install graphrqi[multi]``. Observations, actions, rewards and infos of each agent are
those of `scenarios.environments.environment.TrafficEnv`; the other agents' vehicles are among what
it observes. Agents enter one after another, each at the beginning of its route as soon as there is
room. Their vehicles leave the road when their episode ends.

References:
    Terry et al. (2021), PettingZoo: Gym for multi-agent reinforcement learning, NeurIPS.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from behaviors.errors import InputError, lookup
from scenarios.environments import ENVIRONMENTS
from scenarios.environments.environment import Ego, TrafficEnv
from sim.highway.ego import as_mapping


class ParallelTrafficEnv(ParallelEnv):  # type: ignore[misc]
    """Some ego vehicles among the traffic of an environment's road.

    Args:
        name: id of the environment, such as ``graphrqi/Roundabout-v0``.
        egos: agents per episode.
        every_s: least time between two of them, s.
        config: the environment's configuration. ``duration_s`` holds for each agent from when it
            comes. With ``ego_route`` all take that route, else each takes one of the traffic's.
        render_mode: None or ``"rgb_array"``; images follow the first agent.

    Raises:
        InputError: if an argument is not usable; the message names it.

    Examples:
        >>> env = ParallelTrafficEnv("graphrqi/Roundabout-v0", egos=2, config={"warmup_s": 0.0})
        >>> observations, infos = env.reset(seed=0)
        >>> env.possible_agents, list(observations)
        (['ego_0', 'ego_1'], ['ego_0'])
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "graphrqi_v0", "render_modes": ["rgb_array"], "is_parallelizable": True
    }  # fmt: skip

    def __init__(
        self,
        name: str = "graphrqi/FourWayIntersection-v0",
        *,
        egos: int = 4,
        every_s: float = 2.0,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        row = lookup(ENVIRONMENTS, name, "environment")
        if isinstance(egos, bool) or not isinstance(egos, int) or egos < 1:
            raise InputError(f"egos: found {egos!r}, expected 1 or more")
        if not 0 <= every_s < np.inf:
            raise InputError(f"every_s: found {every_s!r}, expected seconds >= 0")
        if render_mode not in (None, "rgb_array"):
            raise InputError(f"render_mode: found {render_mode!r}, expected None or rgb_array")
        self.render_mode = render_mode
        self.traffic = TrafficEnv(config, render_mode, **row)
        self._every_s, self._first_id = every_s, 0
        self.possible_agents = [f"ego_{i}" for i in range(egos)]
        self.agents: list[str] = []

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Observation space of an agent; the same for all."""
        return self.traffic.observation_space

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Action space of an agent; the same for all."""
        return self.traffic.action_space

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode with the first agent; observations and infos by agent.

        Args:
            seed: seed of all random numbers; it determines the episode.
            options: ``{"config": {...}}`` changes the configuration; other keys are left alone, as
                PettingZoo asks for.
        """
        given = as_mapping("options", options)
        wanted = {"config": given["config"]} if "config" in given else None
        observation, info = self.traffic.reset(seed=seed, options=wanted)
        self.traffic.invite(len(self.possible_agents) - 1)
        self._first_id = self.traffic.egos[0].id
        self.agents = self.possible_agents[:1]
        return {"ego_0": observation}, {"ego_0": info}

    def _present(self) -> dict[str, Ego]:
        """The ego vehicles on the road by agent."""
        return {self.possible_agents[ego.id - self._first_id]: ego for ego in self.traffic.egos}

    def step(self, actions: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
        """Drive on for one policy step.

        Args:
            actions: of the agents that are there; one without an action does what it did before.

        Returns:
            Observations, rewards, whether the agent's episode has ended, whether its time is up,
            and infos, by agent: of those that were there, and of those that have come.

        Raises:
            InputError: if an action is invalid, or of an absent agent; no vehicle has moved.
        """
        traffic, there = self.traffic, self._present()
        wanted = {lookup(there, name, "agent").id: a for name, a in actions.items()}
        traffic.drive({id: traffic.checked(action) for id, action in wanted.items()})
        outcomes = {name: traffic.outcome(ego) for name, ego in there.items()}
        for name, (_, _, ended, cut, _) in outcomes.items():
            if ended or cut:
                traffic.remove(there[name])
        traffic.let_in(self._every_s)
        present = self._present()
        for name, ego in present.items():
            if name not in outcomes:
                outcomes[name] = traffic.observe(ego), 0.0, False, False, traffic.info(ego)
        self.agents = list(present)
        return tuple({name: outcome[i] for name, outcome in outcomes.items()} for i in range(5))

    def render(self) -> Any:
        """An image of the scene round the first agent."""
        if not self.traffic.egos:
            return None
        self.traffic.vehicle = self.traffic.egos[0].vehicle
        return self.traffic.render()

    def close(self) -> None:
        """Close the windows."""
        self.traffic.close()


def parallel_env(name: str = "graphrqi/FourWayIntersection-v0", **options: Any) -> ParallelEnv:
    """The environment for several agents of that id; see `ParallelTrafficEnv`."""
    return ParallelTrafficEnv(name, **options)
