"""Drives a whole scene on: scene and driver numbers in, places out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict import kernel
from graphrqi.predict.paths import PathTable
from graphrqi.predict.scene import STEP_S, Scene
from sim.lane_graph import LaneGraph

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_TOGETHER = np.empty((0, 0))


@dataclass(frozen=True, slots=True)
class Rollout:
    """One future of every driver on a path.

    Attributes:
        x: (n, H) distance along each driver's path, m.
        v: (n, H) speed, m/s.
    """

    x: FloatArray
    v: FloatArray


def roll(
    scene: Scene,
    driver: FloatArray,
    ignores: BoolArray | None = None,
    decay_s: float = 2.0,
    others: Rollout | None = None,
    steps: int | None = None,
) -> Rollout:
    """Drive the scene's drivers on along their paths.

    Args:
        scene: the present.
        driver: (n, 5) numbers of each driver, columns as ``drivers.DRIVER_FIELDS``.
        ignores: (n, R) gates that each driver ignores; none by default.
        decay_s: time in which what a driver does beyond the model falls to 1/e, s; 0: at once.
        others: where everyone else is taken to be; by default all move together.
        steps: how many; the scene's by default.

    Returns:
        Distances and speeds; rows of agents that are on no path stand still and mean nothing.
    """
    paths = PathTable.of(scene.road)
    q = scene.path
    length = np.ascontiguousarray(scene.history.length) / 2
    if ignores is None:
        gate_run = np.zeros((q.size, paths.gate_x.shape[1]), dtype=np.bool_)
    else:
        gate_run = np.take_along_axis(ignores, paths.gate_row[q], axis=1)
    driver = np.ascontiguousarray(driver, dtype=np.float64)
    speed = np.maximum(scene.speed, 0.0)
    nothing = np.zeros(q.size)

    def run(residual: FloatArray, steps: int, decay: float) -> tuple[FloatArray, FloatArray]:
        given = (_TOGETHER, _TOGETHER) if others is None else (others.x, others.v)
        x, v = kernel.roll(
            scene.s, speed, residual, length, driver, scene.on_path,
            paths.lane[q], paths.start[q], paths.limit[q], paths.gate_x[q], paths.gate_row[q],
            gate_run, scene.closed, paths.first.size, STEP_S, steps, decay, *given,
        )  # fmt: skip
        return x, v

    residual = nothing
    if decay_s > 0:
        _, first = run(nothing, 1, 1.0)
        residual = np.where(scene.on_path, scene.accel - (first[:, 0] - speed) / STEP_S, 0.0)
    return Rollout(*run(residual, steps or scene.steps, max(decay_s, 1e-3)))


def places(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, H, 2) places of a rollout, m; agents on no path go straight on."""
    graph, paths = LaneGraph.of(scene.road), PathTable.of(scene.road)
    out = scene.straight_on()
    on = scene.on_path
    q = scene.path[on]
    out[on] = kernel.place(
        rollout.x[on], scene.offsets()[on],
        paths.lane[q], paths.start[q], graph.segment_start, graph.segment_direction,
        graph.segment_at, graph.segment_first, graph.segment_last,
    )  # fmt: skip
    return out
