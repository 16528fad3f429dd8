"""How drivers of each behaviour drive, as numbers of the rollout's car-following law.

The numbers are calibrated on training episodes (`graphrqi.predict.training.calibrate`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, PROFILES
from graphrqi.arrays import FloatArray
from graphrqi.networks.weights import load_weights, save_weights

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
    about, arrays = load_weights(path, KIND)
    try:
        return DriverTable(
            arrays["behavior"], arrays["average"], about["decay_s"], about["average_decay_s"]
        )
    except KeyError as error:
        raise InputError(f"{path}: found no {error}, expected calibrated drivers") from None
