"""How each driver of a scene is taken to drive in a rollout, given who it is believed to be."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS, Style
from graphrqi.predict.rollout import driver_parameters_kernel
from graphrqi.predict.rollout.driver_table import RUNS_RED, YIELDS, DriverTable
from graphrqi.predict.scene.scene import Scene

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FREE_WEIGHT: Final = 0.1
"""Weight of what a driver's behaviour says of its wished speed against seeing it drive freely (our
choice: within a behaviour wishes differ by 15 %, a driver's own by little)."""

AGGRESSIVE: Final = np.array([b.style is Style.AGGRESSIVE for b in BEHAVIORS], dtype=np.float64)
"""(6,) 1 for the aggressive behaviours."""


@dataclass(frozen=True, slots=True, eq=False)
class DriverParameters:
    """How n drivers drive.

    Attributes:
        following: (n, 5) car-following numbers, columns as ``drivers.DRIVER_FIELDS``.
        changing: (n, 4) lane-changing numbers, columns as ``drivers.CHANGING_FIELDS``; (0, 4):
            nobody changes lanes.
        ignores: (n, R) whether each ignores each gate of the scene.
        wary: (n,) how far each keeps away from those who are feared, 0 to 1.
        feared: (n,) how far each is kept away from, 0 to 1.
    """

    following: FloatArray
    changing: FloatArray
    ignores: BoolArray
    wary: FloatArray
    feared: FloatArray


def believed(scene: Scene, probability: FloatArray, table: DriverTable) -> DriverParameters:
    """The manners expected under (n, 6) beliefs about who drives how."""
    following = personal(scene, table.expected(probability)[None])[0]
    return DriverParameters(
        following=following,
        changing=table.changing(probability),
        ignores=ignored_gates(scene, probability),
        wary=np.zeros(len(following)),
        feared=np.zeros(len(following)),
    )


def wary(manners: DriverParameters, probability: FloatArray) -> DriverParameters:
    """The same, but conservative drivers keep away from neighbours believed to be aggressive.

    They keep a longer headway behind them (twice as long at full certainty) and prefer lanes
    without them (worth 1 m/s2 at full certainty).
    """
    aggressive = probability @ AGGRESSIVE
    return dataclasses.replace(manners, wary=1.0 - aggressive, feared=aggressive)


def if_each(scene: Scene, table: DriverTable) -> tuple[FloatArray, BoolArray]:
    """(6, n, 5) how everyone would follow if it were of each behaviour; (6, n, R) gates ignored."""
    each = (len(BEHAVIORS), scene.ids.size)
    runs, yields = (np.broadcast_to(x[:, None], each) for x in (RUNS_RED, YIELDS))
    return personal(scene, table.behavior[:, None]), gates_ignored(scene, runs, yields)


def average(scene: Scene, table: DriverTable) -> DriverParameters:
    """Everyone drives as the average driver does."""
    n = scene.ids.size
    unknown = np.full((n, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
    return DriverParameters(
        following=personal(scene, table.average[None, None])[0],
        changing=table.changing(unknown),
        ignores=np.zeros((n, scene.closed.shape[0]), dtype=np.bool_),
        wary=np.zeros(n),
        feared=np.zeros(n),
    )


def ignored_gates(scene: Scene, probability: FloatArray) -> BoolArray:
    """(n, R) gates that drivers more likely run than respect, under (n, 6) beliefs."""
    return gates_ignored(scene, probability @ RUNS_RED, probability @ YIELDS)


def gates_ignored(scene: Scene, runs_red: FloatArray, yields: FloatArray) -> BoolArray:
    """(..., n, R) gates ignored by who runs red lights and yields with chances (..., n)."""
    groups = scene.paths.groups
    crossings = groups + scene.graph.cross_lane.size
    ignores = np.zeros((*runs_red.shape, scene.closed.shape[0]), dtype=np.bool_)
    ignores[..., :groups] = (runs_red > 0.5)[..., None]
    ignores[..., groups:crossings] = (yields < 0.5)[..., None]
    return ignores


def personal(scene: Scene, following: FloatArray) -> FloatArray:
    """Numbers (M, n or 1, 5), each of n drivers' wished speed corrected by what it has driven."""
    seen = scene.seen
    return np.asarray(
        driver_parameters_kernel.personal(
            following, seen.free_factor, seen.least_factor, FREE_WEIGHT
        )
    )
