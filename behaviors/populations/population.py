"""A population of drivers: correlated car-following numbers, as a table and as TOML.

A population is a log-normal distribution of the numbers that recordings show. Files are written by
``graphrqi calibrate``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import erf, log, sqrt
from typing import Any, Final

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
"""A driver's numbers that recordings show, in the order of a population's arrays."""

SCHEMA_VERSION: Final = 1

BELIEVED: Final[dict[str, tuple[float, float]]] = {
    "desired_speed_mps": (1.0, 100.0),
    "time_headway_s": (0.1, 10.0),
    "min_gap_m": (0.1, 20.0),
    "max_accel_mps2": (0.1, 10.0),
    "comfort_decel_mps2": (0.1, 10.0),
}
"""Least and greatest median that a file may give (our choice: pedestrians to racing cars)."""

MOST_TEXT: Final = 500
"""Most characters of a name or a source."""

_KEYS: Final = ("schema_version", "name", "source", "law", "drivers", "around", "numbers")
_NUMBER_KEYS: Final = ("median", "log_spread", "correlation")


class Around(StrEnum):
    """Where the six behaviours' drivers are drawn."""

    POPULATION = "population"
    """The behaviours are moved into the population: all six together have its medians and
    spreads."""

    PROFILES = "profiles"
    """Each behaviour's drivers lie around its profile, with the population's whole spread."""


MOST_SPREAD: Final = 3.0
"""Largest log-normal spread that is believed (our choice: two thirds are within a factor of 20)."""


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """A log-normal distribution of drivers' numbers.

    Attributes:
        name: its name.
        source: its data, in words.
        law: the car-following law.
        drivers: how many were calibrated.
        median: (5,) medians of ``NUMBERS``.
        log_spread: (5,) standard deviations of their logarithms.
        correlation: (5, 5) of the logarithms.
        around: the centre of the behaviours.
    """

    name: str
    source: str
    law: str
    drivers: int
    median: FloatArray
    log_spread: FloatArray
    correlation: FloatArray
    around: Around = Around.POPULATION

    def __post_init__(self) -> None:
        """Refuse arrays that do not form a distribution."""
        for name, shape in (("median", (5,)), ("log_spread", (5,)), ("correlation", (5, 5))):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise self._error(name, f"shape {array.shape}", f"{shape} of finite numbers")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if not (self.median > 0).all():
            raise self._error("median", f"{self.median.min():g}", "numbers > 0")
        if not ((self.log_spread >= 0) & (self.log_spread <= MOST_SPREAD)).all():
            raise self._error("log_spread", f"{self.log_spread.max():g}", f"0 to {MOST_SPREAD:g}")
        symmetric = np.allclose(self.correlation, self.correlation.T, atol=1e-6)
        ones = np.allclose(np.diag(self.correlation), 1.0, atol=1e-6)
        if not symmetric or not ones or np.linalg.eigvalsh(self.correlation)[0] < -1e-6:
            wanted = "a symmetric one with ones on its diagonal and no negative eigenvalue"
            raise self._error("correlation", "not a correlation matrix", wanted)

    def _error(self, name: str, found: str, expected: str) -> InputError:
        return InputError(f"population {self.name}: {name}: found {found}, expected {expected}")

    def quantile(self, name: str, value: float) -> float:
        """At which quantile of the population a number lies, 0 to 1."""
        k = NUMBERS.index(name)
        z = log(value / self.median[k]) / max(float(self.log_spread[k]), 1e-12)
        return 0.5 * (1.0 + erf(z / sqrt(2.0)))

    @property
    def sha256(self) -> str:
        """Checksum of its file as `to_toml` writes it."""
        return hashlib.sha256(self.to_toml().encode()).hexdigest()

    @property
    def option(self) -> dict[str, str]:
        """The population's name and checksum, as an episode stores them."""
        return {"name": self.name, "sha256": self.sha256}

    def table(self) -> dict[str, Any]:
        """The content of its file, numbers to six digits."""
        return {
            "schema_version": SCHEMA_VERSION,
            "name": _plain(self.name),
            "source": _plain(self.source),
            "law": _plain(self.law),
            "drivers": self.drivers,
            "around": str(self.around),
            "numbers": {
                name: {
                    "median": float(f"{self.median[k]:.6g}"),
                    "log_spread": float(f"{self.log_spread[k]:.6g}"),
                    "correlation": [round(float(value), 6) for value in self.correlation[k]],
                }
                for k, name in enumerate(NUMBERS)
            },
        }

    def to_toml(self) -> str:
        """The text of its file."""
        table = self.table()
        numbers = table.pop("numbers")
        lines = [
            f"{key} = {value}" if isinstance(value, int) else f'{key} = "{value}"'
            for key, value in table.items()
        ]
        for name, number in numbers.items():
            correlation = ", ".join(f"{value:.6f}" for value in number["correlation"])
            lines += [
                "",
                f"[numbers.{name}]",
                f"median = {number['median']:.6g}",
                f"log_spread = {number['log_spread']:.6g}",
                f"correlation = [{correlation}]",
            ]
        return "\n".join([*lines, ""])


