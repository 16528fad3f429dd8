"""Populations of drivers as data: correlated car-following numbers, read from TOML.

A population is a log-normal distribution of the numbers that recordings can tell. Files are written
by ``graphrqi calibrate``. Drivers of a population keep their behaviours: behaviours differ in where
in the population their drivers lie.
"""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from behaviors.profiles import PROFILES, Profile

FloatArray = NDArray[np.float64]

NUMBERS: Final = (
    "desired_speed_mps",
    "time_headway_s",
    "min_gap_m",
    "max_accel_mps2",
    "comfort_decel_mps2",
)
"""What recordings tell of a driver, in the order of a population's arrays."""

REBASED: Final = NUMBERS[1:]
"""Numbers that a population gives to a `Profile`; the desired speed depends on the road, so drivers
keep their behaviour's multiple of the limit."""

SCHEMA_VERSION: Final = 1

BEHAVIOR_SHARE: Final = 0.7
"""Share of a population's variance that lies between the six behaviours, the rest within them (our
choice: in the profiles it is .8 of the variance of the time headway, and .6 of the gap)."""

MOST_SPREAD: Final = 3.0
"""Largest log-normal spread that is believed (our choice: two thirds are within a factor of 20)."""


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """A log-normal distribution of drivers' numbers.

    Attributes:
        name: what it is called in datasets.
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

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """(count, 5) numbers of drivers.

        Examples:
            >>> people = Population(
            ...     "road", "an example", "idm", 60, np.array([30.0, 1.3, 2.5, 1.2, 2.0]),
            ...     np.full(5, 0.3), np.eye(5),
            ... )
            >>> people.draw(np.random.default_rng(0), 4).shape
            (4, 5)
        """
        z = rng.standard_normal((count, len(NUMBERS))) @ _root(self.correlation).T
        return np.asarray(self.median * np.exp(self.log_spread * z))

    def quantile(self, name: str, value: float) -> float:
        """At which quantile of the population a number lies, 0 to 1."""
        from math import erf, log, sqrt

        k = NUMBERS.index(name)
        z = log(value / self.median[k]) / max(float(self.log_spread[k]), 1e-12)
        return 0.5 * (1.0 + erf(z / sqrt(2.0)))

    def rebased(self, profile: Profile, behavior: Behavior, rng: np.random.Generator) -> Profile:
        """The profile of a driver of this population who has a behaviour.

        Its place in the population is that of its behaviour's median among the six, and its own
        deviation, which is correlated as in the population.

        Args:
            profile: as drawn for the behaviour; numbers that recordings do not tell are kept.
            behavior: the driver's.
            rng: source of randomness.

        Returns:
            The profile with the numbers in `REBASED` replaced.
        """
        own = _root(self.correlation) @ rng.standard_normal(len(NUMBERS))
        place = _PLACES[BEHAVIORS.index(behavior)]
        z = BEHAVIOR_SHARE**0.5 * place + (1.0 - BEHAVIOR_SHARE) ** 0.5 * own[1:]
        numbers = self.median[1:] * np.exp(self.log_spread[1:] * z)
        return dataclasses.replace(profile, **dict(zip(REBASED, map(float, numbers), strict=True)))

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


def _root(correlation: FloatArray) -> FloatArray:
    """(5, 5) a matrix whose product with its transpose is the correlation."""
    values, vectors = np.linalg.eigh(correlation)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _places() -> FloatArray:
    """(6, 4) where each behaviour's median lies among the six, in standard deviations."""
    logs = np.log([[getattr(PROFILES[b], name) for name in REBASED] for b in BEHAVIORS])
    return np.asarray((logs - logs.mean(axis=0)) / logs.std(axis=0))


_PLACES: Final = _places()


def read_population(source: str | Path) -> Population:
    """The population in a file.

    Args:
        source: the path of a TOML file, as ``graphrqi calibrate`` writes it.

    Raises:
        InputError: if there is none, or the file is broken; the message names file and field.
    """
    path = Path(source)
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected a population's TOML")
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: found no TOML ({error}), expected a population") from None
    return _parsed(found, path)


_KEYS: Final = {"schema_version": int, "name": str, "source": str, "law": str, "drivers": int}


def _parsed(found: dict[str, Any], path: Path) -> Population:
    """A population from what its file holds."""
    unknown = sorted(set(found) - {*_KEYS, "numbers"})
    if unknown:
        raise InputError(f"{path}: {unknown[0]}: found a field that no population has, expected "
                         f"{', '.join(_KEYS)} and numbers")  # fmt: skip
    for key, kind in _KEYS.items():
        if type(found.get(key)) is not kind:
            raise InputError(
                f"{path}: {key}: found {found.get(key)!r:.60}, expected {kind.__name__}"
            )
    if found["schema_version"] != SCHEMA_VERSION:
        raise InputError(
            f"{path}: schema_version: found {found['schema_version']}, expected {SCHEMA_VERSION}"
        )
    numbers = found.get("numbers")
    if not isinstance(numbers, dict) or set(numbers) != set(NUMBERS):
        raise InputError(f"{path}: numbers: found {sorted(numbers or ())!r:.80}, expected "
                         f"{', '.join(NUMBERS)}")  # fmt: skip
    median, spread, correlation = [], [], []
    for name in NUMBERS:
        entry = numbers[name]
        expected = {"median", "log_spread", "correlation"}
        if not isinstance(entry, dict) or set(entry) != expected:
            raise InputError(
                f"{path}: numbers.{name}: found {entry!r:.60}, expected median, log_spread and "
                "correlation"
            )
        row = entry["correlation"]
        values = [entry["median"], entry["log_spread"], *(row if isinstance(row, list) else [None])]
        if len(values) != 2 + len(NUMBERS) or not all(type(v) in (int, float) for v in values):
            raise InputError(
                f"{path}: numbers.{name}: found {values!r:.60}, expected a median, a log_spread "
                f"and {len(NUMBERS)} correlations"
            )
        median.append(values[0])
        spread.append(values[1])
        correlation.append(values[2:])
    return Population(
        name=found["name"], source=found["source"], law=found["law"], drivers=found["drivers"],
        median=np.array(median), log_spread=np.array(spread), correlation=np.array(correlation),
    )  # fmt: skip
