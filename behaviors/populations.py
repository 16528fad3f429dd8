"""Populations of drivers as data: correlated car-following numbers, written as TOML.

A population is a log-normal distribution of the numbers that recordings can tell. Files are written
by ``graphrqi calibrate``.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erf, log, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError

FloatArray = NDArray[np.float64]

NUMBERS: Final = (
    "desired_speed_mps",
    "time_headway_s",
    "min_gap_m",
    "max_accel_mps2",
    "comfort_decel_mps2",
)
"""What recordings tell of a driver, in the order of a population's arrays."""

SCHEMA_VERSION: Final = 1

MOST_SPREAD: Final = 3.0
"""Largest log-normal spread that is believed (our choice: two thirds are within a factor of 20)."""


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """A log-normal distribution of drivers' numbers.

    Attributes:
        name: of what was calibrated.
        source: what it was calibrated on, in words.
        law: the car-following law that the numbers are of.
        drivers: how many drivers it rests on.
        median: (5,) medians of ``NUMBERS``.
        log_spread: (5,) standard deviations of their logarithms.
        correlation: (5, 5) of the logarithms.
    """

    name: str
    source: str
    law: str
    drivers: int
    median: FloatArray
    log_spread: FloatArray
    correlation: FloatArray

    def __post_init__(self) -> None:
        """Refuse what is no distribution."""
        for name, shape in (("median", (5,)), ("log_spread", (5,)), ("correlation", (5, 5))):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(
                    f"population {self.name}: {name}: found shape {array.shape}, expected "
                    f"{shape} of finite numbers"
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if not (self.median > 0).all():
            raise InputError(f"population {self.name}: median: found {self.median.min():g}, "
                             "expected numbers > 0")  # fmt: skip
        if not ((self.log_spread >= 0) & (self.log_spread <= MOST_SPREAD)).all():
            raise InputError(
                f"population {self.name}: log_spread: found {self.log_spread.max():g}, expected 0 "
                f"to {MOST_SPREAD:g}"
            )
        symmetric = np.allclose(self.correlation, self.correlation.T, atol=1e-6)
        ones = np.allclose(np.diag(self.correlation), 1.0, atol=1e-6)
        if not symmetric or not ones or np.linalg.eigvalsh(self.correlation)[0] < -1e-6:
            raise InputError(
                f"population {self.name}: correlation: found no correlation matrix, expected a "
                "symmetric one with ones on its diagonal and no negative eigenvalue"
            )

    def quantile(self, name: str, value: float) -> float:
        """At which quantile of the population a number lies, 0 to 1."""
        k = NUMBERS.index(name)
        z = log(value / self.median[k]) / max(float(self.log_spread[k]), 1e-12)
        return 0.5 * (1.0 + erf(z / sqrt(2.0)))

    def to_toml(self) -> str:
        """The text of its file."""
        lines = [
            f"schema_version = {SCHEMA_VERSION}",
            f"name = {_quoted(self.name)}",
            f"source = {_quoted(self.source)}",
            f"law = {_quoted(self.law)}",
            f"drivers = {self.drivers}",
            "",
        ]
        for k, name in enumerate(NUMBERS):
            lines += [
                f"[numbers.{name}]",
                f"median = {float(self.median[k]):.6g}",
                f"log_spread = {float(self.log_spread[k]):.6g}",
                "correlation = ["
                + ", ".join(f"{float(value):.6f}" for value in self.correlation[k])
                + "]",
                "",
            ]
        return "\n".join(lines)


def _quoted(text: str) -> str:
    kept = "".join(c if c.isprintable() and c not in '"\\' else "_" for c in text)
    return f'"{kept}"'
