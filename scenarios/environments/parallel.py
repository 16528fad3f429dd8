"""Several ego vehicles on one road: a PettingZoo ``parallel_env`` of any of the environments.

Needs ``pip install graphrqi[multi]``. Observations, actions, rewards and infos of each agent are
those of the environment that it is made of (`scenarios.environments.environment.TrafficEnv`); the
other agents' vehicles are among what it observes. Agents come one after another, each at the
beginning of its route as soon as there is room, and go when their episode ends; their vehicles are
then taken off the road.

References:
    Terry et al. (2021), PettingZoo: Gym for multi-agent reinforcement learning, NeurIPS.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, ClassVar, Final

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from behaviors.errors import InputError, lookup
from scenarios.environments import ENVIRONMENTS
from scenarios.environments.environment import ROOM_M, TrafficEnv
from sim.highway.ego import as_mapping, distance_left_m

MOST_EGOS: Final = 1000
"""Most ego vehicles (more than any road here holds)."""


@dataclass
class _Ego:
    """One agent's share of an environment's state."""

    name: str
    id: int
    route: tuple[tuple[str, str], ...]
    vehicle: Any = None
    distance_left: float = 0.0
    near: set[int] = field(default_factory=set)
    near_misses: int = 0
    entered_s: float = 0.0


class ParallelTrafficEnv(ParallelEnv):  # type: ignore[misc]
    """Some ego vehicles among the traffic of an environment's road.

    Args:
        name: id of the environment, such as ``graphrqi/Roundabout-v0``.
        egos: how many agents come in an episode.
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
        module, made = lookup(ENVIRONMENTS, name, "environment").split(":")
        if isinstance(egos, bool) or not isinstance(egos, int) or not 1 <= egos <= MOST_EGOS:
            raise InputError(f"egos: found {egos!r}, expected 1 to {MOST_EGOS}")
        if not 0 <= every_s < np.inf:
            raise InputError(f"every_s: found {every_s!r}, expected seconds >= 0")
        if render_mode not in (None, "rgb_array"):
            raise InputError(f"render_mode: found {render_mode!r}, expected None or rgb_array")
        self.render_mode = render_mode
        self._env: TrafficEnv = getattr(import_module(module), made)(
            dict(config or {}), render_mode=render_mode
        )
        self._every_s = every_s
        self.possible_agents = [f"ego_{i}" for i in range(egos)]
        self.agents: list[str] = []
        self._define_spaces()

    def _define_spaces(self) -> None:
        env = self._env
        env.define_spaces()
        self.observation_spaces = {n: env.observation_space for n in self.possible_agents}
        self.action_spaces = {n: env.action_space for n in self.possible_agents}

    @property
    def unwrapped(self) -> ParallelTrafficEnv:
        """This environment."""
        return self

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """What an agent observes; the same for all."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """What an agent can do; the same for all."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode with the first agent.

        Args:
            seed: seed of everything random from now on; the same seed gives the same episode.
            options: ``{"config": {...}}`` changes the configuration; other keys are left alone, as
                PettingZoo asks for.

        Returns:
            Observations and infos by agent.
        """
        env = self._env
        given = as_mapping("options", options)
        wanted = {"config": given["config"]} if "config" in given else None
        first, info = env.reset(seed=seed, options=wanted)
        self._define_spaces()
        route = tuple(env.vehicle.stretches)
        ego = _Ego(self.possible_agents[0], env._ego_id, route, env.vehicle, env._distance_left)
        self._here: dict[str, _Ego] = {ego.name: ego}
        self._came_s = 0.0
        self._coming = [
            _Ego(name, env._ego_id + 1 + i, self._draw_route())
            for i, name in enumerate(self.possible_agents[1:])
        ]
        self.agents = [ego.name]
        return {ego.name: first}, {ego.name: info}

    def _draw_route(self) -> tuple[tuple[str, str], ...]:
        env = self._env
        given = env.config["ego_route"]
        route = env._drawn_route() if given is None else tuple(given)
        return tuple(env.road.network_info.stretches(route))

    @contextmanager
    def _as(self, ego: _Ego) -> Iterator[TrafficEnv]:
        """The environment as it is for one agent."""
        env = self._env
        env.vehicle, env._ego_id = ego.vehicle, ego.id
        env._distance_left, env._near = ego.distance_left, ego.near
        env._near_misses, time_s = ego.near_misses, env.time
        env.time = time_s - ego.entered_s
        try:
            yield env
        finally:
            ego.vehicle, ego.distance_left, ego.near = env.vehicle, env._distance_left, env._near
            ego.near_misses, env.time = env._near_misses, time_s

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]
    ]:  # fmt: skip
        """Drive on for one policy step.

        Args:
            actions: of the agents that are there; one without an action does what it did before.

        Returns:
            Observations, rewards, whether the agent's episode has ended, whether its time is up,
            and infos, by agent: of those that were there, and of those that have come.

        Raises:
            InputError: if an action is of an agent that is not there, or not one that the
                environment for one vehicle takes; nobody has moved.
        """
        env, checked = self._env, dict[str, Any]()
        for name, action in actions.items():
            lookup(self._here, name, "agent")
            checked[name] = env._checked(action)
        frames = env.config["simulation_frequency"] // env.config["policy_frequency"]
        before = {name: ego.distance_left for name, ego in self._here.items()}
        env._events = []
        for name, ego in self._here.items():
            ego.near_misses = 0
            if name in checked:
                with self._as(ego):
                    env.action_type.act(checked[name])
        for _ in range(frames):
            self._advance()
        seen, rewards, ended, cut, infos = {}, {}, {}, {}, {}
        for name, ego in self._here.items():
            with self._as(ego):
                parts = env._judge(checked.get(name, 0), before[name], frames)
                outcome = env._outcome(parts)
            seen[name], rewards[name], ended[name], cut[name], infos[name] = outcome
        for name in list(self._here):
            if ended[name] or cut[name]:
                env.road.vehicles.remove(self._here.pop(name).vehicle)
        while not self._let_in() and not self._here and self._coming:
            self._advance()
        for name, ego in self._here.items():
            if name not in seen:
                with self._as(ego):
                    seen[name], infos[name] = env._observe(), env._info()
                rewards[name], ended[name], cut[name] = 0.0, False, False
        self.agents = list(self._here)
        return seen, rewards, ended, cut, infos

    def _advance(self) -> None:
        """Move all agents for one simulation step."""
        env = self._env
        env._advance()
        env.steps += 1
        env.time += env._dt
        env.road.locate()
        for ego in self._here.values():
            with self._as(ego):
                env._note_near()

    def _let_in(self) -> bool:
        """Let the next agents in whose time has come and who have room; whether any came."""
        env, came = self._env, False
        for ego in list(self._coming):
            if env.time - self._came_s < self._every_s - 1e-9:
                break
            road = env.road
            road.locate()
            then = ego.route[1] if len(ego.route) > 1 else None
            lanes = road.network_info.lanes_towards(ego.route[0], then)
            lane, room, speed = env._roomiest(lanes)
            if room <= ROOM_M:
                continue
            env._ego_id = ego.id
            env._place_ego_vehicle(lane, room, speed, ego.route)
            ego.vehicle, ego.entered_s = env.vehicle, env.time
            road.locate()
            ego.distance_left = distance_left_m(road, ego.vehicle)
            self._coming.remove(ego)
            self._here[ego.name], self._came_s, came = ego, env.time, True
        return came

    def render(self) -> Any:
        """An image of the scene round the first agent."""
        for ego in itertools.islice(self._here.values(), 1):
            with self._as(ego):
                return self._env.render()
        return None

    def close(self) -> None:
        """Close the windows."""
        self._env.close()


def parallel_env(name: str = "graphrqi/FourWayIntersection-v0", **options: Any) -> ParallelEnv:
    """The environment for several agents of that id; see `ParallelTrafficEnv`."""
    return ParallelTrafficEnv(name, **options)
