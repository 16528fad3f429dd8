"""Simulates a whole scene: a scene and driver parameters in, positions out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout.car_following import (
    UNKNOWN_ACCELERATION,
    Others,
    Present,
    Rollout,
    simulate,
)
from graphrqi.predict.rollout.driver_table import DriverParameters
from graphrqi.predict.scene.scene import RETURN_MPS, Scene
from sim.geometry import turned

CHANGE_S = 3.0
"""Duration of a lane change, s (3 to 6 s are observed)."""

_MOVE_TOGETHER = Others(np.empty((0, 0), dtype=np.int64), np.empty((0, 0)), np.empty((0, 0)))


def roll(
    scene: Scene,
    drivers: DriverParameters,
    decay_s: float = 2.0,
    steps: int | None = None,
    step_s: float = STEP_S,
    planned: int | None = None,
) -> Rollout:
    """Simulate the scene's drivers along their paths, all together, up to the horizon.

    The residual acceleration decays with ``decay_s``; the vehicle of row ``planned`` has none. The
    number of steps may be another one, and their length, s.
    """
    accel = scene.accel.copy()
    if planned is not None:
        accel[planned] = UNKNOWN_ACCELERATION
    count = steps or round(scene.steps * STEP_S / step_s)
    started = scene.replaced(accel=accel)
    return _rolled(started, scene.path[None], [scene], drivers, decay_s, count, step_s).of(0)


def roll_each(
    scene: Scene, ways: Sequence[Scene], drivers: DriverParameters, decay_s: float, others: Rollout
) -> Rollout:
    """Simulate each driver alone among the others, whose future is assumed, in M variants.

    The variants are M scenes with other paths, offsets and lateral speeds, and parameters of
    (M, n) drivers.
    """
    path, known = np.stack([way.path for way in ways]), Others(others.lane, others.s, others.speed)
    return _rolled(scene, path, ways, drivers, decay_s, others.s.shape[1], others.step_s, known)


def asked_on(scene: Scene, path: IntArray, drivers: DriverParameters) -> FloatArray:
    """(C, n) the law's acceleration at present on each of C paths (C, n), m/s2.

    It is 0 where -1 minus a path is given.
    """
    return _rolled(scene, path, [scene], drivers, 0.0, 1, STEP_S).asked


def _rolled(
    scene: Scene, path: IntArray, ways: Sequence[Scene], drivers: DriverParameters,
    decay_s: float, count: int, step_s: float, others: Others = _MOVE_TOGETHER,
) -> Rollout:  # fmt: skip
    """Simulate; see `graphrqi.predict.rollout.car_following.simulate`."""
    present = Present(
        scene.s, np.maximum(scene.speed, 0.0), scene.accel, scene.history.length / 2, scene.on_path
    )
    offset = np.stack([way.offset for way in ways])
    back = np.stack([np.maximum(np.abs(way.lateral_speed), RETURN_MPS) for way in ways])
    following, ignores = drivers.following, drivers.ignores
    if following.ndim == 2:
        following, ignores = following[None], ignores[None]
    return simulate(
        present, path, np.stack([offset, back], axis=-1), following, ignores, scene.stop_state,
        scene.paths.columns, others, (count, step_s, step_s / STEP_S, decay_s),
    )  # fmt: skip


def positions(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, H, 2) positions of a rollout, m; agents without a path go straight on."""
    on = scene.on_path
    out = on_lanes(scene, rollout.lane, rollout.s, rollout.offset)
    if not on.all():
        gone = scene.speed[~on, None] * (np.arange(1, out.shape[1] + 1) * rollout.step_s)
        facing = np.stack([np.cos(scene.heading[~on]), np.sin(scene.heading[~on])], axis=1)
        out[~on] = scene.xy[~on, None] + gone[..., None] * facing[:, None]
    return out


def on_lanes(scene: Scene, lane: IntArray, s: FloatArray, offset: FloatArray) -> FloatArray:
    """(n, H, 2) positions of distances along lanes, and to the left of their centres, m."""
    xy, _ = scene.graph.position(lane.ravel(), s.ravel(), offset.ravel())
    return xy.reshape(*s.shape, 2)


def in_own_frame(
    scene: Scene, lane: IntArray, s: FloatArray, offset: FloatArray, time_s: FloatArray
) -> FloatArray:
    """(..., n, J, 2) places on lanes in the drivers' frames, ahead and to the left, m.

    Lanes, distances along them and to their left, m, are (..., n, J). Agents without a path go
    straight on, to where they are at times (J,), s.
    """
    ahead = on_lanes(scene, lane, s, offset) - scene.xy[:, None]
    own = turned(ahead, -scene.heading[:, None])
    if not scene.on_path.all():
        off = ~scene.on_path
        own[..., off, :, :] = 0.0
        own[..., 0][..., off, :] = scene.speed[off, None] * time_s
    return own


def steady(scene: Scene) -> Rollout:
    """Every driver along its path at its present speed, returning to its lane's centre."""
    travelled = scene.speed[:, None] * scene.time_s[None]
    lane, s = scene.paths.along(scene.path, scene.s[:, None] + travelled)
    speed = np.repeat(scene.speed[:, None], scene.steps, axis=1)
    asked = np.zeros(scene.ids.size)
    back = np.maximum(np.abs(scene.lateral_speed), RETURN_MPS)[:, None] * scene.time_s[None]
    offset = np.maximum(np.abs(scene.offset)[:, None] - back, 0.0)
    offset *= np.sign(scene.offset)[:, None]
    return Rollout(lane, s, offset, speed, travelled, asked, STEP_S)


def on_lane_beside(scene: Scene, side: int, other_ways: bool = True) -> tuple[Scene, BoolArray]:
    """Every driver on its way to the lane on the left (1) or right (-1), where there is one.

    Without ``other_ways``, lanes with another destination than the path do not count. (n,) says who
    has such a lane; the others stay.
    """
    paths = scene.paths
    number, sign = (0, 1.0) if side > 0 else (1, -1.0)
    here = np.maximum(scene.lane, 0)
    to = paths.beside[number, here]
    onward = paths.by_turn[to, paths.turn[scene.path]]
    if other_ways:
        onward = np.where(onward < 0, paths.by_turn[to].max(axis=1), onward)
    there = scene.on_path & (to >= 0) & (onward >= 0)
    wide = sign * paths.lane_spacing[number, here]
    moving = scene.replaced(
        lane=np.where(there, to, scene.lane),
        path=np.where(there, onward, scene.path),
        offset=np.where(there, scene.offset - wide, scene.offset),
        lateral_speed=np.where(there, wide / CHANGE_S, scene.lateral_speed),
    )
    return moving, there


def centre_ahead(scene: Scene, row: int) -> FloatArray:
    """(H, 2) the centre line of one driver's path ahead, every metre for 60 m."""
    x = scene.s[row] + np.arange(60.0)[None]
    lane, s = scene.paths.along(scene.path[row : row + 1], x)
    return np.asarray(on_lanes(scene, lane, s, np.zeros_like(s))[0])
