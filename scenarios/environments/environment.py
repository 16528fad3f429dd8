"""A scenario as a gymnasium environment: one vehicle is yours, the traffic is ours.

It runs on our road for highway-env and takes highway-env's actions; the other drivers have the six
behaviours' profiles. What the environments share is here; which road and which way is theirs
(`scenarios.environments`).
"""

from __future__ import annotations

import importlib
import inspect
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, Protocol, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import (
    ActionType,
    ContinuousAction,
    DiscreteAction,
    DiscreteMetaAction,
)
from numpy.typing import NDArray

from behaviors.errors import InputError, lookup
from behaviors.labels import BEHAVIORS
from behaviors.profiles import DEFAULT_SPREAD
from sim.frames import AgentKind, Event, EventKind, Frame, Signal
from sim.highway.demand import Demand
from sim.highway.engine import network_of, read_frame
from sim.highway.fast_road import separation
from sim.highway.network import HighwayNetwork, LaneIndex
from sim.highway.traffic import STRETCH_MARGIN_M, TrafficRoad, agent_of
from sim.highway.vehicle import ProfileVehicle
from sim.highway.viewer import TrafficViewer
from sim.highway.walkers import Walker
from sim.scenario import Scenario, sample_agents

FloatArray = NDArray[np.float64]
Observation = dict[str, NDArray[Any]]

RANGE_M: Final = 100.0
"""How far the ego vehicle sees, m."""

SPEED_MPS: Final = 20.0
"""Speeds are observed as multiples of this, m/s."""

LENGTH_M: Final = 12.0
WIDTH_M: Final = 3.0
"""Lengths and widths are observed as multiples of these, m: a bus."""

WAY_M: Final = 1000.0
"""The distance left is observed as a multiple of this, m."""

EGO_FEATURES: Final[tuple[str, ...]] = (
    "speed", "offset", "heading", "limit", "lanes_left", "lanes_right", "stop_line",
    "red", "yellow", "green", "crossing", "crossing_used", "distance_left",
)  # fmt: skip
"""The columns of the observation ``ego``."""

AGENT_FEATURES: Final[tuple[str, ...]] = (
    "present", "x", "y", "vx", "vy", "cos_heading", "sin_heading", "length", "width", "walking",
)  # fmt: skip
"""The columns of the observation ``agents``, before those of the behaviours."""

OBSERVATIONS: Final[dict[str, str]] = {
    "kinematics": "what can be seen",
    "behavior": "what can be seen, and every driver's true behaviour",
    "posterior": "what can be seen, and what the classifier believes of every driver",
    "graph": "what can be seen, and who is near whom",
}
"""The observation options."""

NEIGHBOURS: Final = 4
"""How many nearest agents each agent is joined to in the traffic graph (as in the paper)."""

NEAR_MISS_S: Final = 1.0
"""Time to collision below which a near miss is counted, s (Hayward 1972: 1 to 1.5 s)."""

NEAR_MISS_M: Final = 0.4
"""Passing this near, at more than walking pace, is a near miss too, m (our choice)."""

WALKING_PACE_MPS: Final = 2.0

REWARDS: Final[dict[str, float]] = {
    "progress": 1.0,
    "collision": -10.0,
    "near_miss": -1.0,
    "red_run": -3.0,
    "off_road": -5.0,
}
"""What each part of the reward is multiplied by (our choice: a collision costs more than ten
seconds at the limit are worth)."""

ROOM_M: Final = 12.0
"""Room in front and behind that the ego vehicle needs to be set on the road, m (our choice)."""

LONGEST_WAIT_S: Final = 60.0
"""For so long the ego vehicle waits for room; then room is made (our choice)."""

ACTIONS: Final[dict[str, type[ActionType]]] = {
    "DiscreteMetaAction": DiscreteMetaAction,
    "DiscreteAction": DiscreteAction,
    "ContinuousAction": ContinuousAction,
}
"""highway-env's actions for one vehicle."""


class Belief(Protocol):
    """What a classifier returns: probabilities of the six behaviours by agent id."""

    def of(self, ids: NDArray[np.int64]) -> FloatArray:
        """(m, 6) probabilities of the given agents."""
        ...


