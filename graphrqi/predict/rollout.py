"""Drives a whole scene on: scene and manners in, places out."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict import kernel
from graphrqi.predict.manners import Manners
from graphrqi.predict.paths import PathTable
from graphrqi.predict.scene import RETURN_MPS, STEP_S, Scene
from sim.lane_graph import DIRECTIONS, LaneGraph
from sim.road import Road

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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
    """

    lane: IntArray
    s: FloatArray
    side: FloatArray
    v: FloatArray
    gone: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LaneTable:
    """What the rollout needs of a road beside its paths.

    Attributes:
        beside: (2, L) lanes to the left and to the right, -1: none.
        apart: (2, L) how far apart the two centres are, m.
        way: (L, D) likeliest path from each lane that turns each way, -1: none.
    """

    beside: IntArray
    apart: FloatArray
    way: IntArray

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(road: Road) -> LaneTable:
        """The table of a road, built on first use and kept."""
        graph, paths = LaneGraph.of(road), PathTable.of(road)
        beside = np.stack([graph.left, graph.right])
        apart = (graph.width[None] + graph.width[np.maximum(beside, 0)]) / 2
        way = np.full((graph.length.size, len(DIRECTIONS)), -1)
        order = np.argsort(paths.probability, kind="stable")  # the likeliest is written last
        way[np.repeat(np.arange(paths.first.size), paths.count)[order], paths.turn[order]] = order
        return LaneTable(beside, apart, way)


def roll(
    scene: Scene,
    manners: Manners,
    decay_s: float = 2.0,
    others: Rollout | None = None,
    steps: int | None = None,
) -> Rollout:
    """Drive the scene's drivers on along their paths.

    Args:
        scene: the present.
        manners: how each drives.
        decay_s: time in which what a driver does beyond the model falls to 1/e, s; 0: at once.
        others: where everyone else is taken to be; by default all move together.
        steps: how many; the scene's by default.

    Returns:
        The drivers' future.
    """
    paths, graph, table = (
        PathTable.of(scene.road),
        LaneGraph.of(scene.road),
        LaneTable.of(scene.road),
    )
    half_length = np.ascontiguousarray(scene.history.length) / 2
    speed = np.maximum(scene.speed, 0.0)
    pace = np.maximum(np.abs(scene.sideways), RETURN_MPS)
    given = (_NO_LANES, _NO_NUMBERS, _NO_NUMBERS)
    if others is not None:
        given = (others.lane, others.s, others.v)

    def run(residual: FloatArray, steps: int, decay: float) -> Rollout:
        return Rollout(
            *kernel.roll(
                scene.path, scene.s, speed, residual, half_length, manners.following,
                manners.changing, manners.wary, manners.feared, scene.offset, pace, scene.on_path,
                manners.ignores, scene.closed, paths.lane, paths.start, paths.limit, paths.turn,
                paths.gate_x, paths.gate_row, table.beside, table.apart, table.way, graph.length,
                STEP_S, steps, decay, *given,
            )
        )  # fmt: skip

    residual = np.zeros(speed.size)
    if decay_s > 0:
        first = run(residual, 1, 1.0).v[:, 0]
        residual = np.where(scene.on_path, scene.accel - (first - speed) / STEP_S, 0.0)
    return run(residual, steps or scene.steps, max(decay_s, 1e-3))


def places(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, H, 2) places of a rollout, m; agents on no path go straight on."""
    graph = LaneGraph.of(scene.road)
    out = scene.straight_on()
    on = scene.on_path
    out[on] = kernel.place(
        rollout.lane[on], rollout.s[on], rollout.side[on], graph.segment_start,
        graph.segment_direction, graph.segment_at, graph.segment_first, graph.segment_last,
    )  # fmt: skip
    return out


def steady(scene: Scene) -> Rollout:
    """Everyone along its path at its present speed, returning to its lane's centre."""
    paths = PathTable.of(scene.road)
    gone = scene.speed[:, None] * scene.time_s[None]
    lane, s = kernel.along_path(scene.path, scene.s[:, None] + gone, paths.lane, paths.start)
    speed = np.repeat(scene.speed[:, None], scene.steps, axis=1)
    return Rollout(lane, s, scene.offsets(), speed, gone)
