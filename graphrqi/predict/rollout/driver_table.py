"""How drivers of each behaviour drive, as numbers of the rollout's car-following law.

The numbers are calibrated on training episodes (`graphrqi.predict.training.calibrate`).
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, PROFILES

FloatArray = NDArray[np.float64]

DRIVER_FIELDS: Final = (
    "speed_factor",
    "time_headway_s",
    "min_gap_m",
    "max_accel_mps2",
    "decel_mps2",
)
"""Columns of a driver's numbers in the rollout."""

CARD: Final = "drivers.json"
"""The calibrated numbers with their card, beside this module."""

SCHEMA_VERSION: Final = 2


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


def table_to_json(table: DriverTable, card: dict[str, Any]) -> str:
    """The table as the text of the package's file."""
    behavior = {
        str(b): dict(zip(DRIVER_FIELDS, map(float, row), strict=True))
        for b, row in zip(BEHAVIORS, table.behavior.round(4), strict=True)
    }
    data = {
        "schema_version": SCHEMA_VERSION,
        "card": card,
        "decay_s": round(table.decay_s, 3),
        "average_decay_s": round(table.average_decay_s, 3),
        "average": dict(zip(DRIVER_FIELDS, map(float, table.average.round(4)), strict=True)),
        "behavior": behavior,
    }
    return json.dumps(data, indent=2) + "\n"


def table_from_json(text: str, name: str) -> DriverTable:
    """The table in the text of a file.

    Raises:
        InputError: if it is not such a file, or a newer one.
    """
    try:
        data = json.loads(text)
        version = data["schema_version"]
        if version != SCHEMA_VERSION:
            raise InputError(f"{name}: schema_version: found {version}, expected {SCHEMA_VERSION}")
        return DriverTable(
            behavior=np.array(
                [[float(data["behavior"][b][f]) for f in DRIVER_FIELDS] for b in BEHAVIORS]
            ),
            average=np.array([float(data["average"][f]) for f in DRIVER_FIELDS]),
            decay_s=float(data["decay_s"]),
            average_decay_s=float(data["average_decay_s"]),
        )
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise InputError(
            f"{name}: expected calibrated drivers, found a broken file: {error}"
        ) from None


@functools.cache
def default_table() -> DriverTable:
    """The calibrated numbers that ship in the package."""
    text = resources.files("graphrqi.predict").joinpath("weights", CARD).read_text(encoding="utf-8")
    return table_from_json(text, CARD)
