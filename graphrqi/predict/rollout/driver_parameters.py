"""How each driver of a scene drives in a rollout, given the beliefs about its behaviour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from graphrqi.predict.rollout.driver_table import RUNS_RED, YIELDS, DriverTable
from graphrqi.predict.scene.scene import Scene
from sim.compiled import in_place

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

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
    found = np.empty((len(following), states.free_factor.size, following.shape[2]))
    _correct(following, states.free_factor, states.least_factor, found)
    knows = scene.road.knows
    if not (knows.limits and knows.limits_rule):  # the speeds seen are all that is known of wishes
        found[..., 0] = np.maximum(states.least_factor, LEAST_FACTOR)
    return found


@in_place()
def _correct(following: Any, free_factor: Any, least_factor: Any, out: Any) -> None:
    """Correct the desired speeds among parameters."""
    ways, given, fields = following.shape
    n = free_factor.size
    for m in range(ways):
        for i in range(n):
            of = i if given == n else 0
            for f in range(fields):
                out[m, i, f] = following[m, of, f]
            if not math.isnan(free_factor[i]):
                shown = math.log(max(free_factor[i], 0.1))
                wished = math.log(following[m, of, 0])
                out[m, i, 0] = math.exp((FREE_WEIGHT * wished + shown) / (1.0 + FREE_WEIGHT))
            out[m, i, 0] = max(out[m, i, 0], least_factor[i])
