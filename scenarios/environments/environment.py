"""Traffic with ego vehicles: episodes, rewards and observations of every environment.

`TrafficEnv` is the environment for one ego vehicle; what it is made of holds for any number of
them (`scenarios.environments.parallel`). The road and the route of an environment are a row of
`scenarios.environments.ENVIRONMENTS`.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from scenarios import get_scenario
from scenarios.environments import observation as observing
from scenarios.environments.config import TrafficConfig, read_config
from sim.episode.live import FrameBuffer
from sim.frames import Event, EventKind, FloatArray, Frame
from sim.highway import ego as ego_vehicles
from sim.highway.ego import EgoEnv, Observation, as_mapping
from sim.highway.lanes import LaneIndex
from sim.highway.run import Demand, network_of
from sim.highway.traffic import ProfileVehicle, TrafficRoad
from sim.safety import conflicts
from sim.scenario import AgentSpec, Scenario, sample_agents

SEEN_S: Final = 2.0
"""Conflicts are looked for in the last seconds (more than what makes a near miss)."""

LOOK_EVERY_S: Final = 0.5
"""Time between two searches for conflicts, s: a near miss is reported that late at most."""

AGAIN_S: Final = 5.0
"""Near misses of a pair with less time between them are one, s (as encounters are)."""

NEARBY_M: Final = 40.0
"""Only others whose centre is this near are looked at, m (2 s at 20 m/s)."""

REWARDS: Final[dict[str, float]] = {
    "progress": 1.0,
    "collision": -10.0,
    "near_miss": -1.0,
    "red_run": -3.0,
    "off_road": -5.0,
}
"""The weight of each part of the reward; a collision outweighs ten seconds at the limit."""

BEGIN_M: Final = 3.0
"""Where on its first lane the ego vehicle begins, m."""

ENTRY_ROOM_M: Final = 12.0
"""Room in front and behind that the ego vehicle needs to be set on the road, m (room to brake from
walking pace)."""

LONGEST_ENTRY_WAIT_S: Final = 60.0
"""The traffic waits this long for room for an ego vehicle, s; then those in its place are removed.
"""

Stretches = tuple[tuple[str, str], ...]
Outcome = tuple[Observation, float, bool, bool, dict[str, Any]]


@dataclass
class Ego:
    """One ego vehicle of an episode.

    Attributes:
        id: its agent id.
        route: the stretches that it drives over.
        vehicle: highway-env's vehicle, once it is on the road.
        entered_s: when it entered, s.
        distance_left_m: along the lanes to the end of its route, m.
        near: when others last were in a near miss with it, s, by their ids.
        rewards: the parts of the last step's reward, as in `REWARDS`.
    """

    id: int
    route: Stretches
    vehicle: Any = None
    entered_s: float = 0.0
    distance_left_m: float = 0.0
    near: dict[int, float] = field(default_factory=dict)
    rewards: dict[str, float] = field(default_factory=lambda: dict.fromkeys(REWARDS, 0.0))

    @property
    def has_arrived(self) -> bool:
        """Whether it is at the end of its route."""
        last = self.vehicle.lane_index[:2] == self.vehicle.stretches[-1]
        return bool(last and self.distance_left_m <= 0.0)


class TrafficEnv(EgoEnv):
    """Drive among the six behaviours; the specification of every environment.

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

    Actions: highway-env's. By default the meta actions, in this order: lane to the left, nothing,
        lane to the right, faster, slower. Target speeds are the multiples of 3 m/s up to 15.
        Nothing stops the ego vehicle at signals, crossings or behind others; the others react to
        it as to any vehicle.

    Reward per step: the progress along the route as a share of what the limit allows, in [0, 1].
    Costs are 10 for a collision and 5 for leaving the road. Running a red light costs 3, and each
    near miss within half a second costs 1 (`sim.safety.is_near_miss`). ``info["rewards"]`` has the
    parts.

    Episode: begins at the start of the route, on the lane with most room for the ego vehicle, at
    0.7 of the limit. Terminated by a collision, by leaving the road, or at the end of its route;
    truncated after ``duration_s``.

    ``info``: time_s, speed (m/s), crashed, arrived, collisions, near_misses, red_runs, rewards,
    and events. An event is a tuple (what, agent, other or -1, rule). Ids are those of the drawn
    agents; the ego vehicle's is one more than the greatest.

    Images: lanes, crossings, stop lines in the colour of their signal, pedestrians, vehicles in the
    colour of their behaviour (warm: aggressive, cool: conservative), the ego vehicle white. For a
    video at the simulation's rate wrap in ``RecordVideo`` and call
    ``env.unwrapped.set_record_video_wrapper(env)``.

    Args:
        config: changes to the configuration by key; `TrafficConfig` explains the keys.
        render_mode: None, ``"rgb_array"`` or ``"human"``.
        scenario_name: a registered scenario, a scenario's file or a map.
        routes: edges of the ego vehicle's route, or these by ``goal``; None to draw a route of the
            traffic for each episode.
        defaults: keys of the configuration that have other defaults than in `TrafficConfig`.

    Attributes:
        egos: the ego vehicles on the road.
        coming: those that are still to come.
        agents: everybody else's `AgentSpec`, by id.
        events: what happened in the last step.
    """

    def __init__(
        self,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        *,
        scenario_name: str,
        routes: Sequence[str] | Mapping[str, Sequence[str]] | None = None,
        defaults: Mapping[str, Any] | None = None,
    ) -> None:
        self._scenario_name, self._routes = scenario_name, routes
        self._defaults = dict(defaults or {})
        self.egos: list[Ego] = []
        self.coming: list[Ego] = []
        self.events: list[Event] = []
        super().__init__(config, render_mode)

    def default_config(self) -> dict[str, Any]:
        """The value of every key that is not given."""
        return {**dict(TrafficConfig()), **self._defaults}

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Take changes to the configuration.

        Raises:
            InputError: if a key is unknown or a value is not usable; the message names it.
        """
        given = as_mapping("config", config)
        checked = read_config({**self.config, **given})
        if checked.goal is not None and not isinstance(self._routes, Mapping):
            raise InputError(f"goal: found {checked.goal!r}, expected None: this road has no goals")
        self.scenario = self._scenario_of(checked)
        if checked.ego_route is not None:
            network_of(self.scenario.road).stretches(checked.ego_route)
        super().configure({key: getattr(checked, str(key)) for key in given})

    def _scenario_of(self, checked: TrafficConfig) -> Scenario:
        """The scenario of a configuration; another one's own options hold unless they are given."""
        reference, usual = checked.net or checked.scenario or self._scenario_name, TrafficConfig()
        options = ("flow", "mix", "spread", "population", "behaviors")
        given = {name: getattr(checked, name) for name in options}
        if reference != self._scenario_name:
            given = {name: one for name, one in given.items() if one != getattr(usual, name)}
        if checked.routes is not None:
            given["routes"] = checked.routes
        duration_s = checked.duration_s + checked.warmup_s + LONGEST_ENTRY_WAIT_S
        return get_scenario(reference)(**given, duration_s=duration_s)

    def define_spaces(self) -> None:
        """Make the configured spaces; on roads with left-hand traffic, sides are exchanged."""
        super().define_spaces()
        if self.scenario.road.left_hand:
            ego_vehicles.exchange_sides(self.action_type)

    def _reset(self) -> None:
        config = self.config
        seed = config["seed"]
        if seed is None:
            seed = int(self.np_random.integers(2**31))
        drawn = self.draw_agents(seed)
        self.agents = {agent.id: agent for agent in drawn}
        self._belief: Any = None
        self._classify = self._classifier()
        self.dt = 1.0 / config["simulation_frequency"]
        self._seen, self._looked_s = FrameBuffer(round(SEEN_S / self.dt) + 1), -np.inf
        self.controlled_vehicles = []
        self.define_spaces()
        edges = config["ego_route"]
        if edges is None and config["net"] is None and config["scenario"] is None:
            edges = self._routes
            if isinstance(edges, Mapping):
                edges = edges[config["goal"] or "straight"]
        first = Ego(max(self.agents, default=-1) + 1, self._route(edges))
        self.egos, self.coming, self._came_s = [], [first], -np.inf
        self.road = TrafficRoad(network_of(self.scenario.road))
        self.demand = Demand(self.road, drawn, seed)
        for _ in range(round(config["warmup_s"] / self.dt)):
            self.advance()
        self.let_in()
        self.time = self._came_s = first.entered_s = 0.0
        self.steps, self.events = 0, []

    def draw_agents(self, seed: int) -> tuple[AgentSpec, ...]:
        """All agents but the ego vehicles, in an episode whose traffic has this seed."""
        return sample_agents(self.scenario, seed)

    def _classifier(self) -> Callable[[Frame], Any] | None:
        """Classifier of the drivers of this episode; None if nothing is classified."""
        made = self.config["classifier"]
        if self.config["observation"] != "posterior":
            return None
        try:
            inspect.signature(made).bind()
        except TypeError:  # it takes a frame
            pass
        else:
            made = made()
        classify: Callable[[Frame], Any] = getattr(made, "update", made)
        return classify

    def _route(self, edges: Sequence[str] | None) -> Stretches:
        """The stretches over some edges, or of one of the traffic's routes, drawn by their flow."""
        if edges is None:
            flows = [flow for flow in self.scenario.flows if not flow.walking]
            rates = np.array([flow.per_hour for flow in flows])
            weights = rates / rates.sum() if rates.sum() > 0 else None
            edges = flows[int(self.np_random.choice(len(flows), p=weights))].route
        return tuple(network_of(self.scenario.road).stretches(tuple(edges)))

    def invite(self, count: int) -> None:
        """Let more ego vehicles come, each over ``ego_route`` or a route of the traffic's."""
        begin, edges = self.egos[0].id + 1, self.config["ego_route"]
        self.coming += [Ego(begin + number, self._route(edges)) for number in range(count)]

    def let_in(self, every_s: float = 0.0) -> None:
        """Let the next ego vehicles in that have room, this long after the last one, s.

        While none is on the road, the traffic drives on until one has room, but at most for
        `LONGEST_ENTRY_WAIT_S` after one may come.
        """
        until_s = max(self.time, self._came_s + every_s) + LONGEST_ENTRY_WAIT_S - 1e-9
        while True:
            for ego in list(self.coming):
                if self.time - self._came_s < every_s - 1e-9:
                    break
                lane, room, speed = self._roomiest(ego)
                if room > ENTRY_ROOM_M or (not self.egos and self.time > until_s):
                    self._enter(ego, lane, room, speed)
            if self.egos or not self.coming:
                return
            self.advance()
            self.steps += 1
            self.time += self.dt

    def _roomiest(self, ego: Ego) -> tuple[LaneIndex, float, float]:
        """Lane to begin on with most room, its room, m, and the next vehicle's speed."""
        self.road.locate()
        found: list[tuple[LaneIndex, float, float]] = []
        then = ego.route[1] if len(ego.route) > 1 else None
        for lane in self.road.network.lanes_towards(ego.route[0], then):
            room, speed = math.inf, math.inf
            for s, length, there in self.road.on_lane(lane):
                if abs(s - BEGIN_M) < room:
                    room, speed = abs(s - BEGIN_M) - length / 2 - 2.5, there
            found.append((lane, room, speed))
        return max(found, key=lambda one: one[1])

    def _enter(self, ego: Ego, lane: LaneIndex, room: float, speed: float) -> None:
        """Put an ego vehicle on a lane, as fast as the vehicle ahead allows."""
        geometry = self.road.network.lanes[lane]
        if room <= ENTRY_ROOM_M:
            for vehicle in list(self.road.vehicles):
                s, _ = geometry.local_coordinates(vehicle.position)
                if abs(s - BEGIN_M) < 2.0 * ENTRY_ROOM_M and vehicle.lane_index[:2] == lane[:2]:
                    self.road.remove(vehicle)
        begin = 0.7 * float(geometry.speed_limit)
        begin = min(begin, speed) if room < 40.0 else begin
        self.add_ego_vehicle(lane, BEGIN_M, begin, ego.route, ego.id)
        ego.vehicle = self.vehicle
        ego.entered_s = self._came_s = self.time
        self.road.locate()
        ego.distance_left_m = ego_vehicles.distance_left_m(self.road, ego.vehicle)
        self.coming.remove(ego)
        self.egos.append(ego)

    def remove(self, ego: Ego) -> None:
        """Take an ego vehicle off the road."""
        self.egos.remove(ego)
        self.road.remove(ego.vehicle)

    def advance(self) -> None:
        """Move all agents for one simulation step."""
        self.demand.enter()
        self.road.advance(self.dt)
        events = self.road.take_events()
        self.events += events
        if self._classify is not None:
            self._belief = self._classify(self.road.frame(events))

    def step(self, action: int | NDArray[Any]) -> Outcome:
        """Drive on for one policy step.

        Args:
            action: of the action space.

        Returns:
            Observation, reward, whether the episode has ended, whether its time is up, and info.

        Raises:
            InputError: if the action is not in the action space, or no episode has begun; the
                environment stays unchanged.
        """
        if not self._begun:
            raise InputError("step: found no episode, expected reset before the first step")
        ego = self.egos[0]
        self.drive({} if self.config["manual_control"] else {ego.id: self.checked(action)})
        if self.render_mode == "human":
            self.render()
        return self.outcome(ego)

    def checked(self, action: object) -> Any:
        """An action as the action space has it: a whole number, or an array of its shape."""
        space, numbers = self.action_space, np.asarray(action)
        if isinstance(space, spaces.Discrete):
            if numbers.size == 1 and np.isin(numbers, np.arange(space.n)).all():
                return int(numbers.item())
            raise InputError(f"action: found {action!r:.60}, expected 0 to {space.n - 1}")
        usable = numbers.dtype.kind in "biuf" and numbers.size == np.prod(space.shape or ())
        if usable and np.isfinite(numbers).all():
            return numbers.reshape(space.shape)
        expected = f"finite numbers of shape {space.shape}"
        raise InputError(f"action: found {action!r:.60}, expected {expected}")

    def drive(self, actions: Mapping[int, Any]) -> None:
        """Drive on for one policy step, with actions by the ego vehicles' ids.

        An ego vehicle without an action does what it did before.
        """
        frames = self.config["simulation_frequency"] // self.config["policy_frequency"]
        self.events = []
        before_m = [ego.distance_left_m for ego in self.egos]
        for ego in self.egos:
            if ego.id in actions:
                self.action_type.controlled_vehicle = ego.vehicle
                self.action_type.act(actions[ego.id])
        for frame in range(frames):
            self.advance()
            self.steps += 1
            self.watch()
            if frame < frames - 1:
                self._automatic_rendering()
        self.enable_auto_render = False
        self.time += frames * self.dt
        near_misses = self._near_misses()
        for ego, before in zip(self.egos, before_m, strict=True):
            met = near_misses.count(ego.id)
            ego.rewards = self._rewards(ego, before, frames * self.dt, met)

    def watch(self) -> None:
        """Remember the step that has just been simulated."""
        self.road.locate()
        self._seen.push(self.road.frame())

    def _near_misses(self) -> list[int]:
        """The ego vehicle of each near miss that the last steps show and that is a new one."""
        found: list[int] = []
        if len(self._seen) < 2 or self._seen.last.time_s - self._looked_s < LOOK_EVERY_S - 1e-6:
            return found
        tracks, time_s = self._seen.tracks(), self._seen.last.time_s
        self._looked_s = time_s
        of_egos = np.isin(tracks.ids, [ego.id for ego in self.egos])
        now = tracks.xy[:, -1]
        near, _ = cKDTree(now[of_egos]).query(now, distance_upper_bound=NEARBY_M)
        met = conflicts(tracks.part(np.flatnonzero(near <= NEARBY_M), slice(None)), None, SEEN_S)
        for first, second in zip(met.first[met.near_miss], met.second[met.near_miss], strict=True):
            for ego in self.egos:
                if ego.id in (first, second):
                    other = int(second if ego.id == first else first)
                    if time_s - ego.near.get(other, -np.inf) > AGAIN_S:
                        found.append(ego.id)
                    ego.near[other] = time_s
        return found

    def _rewards(self, ego: Ego, before_m: float, step_s: float, met: int) -> dict[str, float]:
        """The parts of the reward for a policy step that began this far from the goal, m.

        ``met`` is the number of its near misses.
        """
        if ego_vehicles.is_on_route(self.road, ego.vehicle):
            ego.distance_left_m = ego_vehicles.distance_left_m(self.road, ego.vehicle)
        mine = [(e.kind, e.agent) for e in self.events if ego.id in (e.agent, e.other)]
        reachable_m = float(ego.vehicle.lane.speed_limit) * step_s
        progress = np.clip((before_m - ego.distance_left_m) / reachable_m, 0.0, 1.0)
        return {
            "progress": float(progress),
            "collision": float(sum(kind is EventKind.COLLISION for kind, _ in mine)),
            "near_miss": float(met),
            "red_run": float(mine.count((EventKind.RED_RUN, ego.id))),
            "off_road": float(ego_vehicles.is_off_road(self.road, ego.vehicle)),
        }

    def outcome(self, ego: Ego) -> Outcome:
        """Outcome of the last step for an ego vehicle, as `step` returns it."""
        reward = sum(REWARDS[name] * value for name, value in ego.rewards.items())
        ended = ego.vehicle.crashed or ego.rewards["off_road"] > 0 or ego.has_arrived
        cut = self.time - ego.entered_s >= self.config["duration_s"] - 1e-9
        return self.observe(ego), float(reward), bool(ended), bool(cut), self.info(ego)

    def info(self, ego: Ego) -> dict[str, Any]:
        """The figures of an ego vehicle's last step."""
        return {
            "time_s": float(self.time - ego.entered_s),
            "speed": float(ego.vehicle.speed),
            "crashed": bool(ego.vehicle.crashed),
            "arrived": ego.has_arrived,
            "collisions": int(ego.rewards["collision"]),
            "near_misses": int(ego.rewards["near_miss"]),
            "red_runs": int(ego.rewards["red_run"]),
            "rewards": dict(ego.rewards),
            "events": tuple(
                (str(e.kind), e.agent, -1 if e.other is None else e.other, e.rule)
                for e in self.events
            ),
        }

    def _make_observation_space(self) -> spaces.Dict:
        return observing.observation_space(self.config["observation"], self.config["observed"])

    def _observe(self) -> Observation:
        return self.observe(self.egos[0])

    def _info(self) -> dict[str, Any]:
        return self.info(self.egos[0])

    def observe(self, ego: Ego) -> Observation:
        """Current observation of an ego vehicle."""
        self.road.locate()
        vehicle, observed = ego.vehicle, self.config["observed"]
        others = observing.observable_agents(self.road, vehicle)[:observed]
        found: Observation = {
            "ego": observing.observe_ego(self.road, vehicle, ego.distance_left_m),
            "agents": observing.observe_agents(vehicle, others, self._behaviors(others), observed),
        }
        if self.config["observation"] == "graph":
            found |= observing.observe_graph(vehicle, others, observed)
        if self.scenario.road.left_hand:
            observing.exchange_sides(found)
        return found

    def _behaviors(self, others: list[Any]) -> FloatArray | None:
        """(n, 6) what is observed of behaviours: the truth, the belief, or None for nothing."""
        option = self.config["observation"]
        if option not in ("behavior", "posterior"):
            return None
        found = np.zeros((len(others), len(BEHAVIORS)))
        driving = [row for row, one in enumerate(others) if isinstance(one, ProfileVehicle)]
        if option == "behavior":
            for row in driving:
                behavior = self.agents[others[row].agent].behavior
                if behavior is not None:
                    found[row, behavior.base.code] = 1.0
        elif self._belief is None:
            found[driving] = 1.0 / len(BEHAVIORS)
        elif others:
            ids = np.array([one.agent for one in others], dtype=np.int64)
            found[driving] = np.asarray(self._belief.of(ids), dtype=np.float64)[driving]
        return found
