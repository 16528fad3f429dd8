"""Drives a whole scene on: scene and manners in, places out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout import kernel
from graphrqi.predict.rollout.driver_parameters import DriverParameters
from graphrqi.predict.scene.scene import RETURN_MPS, Scene

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_NO_LANES = np.empty((0, 0), dtype=np.int64)
_NO_NUMBERS = np.empty((0, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Rollout:
    """One future of every driver on a path; rows of others stand still and mean nothing.

    Attributes:
        lane: (n, H) lane of each at each step.
        s: (n, H) distance along it, m.
        side: (n, H) distance to the left of its centre line, m.
        v: (n, H) speed, m/s.
        gone: (n, H) way gone since the present, m.
        asked: (n,) acceleration that the law asks for at present, m/s2.
        step_s: time between steps, s.
    """

    lane: IntArray
    s: FloatArray
    side: FloatArray
    v: FloatArray
    gone: FloatArray
    asked: FloatArray
    step_s: float = STEP_S


@dataclass(frozen=True, slots=True, eq=False)
class Alternatives:
    """M futures of every driver on a path, each alone among the others; see `Rollout`.

    Attributes:
        lane: (M, n, H).
        s: (M, n, H) m.
        side: (M, n, H) m.
        gone: (M, n, H) m.
        asked: (M, n) m/s2.
    """

    lane: IntArray
    s: FloatArray
    side: FloatArray
    gone: FloatArray
    asked: FloatArray


def roll(
    scene: Scene,
    manners: DriverParameters,
    decay_s: float = 2.0,
    others: Rollout | None = None,
    steps: int | None = None,
    step_s: float = STEP_S,
    planned: int | None = None,
) -> Rollout:
    """Drive the scene's drivers on along their paths.

    Args:
        scene: the present.
        manners: how each drives.
        decay_s: time in which what a driver does beyond the model falls to 1/e, s; 0: at once.
        others: where everyone else is taken to be, at the same steps; by default all move
            together.
        steps: how many; by default up to the scene's horizon.
        step_s: time between them, s.
        planned: the row of one who drives by its manners alone, whatever it does at present.

    Returns:
        The drivers' future.
    """
    paths, graph = scene.paths, scene.graph
    half_length = np.ascontiguousarray(scene.history.length) / 2
    speed = np.maximum(scene.speed, 0.0)
    pace = np.maximum(np.abs(scene.sideways), RETURN_MPS)
    given = (_NO_LANES, _NO_NUMBERS, _NO_NUMBERS)
    if others is not None:
        given = (others.lane, others.s, others.v)

    accel = scene.accel
    if planned is not None:
        accel = np.where(np.arange(accel.size) == planned, -2.0 * kernel.UNSEEN, accel)
    lane, s, side, v, gone, asked = kernel.roll(
        scene.path, scene.s, speed, accel, half_length, manners.following, manners.changing,
        manners.wary, manners.feared, scene.offset, pace, scene.on_path, manners.ignores,
        scene.closed, paths.lane, paths.start, paths.limit, paths.turn, paths.gate_x,
        paths.gate_row, paths.beside, paths.apart, paths.way, graph.length, step_s,
        step_s / STEP_S, steps or round(scene.steps * STEP_S / step_s), decay_s, *given,
    )  # fmt: skip
    return Rollout(lane, s, side, v, gone, asked, step_s)


def roll_each(
    scene: Scene,
    path: IntArray,
    offset: FloatArray,
    sideways: FloatArray,
    following: FloatArray,
    ignores: BoolArray,
    decay_s: float,
    others: Rollout,
) -> Alternatives:
    """Drive everyone on in M ways, each driver alone among the others; nobody changes lanes.

    Args:
        scene: the present.
        path: (M, n) path of each driver, like the next two instead of the scene's.
        offset: (M, n) distance to the left of the lane's centre, m.
        sideways: (M, n) speed to the left, m/s.
        following: (M, n, 5) how each drives, as in `DriverParameters`.
        ignores: (M, n, R) likewise.
        decay_s: as to `roll`.
        others: where everyone else is taken to be; the steps are its.

    Returns:
        The drivers' futures.
    """
    paths, graph, steps = scene.paths, scene.graph, others.s.shape[1]
    return Alternatives(
        *kernel.roll_each(
            path, scene.s, np.maximum(scene.speed, 0.0), scene.accel,
            np.ascontiguousarray(scene.history.length) / 2, following, offset,
            np.maximum(np.abs(sideways), RETURN_MPS), scene.on_path, ignores, scene.closed,
            paths.lane, paths.start, paths.limit, paths.turn, paths.gate_x, paths.gate_row,
            paths.beside, paths.apart, paths.way, graph.length, others.step_s,
            others.step_s / STEP_S, steps, decay_s, others.lane, others.s, others.v,
        )
    )  # fmt: skip


def places(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, H, 2) places of a rollout, m; agents on no path go straight on."""
    on = scene.on_path
    out = _on_lanes(scene, rollout.lane, rollout.s, rollout.side)
    if not on.all():
        time_s = np.arange(1, out.shape[1] + 1) * rollout.step_s
        out[~on] = scene.straight_on(~on, time_s)
    return np.asarray(out)


