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
from sim.geometry import to_own_frame

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

    The residual acceleration decays with ``decay_s``; the vehicle of row ``planned`` has none.
    Other numbers of steps than up to the horizon, and other lengths, s, may be given.
    """
    present = _present(scene)
    if planned is not None:
        present.accel[planned] = UNKNOWN_ACCELERATION
    count = steps or round(scene.steps * STEP_S / step_s)
    found = simulate(
        present, scene.path[None], _lateral(scene.offset, scene.lateral_speed)[None],
        drivers.following[None], drivers.ignores[None], scene.stop_state, scene.paths.columns,
        _MOVE_TOGETHER, (count, step_s, step_s / STEP_S, decay_s),
    )  # fmt: skip
    return found.of(0)


def roll_each(
    scene: Scene,
    ways: Sequence[Scene],
    following: FloatArray,
    ignores: BoolArray,
    decay_s: float,
    others: Rollout,
) -> Rollout:
    """Simulate each driver alone among the others, whose future is assumed, in M variants.

    The variants are M scenes with other paths, offsets and lateral speeds, and (M, n, ...)
    parameters as in `DriverParameters`.
    """
    path, offset, lateral_speed = (
        np.stack([getattr(way, name) for way in ways])
        for name in ("path", "offset", "lateral_speed")
    )
    count, step_s = others.s.shape[1], others.step_s
    return simulate(
        _present(scene), path, _lateral(offset, lateral_speed), following, ignores,
        scene.stop_state, scene.paths.columns, Others(others.lane, others.s, others.speed),
        (count, step_s, step_s / STEP_S, decay_s),
    )  # fmt: skip


def asked_on(scene: Scene, path: IntArray, drivers: DriverParameters) -> FloatArray:
    """(C, n) the law's acceleration at present on each of C paths (C, n), m/s2.

    It is 0 where -1 minus a path is given.
    """
    return simulate(
        _present(scene), path, _lateral(scene.offset, scene.lateral_speed)[None],
        drivers.following[None], drivers.ignores[None], scene.stop_state,
        scene.paths.columns, _MOVE_TOGETHER, (1, STEP_S, 1.0, 0.0),
    ).asked  # fmt: skip


def _present(scene: Scene) -> Present:
    """What a rollout starts from."""
    return Present(
        scene.s, np.maximum(scene.speed, 0.0), scene.accel.copy(), scene.history.length / 2,
        scene.on_path,
    )  # fmt: skip


def _lateral(offset: FloatArray, lateral_speed: FloatArray) -> FloatArray:
    """(..., 2) distance to the left, m, and lateral speed at which drivers return to it, m/s."""
    out = np.empty((*offset.shape, 2))
    out[..., 0] = offset
    np.maximum(np.abs(lateral_speed), RETURN_MPS, out=out[..., 1])
    return out


def positions(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, H, 2) positions of a rollout, m; agents without a path go straight on."""
    on = scene.on_path
    out = on_lanes(scene, rollout.lane, rollout.s, rollout.offset)
    if not on.all():
        time_s = np.arange(1, out.shape[1] + 1) * rollout.step_s
        out[~on] = scene.straight_on(~on, time_s)
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
    xy = np.moveaxis(on_lanes(scene, lane, s, offset), -3, 0)
    own = np.moveaxis(to_own_frame(xy, scene.xy, scene.heading), 0, -3)
    straight = np.zeros(own.shape[-3:])
    straight[..., 0] = scene.speed[:, None] * time_s
    return np.where(scene.on_path[:, None, None], own, straight)


def steady(scene: Scene) -> Rollout:
    """Every driver along its path at its present speed, returning to its lane's centre."""
    travelled = scene.speed[:, None] * scene.time_s[None]
    lane, s = scene.paths.along(scene.path, scene.s[:, None] + travelled)
    speed = np.repeat(scene.speed[:, None], scene.steps, axis=1)
    asked = np.zeros(scene.ids.size)
    return Rollout(lane, s, scene.offsets(), speed, travelled, asked, STEP_S)


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
