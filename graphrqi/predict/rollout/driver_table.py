"""How drivers of each behaviour drive, as numbers of the rollout's car-following law.

The numbers are calibrated on training episodes (`graphrqi.predict.training.calibrate`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.labels import BEHAVIORS, PROFILES
from graphrqi.arrays import BoolArray, FloatArray
from graphrqi.networks.weights import restored, save_weights
from graphrqi.predict.scene.scene import Scene

DRIVER_FIELDS: Final = (
    "speed_factor",
    "time_headway_s",
    "min_gap_m",
    "max_accel_mps2",
    "decel_mps2",
)
"""Columns of a driver's numbers in the rollout."""

KIND: Final = "drivers"
"""The kind of the numbers' file, see `graphrqi.networks.weights`."""

SHIPPED: Final = Path(__file__).parent.parent / "weights" / "drivers.safetensors"
"""The calibrated numbers that ship, with their card."""


FREE_WEIGHT: Final = 0.1
"""Weight of the behaviour's desired speed against the driver's observed free speed."""

LEAST_FACTOR: Final = 0.05
"""Least desired speed over limit where limits are unknown (the driver models divide by it)."""


@dataclass(frozen=True, slots=True)
class DriverTable:
    """Calibrated numbers.

    Attributes:
        behavior: (6, 5) numbers of each behaviour.
        average: (5,) numbers of the one average driver.
        decay_s: decay time of the residual acceleration, s.
        average_decay_s: the average driver's, s.
    """

    behavior: FloatArray
    average: FloatArray
    decay_s: float
    average_decay_s: float

    def expected(self, probability: FloatArray) -> FloatArray:
        """(n, 5) numbers expected under (n, 6) beliefs: geometric means, as scales combine."""
        return np.asarray(np.exp(probability @ np.log(self.behavior)), dtype=np.float64)


RUNS_RED: Final[FloatArray] = np.array([PROFILES[b].red_run_probability for b in BEHAVIORS])
"""(6,) chance that a driver of each behaviour runs a red light."""

YIELDS: Final[FloatArray] = np.array([PROFILES[b].yield_probability for b in BEHAVIORS])
"""(6,) chance that a driver of each behaviour lets pedestrians go first."""


def initial_table() -> DriverTable:
    """The profiles' own numbers: where calibration starts."""
    rows = np.array(
        [
            [p.speed_factor, p.time_headway_s, p.min_gap_m, p.max_accel_mps2, p.comfort_decel_mps2]
            for p in (PROFILES[b] for b in BEHAVIORS)
        ]
    )
    return DriverTable(rows, np.exp(np.log(rows).mean(axis=0)), 2.0, 2.0)


def save_table(path: Path, table: DriverTable, card: dict[str, Any]) -> None:
    """Write the table with its card (data, split, scores)."""
    about = {name: getattr(table, name) for name in ("decay_s", "average_decay_s")}
    arrays = {"behavior": table.behavior.round(4), "average": table.average.round(4)}
    save_weights(path, KIND, {"card": card, **about}, arrays)


@functools.cache
def load_table(path: Path = SHIPPED) -> DriverTable:
    """The numbers that ship in the package, or those of another file.

    Raises:
        InputError: if the file is missing, broken, of another kind or of another version.
    """
    return restored(
        path,
        KIND,
        lambda about, arrays: DriverTable(
            arrays["behavior"], arrays["average"], about["decay_s"], about["average_decay_s"]
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DriverParameters:
    """How n drivers drive, or (M, n).

    Attributes:
        following: (..., 5) car-following parameters, columns as ``DRIVER_FIELDS``.
        ignores: (..., 2) whether each ignores red lights, and pedestrians at crossings.
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


def parameters_of_each(scene: Scene, table: DriverTable) -> DriverParameters:
    """The parameters of (6, n) drivers: of each under each behaviour."""
    each = (len(BEHAVIORS), scene.ids.size)
    runs, yields = (np.broadcast_to(x[:, None], each) for x in (RUNS_RED, YIELDS))
    return DriverParameters(_personal(scene, table.behavior[:, None]), _ignored(runs, yields))


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