class TrafficEnv(AbstractEnv):  # type: ignore[misc]
    """What the environments have in common; see each one's own docstring.

    Args:
        config: changes to `default_config`, by key.
        render_mode: None, ``"rgb_array"`` or ``"human"``.

    Raises:
        InputError: if a key is unknown or a value means nothing; the message names it.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": ["human", "rgb_array"],
        "render_fps": 5,
    }

    road: TrafficRoad
    config: dict[str, Any]
    time: float
    steps: int
    controlled_vehicles: list[Any]
    action_space: spaces.Space[Any]
    observation_space: spaces.Space[Any]
    viewer: Any

    def __init__(
        self, config: Mapping[str, Any] | None = None, render_mode: str | None = None
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise InputError(
                f"render_mode: found {render_mode!r}, expected one of "
                f"{', '.join(self.metadata['render_modes'])}"
            )
        self.metadata = dict(type(self).metadata)  # type: ignore[misc]
        self._made = False
        super().__init__(dict(_mapping("config", config)), render_mode)
        self._made = True

    # Configuration ---------------------------------------------------------------------------

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """The configuration where nothing else is asked for; see the class docstring."""
        kept = (
            "screen_width", "screen_height", "centering_position", "scaling", "render_agent",
            "offscreen_rendering", "manual_control", "real_time_rendering",
        )  # fmt: skip
        base = AbstractEnv.default_config()
        return {
            **{key: base[key] for key in kept},
            "observation": "kinematics",
            "observed": 15,
            "action": {
                "type": "DiscreteMetaAction",
                "target_speeds": [0.0, 3.0, 6.0, 9.0, 12.0, 15.0],
            },
            "flow": "medium",
            "mix": None,
            "spread": DEFAULT_SPREAD,
            "seed": None,
            "duration_s": 40.0,
            "warmup_s": 20.0,
            "simulation_frequency": 10,
            "policy_frequency": 5,
            "classifier": "graphrqi.stream:load_stream",
        }

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Take changes to the configuration.

        Raises:
            InputError: if a key is unknown or a value means nothing; the message names it.
        """
        config = _mapping("config", config)
        changed = {**self.config, **config}
        for key in changed:
            lookup(self.default_config(), str(key), "configuration key")
        _check_config(changed)
        lasts = float(changed["duration_s"]) + float(changed["warmup_s"]) + LONGEST_WAIT_S
        self.scenario = self._make_scenario(changed, lasts)
        super().configure({key: changed[key] for key in config})

    def _make_scenario(self, config: Mapping[str, Any], duration_s: float) -> Scenario:
        """The scenario that a configuration asks for."""
        raise NotImplementedError

    def define_spaces(self) -> None:
        """The spaces of the configured observation and action; kept, with their seeds, if equal."""
        options = self.config["action"]
        self.action_type = ACTIONS[options["type"]](self, **options)
        action_space = self.action_type.space()
        if action_space != self.action_space:
            self.action_space = action_space
        observation_space = _observation_space(self.config)
        if observation_space != self.observation_space:
            self.observation_space = observation_space

    def update_metadata(self, video_real_time_ratio: float = 1.0) -> None:
        """Note how many images a second are drawn, so that videos run in real time."""
        recorded = "simulation_frequency" if self._record_video_wrapper else "policy_frequency"
        self.metadata["render_fps"] = round(video_real_time_ratio * self.config[recorded])

    # Episodes --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: of all chance from now on; the same seed gives the same episode.
            options: ``{"config": {...}}`` changes the configuration.

        Returns:
            The first observation, and info.

        Raises:
            InputError: if the configuration means nothing.
        """
        if not self._made:  # highway-env's own way to make a scene; here every episode makes one
            return {}, {}
        gymnasium.Env.reset(self, seed=seed)
        options = dict(_mapping("options", options))
        if options:
            for key in options:
                lookup({"config": None}, str(key), "reset option")
            self.configure(_mapping("config", options["config"]))
        self.update_metadata()
        self.time, self.steps, self.done = 0.0, 0, False
        self._reset()
        self.define_spaces()
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(None)

    def _reset(self) -> None:
        config = self.config
        traffic = config["seed"]
        if traffic is None:
            traffic = int(self.np_random.integers(2**31))
        agents = sample_agents(self.scenario, traffic)
        network = network_of(self.scenario.road)
        self.road = TrafficRoad(network, compiled=config.get("compiled", False))
        self._demand = Demand(self.road, agents, traffic)
        self._true = {agent.id: agent for agent in agents}
        self._classify = self._classifier()
        self._belief: Belief | None = None
        self._events: list[Event] = []
        self._near: set[int] = set()
        self._near_misses = self._collisions = self._red_runs = 0
        self._progress = 0.0
        self._ego_id = max((agent.id for agent in agents), default=-1) + 1
        self.controlled_vehicles = []
        dt = 1.0 / config["simulation_frequency"]
        for _ in range(round(config["warmup_s"] / dt)):
            self._advance(dt)
        self._set_ego()
        self.define_spaces()
        self._distance_left = self._way_left()
        self._events = []
        self.road.look()

    def _classifier(self) -> Callable[[Frame], Belief] | None:
        if self.config["observation"] != "posterior":
            return None
        source = self.config["classifier"]
        if not isinstance(source, str):
            return cast(Callable[[Frame], Belief], source)
        made = _classifier_maker(source)()
        classify = getattr(made, "update", made)
        if not callable(classify):
            raise InputError(
                f"classifier: found {source!r}, which makes {made!r}, "
                "expected it to make a callable or one with 'update'"
            )
        return cast(Callable[[Frame], Belief], classify)

    def _set_ego(self) -> None:
        """Put the ego vehicle at the beginning of its way, once there is room."""
        road, network = self.road, self.road.network_info
        route = self._route()
        stretches = tuple(network.stretches(route))
        then = stretches[1] if len(stretches) > 1 else None
        begin = 3.0
        dt = 1.0 / self.config["simulation_frequency"]
        lanes = network.lanes_towards(stretches[0], then)
        for _ in range(round(LONGEST_WAIT_S / dt)):
            road.look()
            lane, room, speed = self._roomiest(lanes, begin)
            if room > ROOM_M:
                break
            self._advance(dt)
        else:
            for vehicle in [road_user for road_user in road.vehicles]:
                s, _ = road.place(vehicle, lane)
                if abs(s - begin) < 2.0 * ROOM_M and vehicle.lane_index[:2] == lane[:2]:
                    road.vehicles.remove(vehicle)
        geometry = network.lanes[lane]
        limit = float(geometry.speed_limit)
        ego = self.action_type.vehicle_class(
            road,
            geometry.position(begin, 0.0),
            geometry.heading_at(begin),
            min(0.7 * limit, speed) if room < 40.0 else 0.7 * limit,
        )
        ego.agent, ego.kind, ego.behavior = self._ego_id, AgentKind.CAR, None
        ego.stretches = stretches
        ego.route = _highway_route(network, lane, stretches)
        road.vehicles.append(ego)
        self.vehicle = ego

    def _route(self) -> tuple[str, ...]:
        """The edges that the ego vehicle drives over."""
        raise NotImplementedError

    def _roomiest(self, lanes: list[LaneIndex], begin: float) -> tuple[LaneIndex, float, float]:
        """The lane with most room about its beginning, how much, m, and its leader's speed."""
        best: tuple[LaneIndex, float, float] | None = None
        for lane in lanes:
            distances, rows = self.road.on_lane(lane)
            room, speed = math.inf, math.inf
            for s, row in zip(distances, rows, strict=True):
                vehicle = self.road.vehicles[row]
                if abs(s - begin) < room:
                    room, speed = abs(s - begin) - vehicle.LENGTH / 2 - 2.5, vehicle.speed
            if best is None or room > best[1]:
                best = (lane, room, speed)
        assert best is not None
        return best

    def _advance(self, dt: float) -> None:
        """Move everybody for one simulation step."""
        road = self.road
        self._demand.enter()
        road.act()
        road.step(dt)
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
        """
        config = self.config
        dt = 1.0 / config["simulation_frequency"]
        frames = config["simulation_frequency"] // config["policy_frequency"]
        self._events, self._near_misses = [], 0
        before = self._distance_left
        for frame in range(frames):
            if frame == 0:
                self.action_type.act(action)
            self._advance(dt)
            self.steps += 1
            self.road.look()
            self._count_near_misses()
            if frame < frames - 1:
                self._automatic_rendering()
        self.enable_auto_render = False
        self.time += frames * dt
        if self._on_way():
            self._distance_left = self._way_left()
        mine = [e for e in self._events if self._ego_id in (e.agent, e.other)]
        self._collisions = sum(e.kind is EventKind.COLLISION for e in mine)
        self._red_runs = sum(e.kind is EventKind.RED_RUN and e.agent == self._ego_id for e in mine)
        limit = float(self.vehicle.lane.speed_limit)
        self._progress = float(
            np.clip((before - self._distance_left) / (limit * frames * dt), 0.0, 1.0)
        )
        if self.render_mode == "human":
            self.render()
        parts = self._rewards(action)
        reward = sum(REWARDS[name] * value for name, value in parts.items())
        return (
            self._observe(),
            float(reward),
            self._is_terminated(),
            self._is_truncated(),
            self._info(action, parts),
        )

    def _rewards(self, action: int | NDArray[Any]) -> dict[str, float]:
        return {
            "progress": self._progress,
            "collision": float(self._collisions),
            "near_miss": float(self._near_misses),
            "red_run": float(self._red_runs),
            "off_road": float(self._off_road()),
        }

    def _is_terminated(self) -> bool:
        return bool(self.vehicle.crashed or self._off_road() or self._arrived())

    def _is_truncated(self) -> bool:
        return bool(self.time >= self.config["duration_s"] - 1e-9)

    def _arrived(self) -> bool:
        last = self.vehicle.lane_index[:2] == self.vehicle.stretches[-1]
        return bool(last and self._distance_left <= 0.0)

    def _off_road(self) -> bool:
        s, lateral = self.vehicle.lane.local_coordinates(self.vehicle.position)
        beside = abs(lateral) > self.vehicle.lane.width_at(s) / 2 + 1.0
        return bool(beside or self._beyond_the_ends(s))

    def _beyond_the_ends(self, s: float) -> bool:
        """Whether the whole ego vehicle is before or past a lane where the road begins or ends."""
        ego, network = self.vehicle, self.road.network_info
        lane = ego.lane_index
        if network.info[lane].connector or (lane[:2] == ego.stretches[-1] and s > 0.0):
            return False
        own = (lane[0].removeprefix("~"), lane[1].removeprefix("~"))  # goes where its ghost goes
        if s < -ego.LENGTH / 2:
            return all(entered[:2] != own for entered in network.exit_of.values())
        if s > ego.lane.length + ego.LENGTH / 2:
            return all(left[:2] != own for left, _ in network.onward)
        return False

    def _info(
        self, action: int | NDArray[Any] | None, rewards: Mapping[str, float] | None = None
    ) -> dict[str, Any]:
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

    def _on_way(self) -> bool:
        """Whether the ego vehicle is on a stretch of its way or on a junction path between them.

        Paths from one lane begin on each other, so any counts while the right one is there too.
        """
        ego, network = self.vehicle, self.road.network_info
        if ego.lane_index[:2] in ego.stretches:
            return True
        turns = set(itertools.pairwise(ego.stretches))
        for (begin, then), path in network.onward.items():
            if (begin[:2], then) in turns:
                lane = network.lanes[path]
                if path == ego.lane_index or lane.on_lane(ego.position, margin=STRETCH_MARGIN_M):
                    return True
        return False

    def _way_left(self) -> float:
        """Distance along the lanes to the end of the ego vehicle's way, m."""
        network, ego = self.road.network_info, self.vehicle
        lane = ego.lane_index
        s, _ = ego.lane.local_coordinates(ego.position)
        left, visited = ego.lane.length - s - ego.LENGTH / 2, 0
        while visited < 20:
            then = self.road.onward_lane(ego, lane)
            if then is None:
                if self.road.next_stretch(ego, lane[:2]) is not None:
                    at = ego.stretches.index(lane[:2])  # on a lane that leads elsewhere
                    left += sum(network.lanes[(*r, 0)].length for r in ego.stretches[at + 1 :])
                return float(left)
            left += network.lanes[then].length
            lane, visited = then, visited + 1
        return float(left)

    def _count_near_misses(self) -> None:
        """Count others that come dangerously near, once each time they do."""
        ego, road = self.vehicle, self.road
        near = set()
        lead = road.around(ego, ego.lane_index)
        closing = ego.speed - lead.front_speed
        if lead.front is not None and closing > 0.0 and lead.front_gap < NEAR_MISS_S * closing:
            near.add(agent_of(lead.front))
        others = [o for o in (*road.vehicles, *road.walkers) if o is not ego]
        others = [
            o for o in others
            if float(np.hypot(*(o.position - ego.position))) < 12.0
            and abs(ego.speed - o.speed) + abs(ego.speed) > WALKING_PACE_MPS
        ]  # fmt: skip
        if others and ego.speed > WALKING_PACE_MPS:
            forward = np.array([[math.cos(o.heading), math.sin(o.heading)] for o in others])
            half = np.array([(o.LENGTH / 2, o.WIDTH / 2) for o in others])
            own = np.repeat(ego.direction[None], len(others), axis=0)
            own_half = np.repeat([[ego.LENGTH / 2, ego.WIDTH / 2]], len(others), axis=0)
            between = np.array([ego.position - o.position for o in others])
            apart = separation(between, own, own_half, forward, half)
            near |= {
                agent_of(o) for o, gap in zip(others, apart.tolist(), strict=True)
                if gap < NEAR_MISS_M
            }  # fmt: skip
        self._near_misses += len(near - self._near)
        self._near = near

    # Observation -----------------------------------------------------------------------------

    def _observe(self) -> Observation:
        self.road.look()
        observed = int(self.config["observed"])
        others = self._visible()[:observed]
        width = _agent_columns(self.config["observation"])
        agents = np.zeros((observed, width))
        if others:
            agents[: len(others), : len(AGENT_FEATURES)] = self._kinematics(others)
            extra = self._behaviors(others)
            if extra is not None:
                agents[: len(others), len(AGENT_FEATURES) :] = extra
        found: Observation = {
            "ego": _unit(self._ego_features()),
            "agents": _unit(agents),
        }
        if self.config["observation"] == "graph":
            found["mask"] = np.zeros(observed + 1, dtype=np.int8)
            found["mask"][: len(others) + 1] = 1
            found["adjacency"] = self._adjacency(others, observed)
        return found

    def _visible(self) -> list[Any]:
        """The others in sight, nearest first."""
        ego = self.vehicle
        others = [o for o in (*self.road.vehicles, *self.road.walkers) if o is not ego]
        if not others:
            return []
        away = np.hypot(*(np.array([o.position for o in others]) - ego.position).T)
        order = np.lexsort((np.array([agent_of(o) for o in others]), away))
        return [others[i] for i in order if away[i] <= RANGE_M]

    def _kinematics(self, others: list[Any]) -> FloatArray:
        ego = self.vehicle
        cos, sin = math.cos(ego.heading), math.sin(ego.heading)
        turn = np.array([[cos, sin], [sin, -cos]])  # forward, left; y is to the right here
        place = np.array([o.position - ego.position for o in others]) @ turn.T
        moving = np.array([o.velocity - ego.velocity for o in others]) @ turn.T
        heading = ego.heading - np.array([o.heading for o in others])
        return np.column_stack(
            [
                np.ones(len(others)),
                place / RANGE_M,
                moving / SPEED_MPS,
                np.cos(heading),
                np.sin(heading),
                np.array([o.LENGTH for o in others]) / LENGTH_M,
                np.array([o.WIDTH for o in others]) / WIDTH_M,
                np.array([isinstance(o, Walker) for o in others]),
            ]
        )

    def _behaviors(self, others: list[Any]) -> FloatArray | None:
        option = self.config["observation"]
        driving = np.array([isinstance(o, ProfileVehicle) for o in others])
        if option == "behavior":
            found = np.zeros((len(others), len(BEHAVIORS)))
            for row, other in enumerate(others):
                behavior = self._true[agent_of(other)].behavior
                if behavior is not None:
                    found[row, behavior.code] = 1.0
            return found
        if option == "posterior":
            ids = np.array([agent_of(o) for o in others], dtype=np.int64)
            if self._belief is None:
                found = np.full((len(others), len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
            else:
                found = np.array(self._belief.of(ids), dtype=np.float64)
            found[~driving] = 0.0
            return found
        return None

    def _adjacency(self, others: list[Any], observed: int) -> NDArray[np.int8]:
        """Who is among whose nearest, either way; row 0 is the ego vehicle."""
        found = np.zeros((observed + 1, observed + 1), dtype=np.int8)
        xy = np.array([self.vehicle.position, *(o.position for o in others)])
        away = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
        np.fill_diagonal(away, np.inf)
        for i in range(len(xy)):
            for j in np.argsort(away[i], kind="stable")[: min(NEIGHBOURS, len(xy) - 1)]:
                found[i, j] = found[j, i] = 1
        return found

    def _ego_features(self) -> FloatArray:
        ego, road = self.vehicle, self.road
        network, lane = road.network_info, ego.lane_index
        info = network.info[lane]
        s, lateral = ego.lane.local_coordinates(ego.position)
        front = s + ego.LENGTH / 2
        facing = ego.lane.heading_at(s) - ego.heading
        facing = math.pi - (math.pi - facing) % (2.0 * math.pi)
        many = len(road.network.graph[lane[0]][lane[1]])
        lit = np.zeros(3)
        line = crossing = RANGE_M
        used = 0.0
        path = None if info.connector else road.onward_lane(ego, lane)
        ahead = [(strip, strip.near_s - front) for strip in info.strips]
        if path is not None:
            line = ego.lane.length - front
            group = network.info[path].signal
            if group >= 0 and 0.0 <= line <= RANGE_M:
                state = int(road.signals[group])
                if state != Signal.OFF.code:
                    lit[state] = 1.0
            ahead += [(strip, strip.near_s + line) for strip in network.info[path].strips]
        for strip, near in ahead:
            if 0.0 <= near < crossing:
                crossing = near
                used = float(
                    any(
                        w.crossover is not None
                        and w.crossover.crossing == strip.crossing
                        and w.to_walk() < 1.0
                        for w in road.walkers
                    )
                )
        sides = (lane[2], many - 1 - lane[2]) if not info.connector else (0, 0)
        return np.array(
            [
                ego.speed / SPEED_MPS,
                -lateral / float(ego.lane.width_at(s)),
                facing / math.pi,
                float(ego.lane.speed_limit) / SPEED_MPS,
                sides[0] / 4.0,
                sides[1] / 4.0,
                min(max(line, 0.0), RANGE_M) / RANGE_M,
                *lit,
                crossing / RANGE_M,
                used,
                self._distance_left / WAY_M,
            ]
        )

    # Pictures --------------------------------------------------------------------------------

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the scene; an image array in the mode ``rgb_array``."""
        if self.render_mode is not None and self.viewer is None:
            self.viewer = TrafficViewer(self, self.road.network_info)
        return cast("NDArray[np.uint8] | None", super().render())


def _unit(values: FloatArray) -> NDArray[np.float32]:
    return np.clip(values, -1.0, 1.0).astype(np.float32)


def _agent_columns(observation: str) -> int:
    more = len(BEHAVIORS) if observation in ("behavior", "posterior") else 0
    return len(AGENT_FEATURES) + more


def _observation_space(config: Mapping[str, Any]) -> spaces.Dict:
    observed = int(config["observed"])
    columns = _agent_columns(config["observation"])
    parts: dict[str, spaces.Space[Any]] = {
        "ego": spaces.Box(-1.0, 1.0, (len(EGO_FEATURES),), np.float32),
        "agents": spaces.Box(-1.0, 1.0, (observed, columns), np.float32),
    }
    if config["observation"] == "graph":
        parts["mask"] = spaces.Box(0, 1, (observed + 1,), np.int8)
        parts["adjacency"] = spaces.Box(0, 1, (observed + 1, observed + 1), np.int8)
    return spaces.Dict(parts)


def _highway_route(
    network: HighwayNetwork, lane: LaneIndex, stretches: tuple[tuple[str, str], ...]
) -> list[tuple[str, str, int | None]]:
    """A way over stretches as highway-env's vehicles want it."""
    route: list[tuple[str, str, int | None]] = [lane]
    for before, after in itertools.pairwise(stretches):
        route += [(before[1], after[0], None), (*after, None)]
    return route


def _mapping(name: str, value: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """What was given by key; nothing for None."""
    if value is not None and not isinstance(value, Mapping):
        raise InputError(f"{name}: found {value!r}, expected a mapping or None")
    return value or {}


def _classifier_maker(source: str) -> Callable[[], Any]:
    """What ``module:function`` names."""
    module, function = source.split(":")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputError(
            f"classifier: found {source!r}, expected 'module:function' that exists ({error})"
        ) from error
    if not callable(found):
        raise InputError(f"classifier: found {source!r}, expected it to name a function")
    return cast(Callable[[], Any], found)


def _check_config(config: Mapping[str, Any]) -> None:
    """Refuse values that mean nothing, by name.

    Raises:
        InputError: with one line.
    """
    lookup(OBSERVATIONS, str(config["observation"]), "observation")
    for key, low in (("observed", 1), ("simulation_frequency", 10), ("policy_frequency", 1)):
        value = config[key]
        if isinstance(value, bool) or not isinstance(value, int) or value < low:
            raise InputError(f"{key}: found {value!r}, expected an integer >= {low}")
    if config["simulation_frequency"] % config["policy_frequency"]:
        raise InputError(
            f"policy_frequency: found {config['policy_frequency']}, expected a divisor of "
            f"simulation_frequency {config['simulation_frequency']}"
        )
    for key, least in (("duration_s", 1.0), ("warmup_s", 0.0)):
        value = config[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or value < least:
            raise InputError(f"{key}: found {value!r}, expected a number >= {least:g}")
    seed = config["seed"]
    whole = isinstance(seed, int) and not isinstance(seed, bool) and 0 <= seed < 2**31
    if seed is not None and not whole:
        raise InputError(f"seed: found {seed!r}, expected None or an integer from 0 to 2**31 - 1")
    classifier = config["classifier"]
    named = isinstance(classifier, str) and classifier.count(":") == 1
    if not named and not callable(classifier):
        raise InputError(
            f"classifier: found {classifier!r}, expected 'module:function' or a callable"
        )
    if named and config["observation"] == "posterior":
        _classifier_maker(classifier)
    compiled = config.get("compiled", False)
    if not isinstance(compiled, bool):
        raise InputError(f"compiled: found {compiled!r}, expected True or False")
    _check_action(config["action"])


def _check_action(action: Mapping[str, Any]) -> None:
    """Refuse an action type, options or values of them that make no action, by name.

    Raises:
        InputError: with one line.
    """
    if not isinstance(action, Mapping) or "type" not in action:
        raise InputError(f"action: found {action!r}, expected a mapping with 'type'")
    kind = lookup(ACTIONS, str(action["type"]), "action type")
    known = dict.fromkeys(
        [p for p in inspect.signature(kind.__init__).parameters if p not in ("self", "env")]
    )
    known.pop("kwargs", None)
    for key in action:
        if key != "type":
            lookup(known, str(key), f"option of action {action['type']},")
    try:
        kind(None, **action).space()
        for key in ("acceleration_range", "steering_range", "speed_range"):
            if action.get(key) is not None:
                bounds = np.array(action[key], dtype=np.float64)
                if bounds.shape != (2,) or not np.isfinite(bounds).all():
                    raise ValueError(f"{key} is not a pair of numbers")
        if action.get("target_speeds") is not None:  # highway-env takes them to ascend evenly
            speeds = np.array(action["target_speeds"], dtype=np.float64)
            ascend = speeds.ndim == 1 and speeds.size > 1 and bool((np.diff(speeds) > 0.0).all())
            if not ascend or not np.isfinite(speeds).all():
                raise ValueError("target_speeds are not two or more ascending speeds")
    except (ArithmeticError, AssertionError, TypeError, ValueError) as error:
        raise InputError(
            f"action: found {dict(action)!r}, expected options that {action['type']} can take"
            f" ({error})"
        ) from error
