"""Predictors that need no road: constant velocity and constant acceleration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.scene.scene import Scene

FloatArray = NDArray[np.float64]


def constant_velocity(scene: Scene, posterior: Posterior) -> Prediction:
    """Everyone keeps speed and heading (the recorded ones, which beat differenced positions)."""
    return scene.predicted(scene.straight_on())


def constant_acceleration(scene: Scene, posterior: Posterior) -> Prediction:
    """Everyone keeps heading and acceleration; vehicles that brake to a standstill stay there."""
    return scene.predicted(by_inertia(scene))


def inertial_distance(speed: FloatArray, accel: FloatArray, time_s: FloatArray) -> FloatArray:
    """Distance at constant acceleration, m; vehicles that brake to a standstill stay there.

    Args:
        speed: m/s; all three broadcast.
        accel: m/s2.
        time_s: from now, s.
    """
    until_stop = np.divide(-speed, accel, out=np.full_like(speed, np.inf), where=accel < 0)
    moving_s = np.minimum(time_s, until_stop)
    return np.asarray(speed * moving_s + 0.5 * accel * moving_s**2)


def by_inertia(scene: Scene) -> FloatArray:
    """(n, H, 2) everyone at constant acceleration, m."""
    time_s, speed, accel = scene.time_s[None], scene.speed[:, None], scene.accel[:, None]
    travelled = inertial_distance(speed, accel, time_s)
    facing = np.stack([np.cos(scene.heading), np.sin(scene.heading)], axis=1)
    return np.asarray(scene.xy[:, None] + travelled[..., None] * facing[:, None])
