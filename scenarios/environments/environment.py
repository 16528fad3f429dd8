"""What the gymnasium environments share: episodes, rewards and observations.

Which road and which route an environment has is in its own module beside this one.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, Protocol, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from behaviors.registry import own_function
from scenarios import get_scenario
from scenarios.environments.config import TrafficConfig, describe_config, read_config
from scenarios.environments.observation import (
    observable_agents,
    observation_space,
    observe_agents,
    observe_ego,
    observe_graph,
)
from sim.frames import Event, EventKind, FloatArray, Frame
from sim.geometry import separation
from sim.highway.demand import Demand
from sim.highway.ego import (
    EgoEnv,
    Observation,
    as_mapping,
    distance_left_m,
    is_off_road,
    is_on_route,
)
from sim.highway.engine import network_of, read_frame
from sim.highway.lanes import LaneIndex
from sim.highway.traffic import TrafficRoad, agent_of, outlines_of
from sim.highway.vehicle import ProfileVehicle
from sim.scenario import AgentSpec, Scenario, sample_agents

NEAR_MISS_S: Final = 1.0
"""Time to collision below which a near miss is counted, s (Hayward 1972: 1 to 1.5 s)."""

NEAR_MISS_M: Final = 0.4
"""Passing this near, at more than walking pace, is a near miss too, m (an arm's length)."""

NEARBY_M: Final = 12.0
"""Only others whose centre is this near are checked for passing too near, m."""

WALKING_PACE_MPS: Final = 2.0

REWARDS: Final[dict[str, float]] = {
    "progress": 1.0,
    "collision": -10.0,
    "near_miss": -1.0,
    "red_run": -3.0,
    "off_road": -5.0,
}
"""The weight of each part of the reward (a collision costs more than ten seconds at the limit are
worth)."""

BEGIN_M: Final = 3.0
"""Where on its first lane the ego vehicle begins, m."""

ROOM_M: Final = 12.0
"""Room in front and behind that the ego vehicle needs to be set on the road, m (room to brake from
walking pace)."""

LONGEST_WAIT_S: Final = 60.0
"""The ego vehicle waits this long for room; then the vehicles in its place are removed."""


class Belief(Protocol):
    """What a classifier returns: probabilities of the six behaviours by agent id."""

    def of(self, ids: NDArray[np.int64]) -> FloatArray:
        """(m, 6) probabilities of the given agents."""
        ...


class TrafficEnv(EgoEnv):
    """The specification that every environment has in common.

    Observation: a ``Dict``. All boxes are float32 in [-1, 1]: values are divided by the unit given
    and clipped. N is ``observed``.

    ============ ============= ====================================================================
    key          shape         columns (unit)
    ============ ============= ====================================================================
    ego          (13,)         speed (20 m/s); offset to the left of the lane (lane widths); heading
                               to the left of the lane's (pi rad); limit (20 m/s); lanes to the
                               left, to the right (4); distance to the stop line (100 m, 1: none);
                               red, yellow, green (0 or 1); distance to the next crossing (100 m,
                               1: none); whether somebody is on it or at its kerb (0 or 1); distance
                               left to the goal (1000 m)
    agents       (N, 10)       others within 100 m, nearest first, rows of zeros after them: present
                               (1); x ahead, y to the left (100 m); velocity relative to the ego
                               vehicle ahead, to the left (20 m/s); cosine, sine of the heading
                               relative to it; length (12 m); width (3 m); a pedestrian (0 or 1)
    agents       (N, 16)       with "behavior": six more, 1 for the driver's true behaviour
    agents       (N, 16)       with "posterior": six more, the classifier's probabilities; uniform
                               until a driver is known
    mask         (N + 1,)      with "graph", int8: which nodes exist; node 0 is the ego vehicle,
                               node i + 1 is row i of ``agents``
    adjacency    (N + 1, N+1)  with "graph", int8, symmetric: 1 if either is among the other's 4
                               nearest
    ============ ============= ====================================================================

    The behaviours' order is that of ``behaviors.BEHAVIORS``; pedestrians have zeros there.

    Actions: highway-env's. By default 5 meta actions: 0 lane to the left, 1 nothing, 2 lane to the
    right, 3 faster, 4 slower, between the target speeds 0, 3, 6, 9, 12 and 15 m/s. Nothing stops
    the ego vehicle at signals, crossings or behind others; the others react to it as to anybody.

    Reward per step: progress along the route as a share of what the limit allows, in [0, 1]; -10
    for a collision; -1 for each near miss (time to collision to the leader below 1 s, or passing
    within 0.4 m); -3 for running a red light; -5 for leaving the road. ``info["rewards"]`` has the
    parts.

    Episode: begins when there is room for the ego vehicle at the beginning of its route, at 0.7 of
    the limit. Terminated by a collision, by leaving the road, or at the goal; truncated after
    ``duration_s``.

    ``info``: time_s, speed (m/s), crashed, arrived, collisions, near_misses, red_runs, rewards, and
    events: tuples (what, agent, other or -1, rule) of all events in the step. Ids are those
    of the drawn agents; the ego vehicle's is one more than the greatest.

    Images: lanes, crossings, stop lines in the colour of their signal, pedestrians, vehicles in the
    colour of their behaviour (warm: aggressive, cool: conservative), the ego vehicle white. For a
    video at the simulation's rate wrap in ``RecordVideo`` and call
    ``env.unwrapped.set_record_video_wrapper(env)``.
    """

    config_model: ClassVar[type[TrafficConfig]] = TrafficConfig
    own_defaults: ClassVar[dict[str, Any]] = {}
    scenario_name: ClassVar[str]

    def __init_subclass__(cls) -> None:
        """Append the common specification and the configuration to an environment's docstring."""
        common = inspect.cleandoc(TrafficEnv.__doc__ or "").partition("\n\n")[2]
        keys = describe_config(cls.config_model, cls.default_config())
        cls.__doc__ = (
            f"{inspect.cleandoc(cls.__doc__ or '')}\n\n{common}\n\n"
            f"Configuration (``config``), each key with its default:\n\n{keys}\n"
        )

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """The value of every key that is not given; the class docstring explains the keys."""
        return {**cls.config_model().values(), **cls.own_defaults}

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Take changes to the configuration.

        Raises:
            InputError: if a key is unknown or a value is not usable; the message names it.
        """
        given = as_mapping("config", config)
        checked = read_config(self.config_model, {**self.config, **given})
        self.scenario = self._scenario_of(checked)
        if checked.ego_route is not None:
            network_of(self.scenario.road).stretches(checked.ego_route)
        super().configure({key: getattr(checked, str(key)) for key in given})

    def _scenario_of(self, checked: TrafficConfig) -> Scenario:
        """The scenario of a configuration; another one's own options hold unless they are given."""
        reference = checked.net or checked.scenario or self.scenario_name
        options: dict[str, Any] = {
            "flow": checked.flow, "mix": checked.mix, "spread": checked.spread,
            "population": checked.population,
        }  # fmt: skip
        if reference != self.scenario_name:
            usual = TrafficConfig()
            options = {n: v for n, v in options.items() if v != getattr(usual, n)}
        if checked.routes is not None:
            options["routes"] = checked.routes
        duration_s = checked.duration_s + checked.warmup_s + LONGEST_WAIT_S
        return get_scenario(reference)(**options, duration_s=duration_s)

    @property
    def elsewhere(self) -> bool:
        """Whether the configuration names another road than the environment's own."""
        return self.config["net"] is not None or self.config["scenario"] is not None

    def _ego_route(self) -> tuple[str, ...]:
        """The edges that the ego vehicle drives over in this episode."""
        given = self.config["ego_route"]
        if given is not None:
            return tuple(given)
        return self._drawn_route() if self.elsewhere else self._route()

    def _drawn_route(self) -> tuple[str, ...]:
        """A route of the traffic's, as often as vehicles take it."""
        flows = [flow for flow in self.scenario.flows if not flow.walking]
        rates = np.array([flow.per_hour for flow in flows])
        weights = rates / rates.sum() if rates.sum() > 0 else None
        return flows[int(self.np_random.choice(len(flows), p=weights))].route

    def _route(self) -> tuple[str, ...]:
        """The edges that the ego vehicle drives over on the environment's own road."""
        return self._drawn_route()

    # Episodes --------------------------------------------------------------------------------

    def _reset(self) -> None:
        config = self.config
        traffic = config["seed"]
        if traffic is None:
            traffic = int(self.np_random.integers(2**31))
        agents = self._draw_agents(traffic)
        self._agents = {agent.id: agent for agent in agents}
        self._classify = self._classifier()
        self._belief: Belief | None = None
        self._events: list[Event] = []
        self._near: set[int] = set()
        self._near_misses = self._collisions = self._red_runs = 0
        self._progress = 0.0
        self._ego_id = max((agent.id for agent in agents), default=-1) + 1
        self.controlled_vehicles = []
        self._dt = 1.0 / config["simulation_frequency"]
        network = network_of(self.scenario.road)
        route = tuple(network.stretches(self._ego_route()))
        lanes = network.lanes_towards(route[0], route[1] if len(route) > 1 else None)
        self._place_ego_vehicle(*self._warm_up(agents, traffic, lanes), route)
        self.define_spaces()
        self._distance_left = distance_left_m(self.road, self.vehicle)
        self._events = []
        self.road.locate()

    def _draw_agents(self, seed: int) -> tuple[AgentSpec, ...]:
        """Everybody but the ego vehicle, in an episode whose traffic has this seed."""
        return sample_agents(self.scenario, seed)

    def _classifier(self) -> Callable[[Frame], Belief] | None:
        """What classifies the drivers of this episode; None where nothing is classified."""
        if self.config["observation"] != "posterior":
            return None
        source = self.config["classifier"]
        if not isinstance(source, str):
            return cast(Callable[[Frame], Belief], source)
        made = own_function("classifier", source)()
        classify = getattr(made, "update", made)
        if not callable(classify):
            raise InputError(
                f"classifier: found {source!r}, which makes {made!r}, "
                "expected it to make a callable or one with 'update'"
            )
        return cast(Callable[[Frame], Belief], classify)

    def _warm_up(
        self, agents: tuple[AgentSpec, ...], seed: int, lanes: list[LaneIndex]
    ) -> tuple[LaneIndex, float, float]:
        """Let the traffic drive, then until one of some lanes has room for the ego vehicle.

        Returns:
            That lane, its room, m, and the speed of the next vehicle on it, m/s.
        """
        network = network_of(self.scenario.road)
        self.road = TrafficRoad(network)
        self._demand = Demand(self.road, agents, seed)
        for _ in range(round(self.config["warmup_s"] / self._dt)):
            self._advance()
        for _ in range(round(LONGEST_WAIT_S / self._dt)):
            self.road.locate()
            lane, room, speed = self._roomiest(lanes)
            if room > ROOM_M:
                return lane, room, speed
            self._advance()
        for vehicle in list(self.road.vehicles):
            s = self.road.distance_along(vehicle, lane)
            if abs(s - BEGIN_M) < 2.0 * ROOM_M and vehicle.lane_index[:2] == lane[:2]:
                self.road.vehicles.remove(vehicle)
        return lane, room, speed

    def _place_ego_vehicle(
        self, lane: LaneIndex, room: float, speed: float, route: tuple[tuple[str, str], ...]
    ) -> None:
        """Put the ego vehicle on a lane, as fast as the vehicle ahead allows."""
        begin = 0.7 * float(self.road.network_info.lanes[lane].speed_limit)
        begin = min(begin, speed) if room < 40.0 else begin
        self.add_ego_vehicle(lane, BEGIN_M, begin, route, self._ego_id)

    def _roomiest(self, lanes: list[LaneIndex]) -> tuple[LaneIndex, float, float]:
        """The lane with most room at its beginning, that room, m, and the next vehicle's speed."""
        found: list[tuple[LaneIndex, float, float]] = []
        for lane in lanes:
            room, speed = math.inf, math.inf
            distances, rows, _ = self.road.on_lane(lane)
            for s, row in zip(distances, rows, strict=True):
                vehicle = self.road.vehicles[row]
                if abs(s - BEGIN_M) < room:
                    room, speed = abs(s - BEGIN_M) - vehicle.LENGTH / 2 - 2.5, vehicle.speed
            found.append((lane, room, speed))
        return max(found, key=lambda one: one[1])

    def _advance(self) -> None:
        """Move all agents for one simulation step."""
        road = self.road
        self._demand.enter()
        road.act()
        road.step(self._dt)
        if self._classify is not None:
            frame = read_frame(road)
            self._events += frame.events
            self._belief = self._classify(frame)
        else:
            self._events += road.take_events()

    def step(
        self, action: int | NDArray[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive on for one policy step.

        Args:
            action: of the action space.

        Returns:
            Observation, reward, whether the episode has ended, whether its time is up, and info.

        Raises:
            InputError: if the action is not of the action space's shape, not among its numbers or
                not finite, or no episode has begun; the environment stays as it was.
        """
        if not self._begun:
            raise InputError("step: found no episode, expected reset before the first step")
        config = self.config
        if not config["manual_control"]:
            action = self._checked(action)
        frames = config["simulation_frequency"] // config["policy_frequency"]
        self._events, self._near_misses = [], 0
        before = self._distance_left
        for frame in range(frames):
            if frame == 0 and not config["manual_control"]:
                self.action_type.act(action)
            self._advance()
            self.steps += 1
            self._watch()
            if frame < frames - 1:
                self._automatic_rendering()
        self.enable_auto_render = False
        self.time += frames * self._dt
        parts = self._judge(action, before, frames)
        if self.render_mode == "human":
            self.render()
        return self._outcome(parts)

    def _watch(self) -> None:
        """Look at the frame that has just been simulated."""
        self.road.locate()
        self._note_near()

    def _note_near(self) -> None:
        """Count those that have come near since the last frame."""
        near = self._near_ids()
        self._near_misses += len(near - self._near)  # once each time somebody comes near
        self._near = near

    def _judge(self, action: int | NDArray[Any], before: float, frames: int) -> dict[str, float]:
        """The parts of the reward for a policy step that began with so much of the way left."""
        if is_on_route(self.road, self.vehicle):
            self._distance_left = distance_left_m(self.road, self.vehicle)
        mine = [e for e in self._events if self._ego_id in (e.agent, e.other)]
        self._collisions = sum(e.kind is EventKind.COLLISION for e in mine)
        self._red_runs = sum(e.kind is EventKind.RED_RUN and e.agent == self._ego_id for e in mine)
        limit = float(self.vehicle.lane.speed_limit)
        reachable_m = limit * frames * self._dt
        self._progress = float(np.clip((before - self._distance_left) / reachable_m, 0.0, 1.0))
        return self._rewards(action)

    def _outcome(
        self, parts: Mapping[str, float]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """What `step` returns, from the parts of the reward."""
        reward = sum(REWARDS[name] * value for name, value in parts.items())
        ended, cut = self._is_terminated(), self._is_truncated()
        return self._observe(), float(reward), ended, cut, self._info(parts)

    def _checked(self, action: object) -> Any:
        """An action as the action space has it: a whole number, or an array of its shape.

        Raises:
            InputError: if it is none.
        """
        space, numbers = self.action_space, np.asarray(action)
        if isinstance(space, spaces.Discrete):
            if numbers.size != 1 or not np.isin(numbers, np.arange(space.n)).all():
                raise InputError(f"action: found {action!r:.60}, expected 0 to {space.n - 1}")
            return int(numbers.reshape(())[()])
        if isinstance(space, spaces.Box) and (
            numbers.dtype.kind not in "biuf"
            or numbers.size != np.prod(space.shape)
            or not np.isfinite(numbers).all()
        ):
            raise InputError(
                f"action: found {action!r:.60}, expected finite numbers of shape {space.shape}"
            )
        return numbers.reshape(space.shape) if isinstance(space, spaces.Box) else action

    def _rewards(self, action: int | NDArray[Any]) -> dict[str, float]:
        return {
            "progress": self._progress,
            "collision": float(self._collisions),
            "near_miss": float(self._near_misses),
            "red_run": float(self._red_runs),
            "off_road": float(is_off_road(self.road, self.vehicle)),
        }

    def _is_terminated(self) -> bool:
        ego = self.vehicle
        return bool(ego.crashed or is_off_road(self.road, ego) or self._arrived())

    def _is_truncated(self) -> bool:
        return bool(self.time >= self.config["duration_s"] - 1e-9)

    def _arrived(self) -> bool:
        last = self.vehicle.lane_index[:2] == self.vehicle.stretches[-1]
        return bool(last and self._distance_left <= 0.0)

    def _info(self, rewards: Mapping[str, float] | None = None) -> dict[str, Any]:
        return {
            "time_s": float(self.time),
            "speed": float(self.vehicle.speed),
            "crashed": bool(self.vehicle.crashed),
            "arrived": self._arrived(),
            "collisions": int(self._collisions),
            "near_misses": int(self._near_misses),
            "red_runs": int(self._red_runs),
            "rewards": dict(rewards or {name: 0.0 for name in REWARDS}),
            "events": tuple(
                (str(e.kind), e.agent, -1 if e.other is None else e.other, e.rule)
                for e in self._events
            ),
        }

    def _near_ids(self) -> set[int]:
        """Ids of those that the ego vehicle is about to hit or passes too near."""
        ego, road = self.vehicle, self.road
        near = set()
        lead = road.neighbours(ego, ego.lane_index)
        closing = ego.speed - lead.front_speed
        if lead.front is not None and closing > 0.0 and lead.front_gap < NEAR_MISS_S * closing:
            near.add(agent_of(lead.front))
        if ego.speed <= WALKING_PACE_MPS:
            return near
        others = [
            one for one in (*road.vehicles, *road.walkers)
            if one is not ego and float(np.hypot(*(one.position - ego.position))) < NEARBY_M
        ]  # fmt: skip
        if others:
            gaps = separation(outlines_of([ego] * len(others)), outlines_of(others))
            near |= {agent_of(others[i]) for i in np.flatnonzero(gaps < NEAR_MISS_M)}
        return near

    # Observation -----------------------------------------------------------------------------

    def _make_observation_space(self) -> spaces.Dict:
        return observation_space(self.config["observation"], self.config["observed"])

    def _observe(self) -> Observation:
        self.road.locate()
        ego, observed = self.vehicle, self.config["observed"]
        others = observable_agents(self.road, ego)[:observed]
        found: Observation = {
            "ego": observe_ego(self.road, ego, self._distance_left),
            "agents": observe_agents(ego, others, self._behaviors(others), observed),
        }
        if self.config["observation"] == "graph":
            found |= observe_graph(ego, others, observed)
        return found

    def _behaviors(self, others: list[Any]) -> FloatArray | None:
        """(n, 6) what is observed of behaviours: the truth, the belief, or None for nothing."""
        option = self.config["observation"]
        found = np.zeros((len(others), len(BEHAVIORS)))
        if option == "behavior":
            for row, other in enumerate(others):
                drawn = self._agents.get(agent_of(other))  # another ego vehicle is not drawn
                if drawn is not None and drawn.behavior is not None:
                    found[row, drawn.behavior.code] = 1.0
            return found
        if option != "posterior":
            return None
        driving = [row for row, other in enumerate(others) if isinstance(other, ProfileVehicle)]
        if self._belief is None:
            found[driving] = 1.0 / len(BEHAVIORS)
        elif others:
            ids = np.array([agent_of(one) for one in others], dtype=np.int64)
            found[driving] = np.asarray(self._belief.of(ids), dtype=np.float64)[driving]
        return found
