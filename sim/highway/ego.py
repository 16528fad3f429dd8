"""What an environment with an ego vehicle takes from highway-env: its base class and its actions.

The gymnasium environments of `scenarios.environments` are built on `EgoEnv`, so that they work with
highway-env's windows, videos and action types without importing highway-env themselves.
"""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Mapping
from typing import Any, ClassVar, Final, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from highway_env.envs.common import action as actions
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behaviors.errors import InputError, lookup
from sim.highway.lanes import LaneIndex, Stretch
from sim.highway.state import STRETCH_MARGIN_M
from sim.highway.traffic import TrafficRoad
from sim.highway.viewer import TrafficViewer

Observation = dict[str, NDArray[Any]]


class StockDriver(actions.ActionType):  # type: ignore[misc]
    """highway-env's own driver, IDM with MOBIL, drives the ego vehicle; the action does nothing."""

    vehicle_class = IDMVehicle

    def space(self) -> spaces.Space[Any]:
        """One action."""
        return spaces.Discrete(1)

    def act(self, action: Any) -> None:
        """Do nothing: the vehicle decides."""


def exchange_sides(action: actions.ActionType) -> None:
    """Let actions steer to their other side, as vehicles in a mirror do."""
    if isinstance(action, actions.DiscreteMetaAction):
        other = {"LANE_LEFT": "LANE_RIGHT", "LANE_RIGHT": "LANE_LEFT"}
        action.actions = {key: other.get(name, name) for key, name in action.actions.items()}
        action.actions_indexes = {name: key for key, name in action.actions.items()}
    elif isinstance(action, actions.ContinuousAction):
        low, high = action.steering_range
        action.steering_range = (-low, -high)


ACTIONS: Final[dict[str, type[actions.ActionType]]] = {
    "DiscreteMetaAction": actions.DiscreteMetaAction,
    "DiscreteAction": actions.DiscreteAction,
    "ContinuousAction": actions.ContinuousAction,
    "StockDriver": StockDriver,
}
"""highway-env's actions for one vehicle, and its own driver."""


class EgoEnv(AbstractEnv):  # type: ignore[misc]
    """highway-env's environment with our road, our viewer and an observation space of its own.

    A subclass implements `default_config`, `configure`, `step`, `_reset`, `_observe`, `_info` and
    `_make_observation_space`. Unlike highway-env, making the environment simulates nothing; every
    call of `reset` does.

    Args:
        config: changes to `default_config`, by key.
        render_mode: None, ``"rgb_array"`` or ``"human"``.

    Raises:
        InputError: if the render mode is unknown, or `configure` refuses the configuration.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "render_fps": 5}

    road: TrafficRoad
    config: dict[str, Any]
    controlled_vehicles: list[Any]
    viewer: Any
    action_space: spaces.Space[Any]
    observation_space: spaces.Space[Any]

    def __init__(
        self, config: Mapping[str, Any] | None = None, render_mode: str | None = None
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise InputError(
                f"render_mode: found {render_mode!r}, expected one of "
                f"{', '.join(self.metadata['render_modes'])}"
            )
        self.metadata = dict(type(self).metadata)  # type: ignore[misc]
        self._made = self._begun = False
        super().__init__(config, render_mode)  # calls `configure`, `define_spaces` and `reset`
        self._made = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; returns the first observation, and info.

        Args:
            seed: seed of everything random from now on; the same seed gives the same episode.
            options: ``{"config": {...}}`` changes the configuration.
        """
        if not self._made:
            return {}, {}
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            raise InputError(f"seed: found {seed!r:.60}, expected a whole number of at least 0")
        gymnasium.Env.reset(self, seed=None if seed is None else int(seed))
        given = as_mapping("options", options)
        for key in given:
            lookup({"config": None}, str(key), "reset option")
        if given:
            self.configure(given["config"])
        self.update_metadata()
        self.time, self.steps, self.done = 0.0, 0, False
        self._reset()
        self._begun = True
        self.define_spaces()
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info()

    def define_spaces(self) -> None:
        """Make the configured spaces; those that did not change are kept, with their seeds."""
        options = self.config["action"]
        self.action_type = ACTIONS[options["type"]](self, **options)
        made = self.action_type.space(), self._make_observation_space()
        for name, space in zip(("action_space", "observation_space"), made, strict=True):
            if space != getattr(self, name):
                setattr(self, name, space)

    def update_metadata(self, video_real_time_ratio: float = 1.0) -> None:
        """Note how many images are drawn per second, so that videos run in real time."""
        recorded = "simulation_frequency" if self._record_video_wrapper else "policy_frequency"
        self.metadata["render_fps"] = round(video_real_time_ratio * self.config[recorded])

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the scene; returns an image in the mode ``rgb_array``."""
        if self.render_mode is not None and self.viewer is None:
            self.viewer = TrafficViewer(self, self.road.network)
        return cast("NDArray[np.uint8] | None", super().render())

    def add_ego_vehicle(
        self, lane: LaneIndex, at_m: float, speed: float, route: tuple[Stretch, ...], id: int
    ) -> None:
        """Put an ego vehicle on a lane, at a distance along it, m, and a speed, m/s.

        It is of the class that the actions steer; ``route`` has its stretches, the lane's first.
        """
        geometry = self.road.network.lanes[lane]
        ego = self.action_type.vehicle_class(
            self.road, geometry.position(at_m, 0.0), geometry.heading_at(at_m), speed
        )
        ego.route = [lane]
        for before, after in itertools.pairwise(route):
            ego.route += [(before[1], after[0], None), (*after, None)]
        self.road.add_ego(ego, id, route)
        self.vehicle = ego


def as_mapping(name: str, value: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """A mapping that a user gave, empty for None; an `InputError` if it is something else."""
    if value is not None and not isinstance(value, Mapping):
        raise InputError(f"{name}: found {value!r}, expected a mapping or None")
    return value or {}


def check_action(action: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the configuration of an action; an `InputError` if highway-env can make none of it."""
    if not isinstance(action, Mapping) or "type" not in action:
        raise InputError(f"action: found {action!r}, expected a mapping with 'type'")
    kind = lookup(ACTIONS, str(action["type"]), "action type")
    options = dict(inspect.signature(kind.__init__).parameters)
    for name in ("self", "env", "kwargs"):
        options.pop(name)
    for key in action:
        if key != "type":
            lookup(options, str(key), f"option of action {action['type']},")
    try:
        kind(None, **action).space()
        for key in ("acceleration_range", "steering_range", "speed_range", "target_speeds"):
            if action.get(key) is not None:
                numbers, speeds = np.array(action[key], dtype=np.float64), key == "target_speeds"
                fits = numbers.ndim == 1 and (numbers.size > 1 if speeds else numbers.size == 2)
                ascends = not speeds or bool((np.diff(numbers) > 0.0).all())
                if not (fits and ascends and np.isfinite(numbers).all()):
                    wanted = "two or more ascending numbers" if speeds else "a pair of numbers"
                    raise ValueError(f"{key} are not {wanted}")
    except (ArithmeticError, AssertionError, TypeError, ValueError) as error:
        raise InputError(
            f"action: found {dict(action)!r}, expected options that {action['type']} can take"
            f" ({error})"
        ) from error
    return action