def population_of(table: Mapping[str, Any]) -> Population:
    """The population that a table describes, as `Population.table` gives it.

    Numbers count to six digits, so that equal files draw equal drivers.

    Raises:
        InputError: if a key is missing, unknown or wrong; the message names it.

    Examples:
        >>> population_of({"schema_version": 1, "name": "road"})
        Traceback (most recent call last):
        ...
        behaviors.errors.InputError: source: found none, expected text
    """
    _check_keys("", table, _KEYS)
    version = table.get("schema_version")
    if version != SCHEMA_VERSION or isinstance(version, bool):
        raise InputError(f"schema_version: found {version!r:.60}, expected {SCHEMA_VERSION}")
    texts = {key: _text(table, key) for key in ("name", "source", "law")}
    drivers = table.get("drivers", 0)
    if not isinstance(drivers, int) or isinstance(drivers, bool) or not 0 <= drivers < 2**53:
        raise InputError(f"drivers: found {drivers!r:.60}, expected a whole number >= 0")
    around = table.get("around", str(Around.POPULATION))
    if around not in tuple(Around):
        raise InputError(f"around: found {around!r:.60}, expected {' or '.join(Around)}")
    numbers = table.get("numbers")
    if not isinstance(numbers, Mapping):
        raise InputError("numbers: found none, expected a table for each number")
    _check_keys("numbers.", numbers, NUMBERS)
    found = [_number(numbers, name) for name in NUMBERS]
    for name, (median, _, _) in zip(NUMBERS, found, strict=True):
        least, most = BELIEVED[name]
        if not least <= median <= most:
            raise InputError(
                f"numbers.{name}.median: found {median:g}, expected {least:g} to {most:g}"
            )
    return Population(
        **texts,
        drivers=drivers,
        median=np.array([median for median, _, _ in found]),
        log_spread=np.array([spread for _, spread, _ in found]),
        correlation=np.array([correlation for _, _, correlation in found]),
        around=Around(around),
    )


def _check_keys(prefix: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            raise InputError(
                f"{prefix}{key!s:.60}: found an unknown key, expected {', '.join(known)}"
            )


def _text(table: Mapping[str, Any], key: str) -> str:
    value = table.get(key)
    if value is None:
        raise InputError(f"{key}: found none, expected text")
    if not isinstance(value, str) or not 0 < len(value) <= MOST_TEXT:
        raise InputError(f"{key}: found {value!r:.60}, expected 1 to {MOST_TEXT} characters")
    return _plain(value)


def _number(numbers: Mapping[str, Any], name: str) -> tuple[float, float, list[float]]:
    """Median, spread and correlations of one number, to six digits."""
    where = f"numbers.{name}"
    entry = numbers.get(name)
    if not isinstance(entry, Mapping):
        raise InputError(f"{where}: found none, expected a table with {', '.join(_NUMBER_KEYS)}")
    _check_keys(f"{where}.", entry, _NUMBER_KEYS)
    median, spread = (
        float(f"{_finite(f'{where}.{key}', entry.get(key)):.6g}") for key in _NUMBER_KEYS[:2]
    )
    row = entry.get("correlation")
    if not isinstance(row, (list, tuple)) or len(row) != len(NUMBERS):
        raise InputError(
            f"{where}.correlation: found {row!r:.60}, expected {len(NUMBERS)} numbers, in the "
            f"order {', '.join(NUMBERS)}"
        )
    return median, spread, [round(_finite(f"{where}.correlation", value), 6) for value in row]


def _finite(where: str, value: object) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e9:
        raise InputError(f"{where}: found {value!r:.60}, expected a number")
    return float(value)


def _plain(text: str) -> str:
    """A text that TOML can hold between quotes."""
    return "".join(c if c.isprintable() and c not in '"\\' else "_" for c in text)
