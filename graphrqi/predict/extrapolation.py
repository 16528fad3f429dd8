"""Predictors that need no road: each agent's own past goes on, by constant motion or a filter."""

from __future__ import annotations

import numpy as np

from graphrqi.arrays import FloatArray
from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import Prediction, coming_times
from graphrqi.predict.recorded.motion import tracked
from graphrqi.predict.scene.scene import Scene, Unmapped, present_acceleration
from sim.frames import PEDESTRIAN, Tracks


def constant_velocity(scene: Scene | Unmapped, posterior: Posterior | None = None) -> Prediction:
    """Every agent keeps its recorded speed and heading."""
    history = scene.history
    return _straight_on(history, history.speed[:, -1][:, None] * coming_times(scene.steps))


def constant_acceleration(
    scene: Scene | Unmapped, posterior: Posterior | None = None
) -> Prediction:
    """Everyone keeps heading and acceleration; vehicles that brake to a standstill stay there."""
    history = scene.history
    speed, accel = history.speed[:, -1, None], present_acceleration(history)[:, None]
    return _straight_on(history, inertial_distance(speed, accel, coming_times(scene.steps)))


def kalman(scene: Scene | Unmapped, posterior: Posterior | None = None) -> Prediction:
    """A Kalman filter of constant acceleration along each axis; no agent reverses."""
    history, time_s = scene.history, coming_times(scene.steps)
    at, velocity, accel = tracked(history)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    facing = velocity / np.maximum(speed, 1e-6)[:, None]
    along = (accel * facing).sum(axis=1)
    ahead = inertial_distance(speed[:, None], along[:, None], time_s[None])
    across = accel - along[:, None] * facing
    moving = np.minimum(1.0, ahead / np.maximum(speed[:, None] * time_s, 1e-6))
    bend = 0.5 * across[:, None] * (time_s**2 * moving)[..., None]
    walks = (history.kind == PEDESTRIAN)[:, None, None]
    xy = at[:, None] + ahead[..., None] * facing[:, None] + np.where(walks, 0.0, bend)
    return _one(history, xy)


def inertial_distance(speed: FloatArray, accel: FloatArray, time_s: FloatArray) -> FloatArray:
    """Distance at constant acceleration, m; vehicles that brake to a standstill stay there.

    Examples:
        >>> inertial_distance(np.array([4.0]), np.array([-2.0]), np.array([1.0, 5.0])).tolist()
        [3.0, 4.0]
    """
    until_stop = np.divide(-speed, accel, out=np.full_like(speed, np.inf), where=accel < 0)
    moving_s = np.minimum(time_s, until_stop)
    return np.asarray(speed * moving_s + 0.5 * accel * moving_s**2)


def _straight_on(history: Tracks, ahead: FloatArray) -> Prediction:
    """Everyone (n, H) metres ahead along its heading."""
    heading = history.heading[:, -1]
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return _one(history, history.xy[:, -1][:, None] + ahead[..., None] * facing[:, None])


def _one(history: Tracks, xy: FloatArray) -> Prediction:
    """One future each."""
    one = np.ones((history.ids.size, 1))
    return Prediction(history.ids, coming_times(xy.shape[1]), xy[:, None], one)
