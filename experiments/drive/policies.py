"""Drivers of the ego vehicle: our policies by name, or ``module:function`` of the user's own.

A policy is made for one environment, before its first episode: ``make(env)`` returns a function
that takes an observation and returns an action. The attribute ``config`` of ``make``, if it has
one, changes the environment's configuration: ``{"action": {"type": "ContinuousAction"}}``. A
trained network is loaded inside ``make``, by the library that wrote it: no file of a policy is
opened here. Beside what gymnasium gives, the environment has ``scenario``, ``time``, ``ego_id``,
the ``truth`` by id, and ``on_frame``, which is called with every frame.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.driver_models import krauss_safe_speed
from behaviors.errors import InputError, lookup
from behaviors.labels import BEHAVIORS
from behaviors.registry import own_function
from experiments.drive.planner import ACT_S, plan
from graphrqi.model_files import load_model
from graphrqi.predict.rollout.driver_table import load_table
from graphrqi.predict.scene.scene import make_scene
from graphrqi.stream import DEFAULT_MODEL, HISTORY_STEPS, BehaviorStream
from sim.episode.live import FrameBuffer
from sim.episode.observables import observe
from sim.frames import FloatArray, Frame
from sim.road import Road

Act = Callable[[Mapping[str, Any]], Any]
"""From an observation to an action."""

LOOK_AHEAD_M, LOOK_AHEAD_S = 8.0, 1.2
"""The steering looks at the centre line this far ahead (Coulter 1992's pure pursuit; the lengths
are ours: a lane change takes some 3 s)."""

MOST_ACCEL_MPS2: Final = 8.0
"""The planned vehicle's accelerator and brake reach this, m/s2."""

EMERGENCY_DECEL_MPS2, EMERGENCY_S, EMERGENCY_GAP_M = 7.0, 0.2, 0.5
"""The emergency brake counts on this deceleration, brakes within this time and leaves this gap. It
is as hard as dry asphalt allows, so the plan and not the brake avoids near misses."""


_model = functools.lru_cache(maxsize=2)(load_model)


class Planner:
    """Our planner at the wheel for one episode, of which it sees every frame.

    It ``knows`` "nothing", "beliefs" or "truth" of the other drivers.
    """

    def __init__(self, knows: str, env: Any) -> None:
        self._knows, self._env = knows, env
        self._buffer = FrameBuffer(HISTORY_STEPS)
        self._stream = BehaviorStream(_model(DEFAULT_MODEL)) if knows == "beliefs" else None
        self._plan: tuple[float, FloatArray] | None = None
        self._next_s = 0.0
        env.on_frame = self._see

    def _see(self, frame: Frame) -> None:
        """Remember and classify a frame."""
        self._buffer.push(frame)
        if self._stream is not None:
            self._stream.push(frame)

    def __call__(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """(2,) acceleration and steering for highway-env's ``ContinuousAction``."""
        action, ego_id = np.zeros(2, dtype=np.float32), self._env.ego_id
        if not len(self._buffer) or ego_id not in self._buffer.last.ids:
            return action
        frame = self._buffer.last
        me = int(np.flatnonzero(frame.ids == ego_id)[0])
        road: Road = self._env.scenario.road
        if self._env.time >= self._next_s - 1e-6:
            scene = make_scene(self._buffer.tracks(), road)
            ego = int(np.searchsorted(scene.ids, ego_id))
            if scene.on_path[ego]:
                self._plan = plan(scene, ego, self._beliefs(frame), load_table())
            self._next_s = self._env.time + ACT_S
        if self._plan is None:
            return action
        accel, centre = self._plan
        turn = steering(centre, frame, me)
        action[0] = min(accel, safe_accel(frame, road, me)) / MOST_ACCEL_MPS2
        action[1] = -turn / (math.pi / 4)  # highway-env's y points to the right
        return np.clip(action, -1.0, 1.0)

    def _beliefs(self, frame: Frame) -> FloatArray:
        """(n, 6) what is known of everybody in a frame."""
        if self._stream is not None:
            return self._stream.posterior().of(frame.ids)
        known = np.full((frame.ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
        if self._knows == "truth":
            for row, agent in enumerate(frame.ids.tolist()):
                if agent in self._env.truth:
                    known[row] = np.eye(len(BEHAVIORS))[self._env.truth[agent]]
        return known


def steering(centre: FloatArray, frame: Frame, me: int) -> float:
    """The front wheels' angle that leads row ``me`` onto a centre line, rad, positive to the left.

    Pure pursuit: a circle through a point on the line (H, 2), m, ahead of the vehicle, driven by
    highway-env's bicycle.
    """
    away = np.hypot(*(centre - frame.xy[me]).T)
    ahead = np.flatnonzero(away >= max(LOOK_AHEAD_M, LOOK_AHEAD_S * float(frame.speed[me])))
    ahead = ahead[ahead > int(away.argmin())]
    goal = centre[ahead[0] if ahead.size else -1] - frame.xy[me]
    angle = math.atan2(goal[1], goal[0]) - float(frame.heading[me])
    curvature = 2.0 * math.sin(angle) / max(float(np.hypot(*goal)), 1.0)
    slip = math.asin(max(-0.7, min(0.7, curvature * float(frame.length[me]) / 2.0)))
    return math.atan(2.0 * math.tan(slip))


def safe_accel(frame: Frame, road: Road, me: int) -> float:
    """The most at which row ``me`` can still stop behind a leader who brakes to a stop, m/s2.

    It is the emergency brake of every planner, as beliefs may be wrong. The safe speed is Krauss's.
    """
    seen = observe(frame, road)
    leader, speed = int(seen.leader[me]), float(frame.speed[me])
    if leader < 0:
        return math.inf
    room = max(float(seen.gap[me]) - EMERGENCY_GAP_M, 0.0)
    safe = krauss_safe_speed(room, float(frame.speed[leader]), EMERGENCY_S, EMERGENCY_DECEL_MPS2)
    return (safe - speed) / EMERGENCY_S


STEERED: Final[dict[str, Any]] = {
    "action": {
        "type": "ContinuousAction", "acceleration_range": [-MOST_ACCEL_MPS2, MOST_ACCEL_MPS2]
    },
    "policy_frequency": 10,
}  # fmt: skip
"""How the planner steers."""

BLIND: Final = "planner-blind"
"""The planner that knows nothing of the other drivers; what knowledge gains is counted from it."""

KNOWS: Final = {BLIND: "nothing", "planner-classified": "beliefs", "planner-true": "truth"}
"""What each planner knows of the other drivers."""

POLICIES: Final[dict[str, tuple[Callable[..., Act], dict[str, Any]]]] = {
    "do-nothing": (lambda env: lambda observation: 1, {}),
    "idm-mobil": (lambda env: lambda observation: 0, {"action": {"type": "StockDriver"}}),
    **{name: (functools.partial(Planner, knows), STEERED) for name, knows in KNOWS.items()},
}
"""Our policies, with what each changes in an environment's configuration: one that keeps speed and
lane, highway-env's own driver (IDM and MOBIL, no signals, no pedestrians), and the planners."""


def get_policy(name: str) -> tuple[Callable[..., Act], dict[str, Any]]:
    """A policy of `POLICIES` or "module:function", and its environment's configuration."""
    if ":" not in name:
        return lookup(POLICIES, name, "policy")
    make = own_function("policy", name)
    config = getattr(make, "config", {})
    if not isinstance(config, Mapping):
        raise InputError(f"policy: found {name}.config {config!r}, expected a mapping")
    return make, dict(config)