def _on_lanes(scene: Scene, lane: IntArray, s: FloatArray, side: FloatArray) -> FloatArray:
    graph = scene.graph
    return np.asarray(
        kernel.place(
            lane, s, side, graph.segment_start, graph.segment_direction, graph.segment_at,
            graph.segment_first, graph.segment_last,
        )
    )  # fmt: skip


def from_own_seat(
    scene: Scene, lane: IntArray, s: FloatArray, side: FloatArray, every: int, step_s: float
) -> FloatArray:
    """(n, J, 2) every so many of a rollout's places ahead and to the left of each driver, m.

    Args:
        scene: the present.
        lane: (n, H) lanes.
        s: (n, H) distances along them, m.
        side: (n, H) distances to the left of their centres, m.
        every: steps from one place told to the next.
        step_s: time between steps, s.
    """
    return np.asarray(
        kernel.from_own_seat(
            _on_lanes(scene, lane, s, side), scene.xy, scene.heading, scene.speed, scene.on_path,
            every, step_s,
        )
    )  # fmt: skip


def steady(scene: Scene) -> Rollout:
    """Everyone along its path at its present speed, returning to its lane's centre."""
    paths = scene.paths
    gone = scene.speed[:, None] * scene.time_s[None]
    lane, s = kernel.along_path(scene.path, scene.s[:, None] + gone, paths.lane, paths.start)
    speed = np.repeat(scene.speed[:, None], scene.steps, axis=1)
    return Rollout(lane, s, scene.offsets(), speed, gone, np.zeros(scene.ids.size))


def beside(scene: Scene, side: int, other_ways: bool = True) -> tuple[Scene, BoolArray]:
    """Everyone on its way to the lane beside, where there is one.

    Args:
        scene: the present.
        side: 1: to the left, -1: to the right.
        other_ways: whether a lane counts that leads elsewhere than the path does.

    Returns:
        The scene, and (n,) who has such a lane; the others are left where they are.
    """
    table, which = scene.paths, 0 if side > 0 else 1
    lane, path, offset, sideways, there = kernel.beside(
        which, other_ways, scene.lane, scene.path, scene.on_path, scene.offset, scene.sideways,
        table.beside, table.apart, table.way, table.turn,
    )  # fmt: skip
    moving = scene.but(lane=lane, path=path, offset=offset, sideways=sideways)
    return moving, there


def centre_ahead(scene: Scene, row: int) -> FloatArray:
    """(H, 2) the centre line of one driver's path from here on, every metre for 60 m."""
    paths = scene.paths
    x = scene.s[row] + np.arange(60.0)[None]
    lane, s = kernel.along_path(scene.path[row : row + 1], x, paths.lane, paths.start)
    return np.asarray(_on_lanes(scene, lane, s, np.zeros_like(s))[0])
