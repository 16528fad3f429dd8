"""How each driver of a scene drives in a rollout, given the beliefs about its behaviour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from graphrqi.arrays import BoolArray, FloatArray
from graphrqi.predict.rollout.driver_table import RUNS_RED, YIELDS, DriverTable
from graphrqi.predict.scene.scene import Scene

FREE_WEIGHT: Final = 0.1
"""Weight of the behaviour's desired speed against the driver's observed free speed."""

LEAST_FACTOR: Final = 0.05
"""Least desired speed over limit where limits are unknown (the driver models divide by it)."""


@dataclass(frozen=True, slots=True, eq=False)
class DriverParameters:
    """How n drivers drive.

    Attributes:
        following: (n, 5) car-following parameters, columns as ``driver_table.DRIVER_FIELDS``.
        ignores: (n, 2) whether each ignores red lights, and pedestrians at crossings.
    """

    following: FloatArray
    ignores: BoolArray


def expected_parameters(
    scene: Scene, probability: FloatArray, table: DriverTable
) -> DriverParameters:
    """The parameters expected under (n, 6) beliefs about the drivers' behaviours."""
    return DriverParameters(
        following=_personal(scene, table.expected(probability)[None])[0],
        ignores=_ignored(probability @ RUNS_RED, probability @ YIELDS),
    )


def parameters_of_each(scene: Scene, table: DriverTable) -> tuple[FloatArray, BoolArray]:
    """The parameters of each driver under each behaviour.

    Returns:
        (6, n, 5) car-following parameters. (6, n, 2) kinds of stop constraints ignored.
    """
    each = (len(BEHAVIORS), scene.ids.size)
    runs, yields = (np.broadcast_to(x[:, None], each) for x in (RUNS_RED, YIELDS))
    return _personal(scene, table.behavior[:, None]), _ignored(runs, yields)


def average_parameters(scene: Scene, table: DriverTable) -> DriverParameters:
    """The average driver's parameters for all drivers, who ignore nothing."""
    return DriverParameters(
        following=_personal(scene, table.average[None, None])[0],
        ignores=np.zeros((scene.ids.size, 2), dtype=np.bool_),
    )


def _ignored(runs_red: FloatArray, yields: FloatArray) -> BoolArray:
    """(..., n, 2) whether drivers ignore red lights, and pedestrians at crossings."""
    return np.stack([runs_red > 0.5, yields < 0.5], axis=-1)


def _personal(scene: Scene, following: FloatArray) -> FloatArray:
    """(M, n, 5) parameters, each driver's desired speed corrected by its observed speeds."""
    states = scene.states
    shape = len(following), scene.ids.size, following.shape[2]
    found = np.broadcast_to(following, shape).copy()
    free = np.log(np.maximum(states.free_factor, 0.1))
    shown = np.exp((FREE_WEIGHT * np.log(found[..., 0]) + free) / (1.0 + FREE_WEIGHT))
    wished = np.where(np.isnan(free), found[..., 0], shown)
    found[..., 0] = np.maximum(wished, states.least_factor)
    knows = scene.road.knows
    if not (knows.limits and knows.limits_rule):  # the speeds seen are all that is known of wishes
        found[..., 0] = np.maximum(states.least_factor, LEAST_FACTOR)
    return found
