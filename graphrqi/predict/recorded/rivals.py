"""Simple rules for the motion of recorded agents, to compare with.

Each knows the agents' own past only. Measured against constant velocity (mean displacement over
5 s) on recordings of twelve families the fading base has .79 to 1.03, a Kalman filter .89.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.posterior import Posterior
from graphrqi.predict.constant import inertial_distance
from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.recorded.motion import (
    SLOPE_FADE_S,
    SLOPE_SHARE,
    YAW_FADE_S,
    YAW_SHARE,
    Motion,
    bent,
    fading,
    tracked,
)
from graphrqi.predict.rollout.lane_positions import along_path
from graphrqi.predict.rollout.rollout import on_lanes
from graphrqi.predict.scene.scene import Scene
from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]


def constant_velocity(history: Tracks, steps: int) -> Prediction:
    """Everyone keeps the recorded speed and heading."""
    time_s = _times(steps)
    heading = history.heading[:, -1]
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    ahead = history.speed[:, -1][:, None] * time_s
    return _one(history, history.xy[:, -1][:, None] + ahead[..., None] * facing[:, None])


def faded(history: Tracks, steps: int) -> Prediction:
    """The base of the predictor for recordings: acceleration and yaw rate fade."""
    motion = Motion.of(history)
    return _one(history, motion.from_own_frame(fading(motion, _times(steps))))


def turning(history: Tracks, steps: int) -> Prediction:
    """Everyone keeps the speed, and the yaw rate fades."""
    motion = Motion.of(history)
    none = np.zeros_like(motion.speed)
    own = bent(motion.speed, none, 1.0, YAW_SHARE * motion.yaw_rate, YAW_FADE_S, _times(steps))
    return _one(history, motion.from_own_frame(own))


def kalman(history: Tracks, steps: int) -> Prediction:
    """A Kalman filter of constant acceleration along each axis; nobody reverses."""
    at, velocity, accel = tracked(history)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    facing = velocity / np.maximum(speed, 1e-6)[:, None]
    along = (accel * facing).sum(axis=1)
    time_s = _times(steps)
    ahead = inertial_distance(speed[:, None], along[:, None], time_s[None])
    across = accel - along[:, None] * facing
    moving = np.minimum(1.0, ahead / np.maximum(speed[:, None] * time_s, 1e-6))
    bend = 0.5 * across[:, None] * (time_s**2 * moving)[..., None]
    walks = (history.kind == PEDESTRIAN)[:, None, None]
    xy = at[:, None] + ahead[..., None] * facing[:, None] + np.where(walks, 0.0, bend)
    return _one(history, xy)


WITHOUT_MAP: Final[dict[str, Callable[[Tracks, int], Prediction]]] = {
    "constant-velocity": constant_velocity,
    "fading": faded,
    "turn-rate": turning,
    "kalman": kalman,
}
"""The predictors that need no map."""


def fading_predictor(scene: Scene, posterior: Posterior) -> Prediction:
    """Acceleration and yaw rate fade: the base of the predictor for recordings."""
    return faded(scene.history, scene.steps)


def turn_rate_predictor(scene: Scene, posterior: Posterior) -> Prediction:
    """Everyone keeps the speed, and the yaw rate fades."""
    return turning(scene.history, scene.steps)


def kalman_predictor(scene: Scene, posterior: Posterior) -> Prediction:
    """A Kalman filter of constant acceleration."""
    return kalman(scene.history, scene.steps)


def lane_predictor(scene: Scene, posterior: Posterior) -> Prediction:
    """Accelerations fade along the likeliest lanes; agents on no lane keep the base."""
    history = scene.history
    motion = Motion.of(history)
    none = np.zeros_like(motion.speed)
    ahead = bent(
        motion.speed, SLOPE_SHARE * motion.accel, SLOPE_FADE_S, none, YAW_FADE_S, scene.time_s
    )[..., 0]  # fmt: skip
    lane, s = along_path(scene.path, scene.s[:, None] + ahead, scene.paths.lane, scene.paths.start)
    xy = on_lanes(scene, lane, s, scene.offsets())
    off = ~scene.on_path
    xy[off] = motion.from_own_frame(fading(motion, scene.time_s))[off]
    return scene.predicted(xy)


def _times(steps: int) -> FloatArray:
    return np.arange(1, steps + 1, dtype=np.float64) * STEP_S


def _one(history: Tracks, xy: FloatArray) -> Prediction:
    """One future each."""
    one = np.ones((history.ids.size, 1))
    return Prediction(history.ids, _times(xy.shape[1]), xy[:, None], one)