def distance_left_m(road: TrafficRoad, ego: Vehicle) -> float:
    """Distance along the lanes from the ego vehicle's front to the end of its route, m."""
    network, lane = road.network, ego.lane_index
    s, _ = ego.lane.local_coordinates(ego.position)
    left = ego.lane.length - s - ego.LENGTH / 2
    for _ in range(2 * len(ego.stretches) + 2):
        then = network.onward_lane(lane, ego.stretches)
        if then is None:
            if lane[:2] in ego.stretches:  # at its end, or on a lane that leads elsewhere
                at = ego.stretches.index(lane[:2])
                left += sum(network.lanes[(*r, 0)].length for r in ego.stretches[at + 1 :])
            break
        left += network.lanes[then].length
        lane = then
    return float(left)


def is_on_route(road: TrafficRoad, ego: Vehicle) -> bool:
    """Whether the ego vehicle is on a stretch of its route or on a path between two of them.

    The paths of a junction that begin on one lane overlap at their start, so a vehicle counts as on
    its own path there, whichever of them highway-env puts it on.
    """
    network = road.network
    if ego.lane_index[:2] in ego.stretches:
        return True
    turns = set(itertools.pairwise(ego.stretches))
    return any(
        path == ego.lane_index or network.lanes[path].on_lane(ego.position, margin=STRETCH_MARGIN_M)
        for (begin, then), path in network.onward.items()
        if (begin[:2], then) in turns
    )


def is_off_road(road: TrafficRoad, ego: Vehicle) -> bool:
    """Whether the ego vehicle is beside its lane, or as a whole past an end of the road."""
    network, lane, length = road.network, ego.lane_index, ego.lane.length
    s, lateral = ego.lane.local_coordinates(ego.position)
    if abs(lateral) > ego.lane.width_at(s) / 2 + 1.0:
        return True
    if lane in network.exit_of or (lane[:2] == ego.stretches[-1] and s > 0.0):
        return False
    own = (lane[0].removeprefix("~"), lane[1].removeprefix("~"))  # on the wrong side, too
    if s < -ego.LENGTH / 2:
        return all(entered[:2] != own for entered in network.exit_of.values())
    past = s > length + ego.LENGTH / 2
    return past and all(left[:2] != own for left, _ in network.onward)
