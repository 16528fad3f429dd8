"""Populations of drivers as data: what a file says, which ones ship, and drivers drawn from one.

A population is a log-normal distribution of the numbers that recordings show. Files are written by
``graphrqi calibrate``.

With ``around = "population"``, the six behaviours are moved into the population. Their order in
every number is that of the profiles. One factor per number scales their distances. Drivers of all
six in equal shares then have the population's median and spread. `BETWEEN` of the variance lies
between behaviours, the rest within them. Within a behaviour, numbers correlate as the population
says. The desired speed of a recording depends on its unknown limit. Only its spread and its
correlations are used, around the behaviours' speed factors.

With ``around = "profiles"``, each behaviour is drawn around its profile, with the whole of the
population's spread.
"""

from __future__ import annotations

import dataclasses
import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.elementwise import exponential, logarithm
from behaviors.errors import InputError, in_file, lookup
from behaviors.labels import BEHAVIORS, PROFILES, Behavior
from behaviors.profiles import FARTHEST_SPREADS, SPREAD_FIELDS, Profile
from behaviors.row_index import FloatArray
from behaviors.toml_files import read_toml, shipped_or_path

BELIEVED: Final[dict[str, tuple[float, float]]] = {
    "desired_speed_mps": (1.0, 100.0),
    "time_headway_s": (0.1, 10.0),
    "min_gap_m": (0.1, 20.0),
    "max_accel_mps2": (0.1, 10.0),
    "comfort_decel_mps2": (0.1, 10.0),
}
"""Least and greatest median that a file may give (our choice: pedestrians to racing cars)."""

NUMBERS: Final = tuple(BELIEVED)
"""A driver's numbers that recordings show, in the order of a population's arrays."""

POPULATION_FIELDS: Final = ("speed_factor", *NUMBERS[1:])
"""The profile's fields that a population gives, in the same order."""

MOST_SPREAD: Final = 3.0
"""Largest log-normal spread that is believed (our choice: two thirds are within a factor of 20)."""

BETWEEN: Final = 0.5
"""Share of a recorded population's variance that lies between the behaviours (our choice: behaviour
and person count alike)."""

FARTHEST: Final = 3.0
"""Largest distance of a drawn number from its median, in spreads (our choice: 1.4 % of all drivers
are drawn again)."""

LOWEST_HEADWAY_S: Final = 0.35
"""Shortest headway that is drawn, s: with shorter ones vehicles collide (Krauss's law needs more
than a step)."""

MOST_DRAWS, AT_ONCE = 10_000, 16
"""Most draws for one driver, and how many are made together."""

TEXTS: Final = ("name", "source", "law")
"""Texts of a file."""

POPULATIONS: Final = {
    path.stem: path
    for path in sorted(Path(__file__).with_name("shipped").glob("populations/*.toml"))
}
"""The files that ship, by name."""


class Around(StrEnum):
    """Where the six behaviours' drivers are drawn; see the module."""

    POPULATION = "population"
    PROFILES = "profiles"


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
        with in_file(f"population {self.name}"):
            for name in ("median", "log_spread", "correlation"):
                array = np.array(getattr(self, name), dtype=np.float64)
                if not np.isfinite(array).all():
                    raise InputError(f"{name}: found numbers that are not finite")
                array.flags.writeable = False
                object.__setattr__(self, name, array)
            for k, name in enumerate(NUMBERS):
                _check_range(f"{name}.median", self.median[k], *BELIEVED[name])
                _check_range(f"{name}.log_spread", self.log_spread[k], 0.0, MOST_SPREAD)
            given = self.correlation
            ones = np.allclose(np.diag(given), 1.0, atol=1e-6)
            even = np.allclose(given, given.T, atol=1e-6)
            if not ones or not even or np.linalg.eigvalsh(given)[0] < -1e-6:
                raise InputError(
                    "correlation: found not a correlation matrix, expected a symmetric one with "
                    "ones on its diagonal and no negative eigenvalue"
                )

    def draw(self, behavior: Behavior, rng: np.random.Generator, spread: float) -> Profile:
        """One driver of a behaviour.

        Draws beyond `FARTHEST` spreads (`FARTHEST_SPREADS` for the profile's other numbers, whose
        log-normal spread is ``spread``) are drawn again; so are headways below `LOWEST_HEADWAY_S`.
        """
        centre, (_, within, root) = _centre_of(self, behavior), _distribution(self)
        for _ in range(0, MOST_DRAWS, AT_ONCE):
            z = rng.standard_normal((AT_ONCE, centre.size)) @ root.T
            numbers = exponential(centre + within * z)
            good = (np.abs(z) <= FARTHEST).all(axis=1)
            good &= numbers[:, NUMBERS.index("time_headway_s")] >= LOWEST_HEADWAY_S
            if good.any():
                return _driver(behavior.profile, numbers[int(good.argmax())], rng, spread)
        raise InputError(
            f"population {self.name}: time_headway_s: found no {behavior} driver with "
            f"{LOWEST_HEADWAY_S:g} s or more, expected a larger median or another spread"
        )

    @property
    def option(self) -> dict[str, str]:
        """The population's name and the checksum of its file, as an episode stores them."""
        return {"name": self.name, "sha256": hashlib.sha256(self.to_toml().encode()).hexdigest()}

    def table(self) -> dict[str, Any]:
        """The content of its file, numbers to six digits."""
        return tomllib.loads(self.to_toml())

    def to_toml(self) -> str:
        """The text of its file."""
        lines = [
            "schema_version = 1",
            *(f'{key} = "{_plain(getattr(self, key))}"' for key in TEXTS),
            f"drivers = {self.drivers}",
            f'around = "{self.around}"',
        ]
        for k, name in enumerate(NUMBERS):
            lines += [
                "",
                f"[numbers.{name}]",
                f"median = {self.median[k]:.6g}",
                f"log_spread = {self.log_spread[k]:.6g}",
                f"correlation = [{', '.join(f'{value:.6f}' for value in self.correlation[k])}]",
            ]
        return "\n".join([*lines, ""])


def _check_range(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise InputError(f"{name}: found {value:g}, expected {least:g} to {most:g}")


@lru_cache(maxsize=32)
def _distribution(population: Population) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(6, 5) logarithms of the median drivers; spread and root of the correlation within each."""
    own = logarithm([[getattr(PROFILES[b], n) for n in POPULATION_FIELDS] for b in BEHAVIORS])
    centre, within = own.copy(), population.log_spread.copy()
    if population.around is Around.POPULATION:
        middle, apart = own.mean(axis=0), own.std(axis=0)
        centre = middle + (own - middle) / apart * np.sqrt(BETWEEN) * population.log_spread
        told = slice(1, None)  # all but the speed factor, whose middle stays that of the profiles
        centre[:, told] += logarithm(population.median[told]) - middle[told]
        within *= np.sqrt(1.0 - BETWEEN)
    values, vectors = np.linalg.eigh(population.correlation)
    return centre, within, vectors * np.sqrt(np.maximum(values, 0.0))


def _centre_of(population: Population, behavior: Behavior) -> FloatArray:
    """(5,) logarithms of the median driver; one's own keeps its distance from that it is like."""
    own, like = (
        logarithm([getattr(profile, name) for name in POPULATION_FIELDS])
        for profile in (behavior.profile, PROFILES[behavior.base])
    )
    centre: FloatArray = _distribution(population)[0][behavior.base.code] + (own - like)
    return centre


def _driver(
    profile: Profile, numbers: FloatArray, rng: np.random.Generator, spread: float
) -> Profile:
    """A driver of a population's numbers, whose others are drawn around the profile."""
    names = [name for name in SPREAD_FIELDS if name not in POPULATION_FIELDS]
    z = rng.standard_normal(len(names))
    while (far := np.abs(z) > FARTHEST_SPREADS).any():
        z[far] = rng.standard_normal(int(far.sum()))
    factors = exponential(spread * z)
    drawn = {n: float(getattr(profile, n) * f) for n, f in zip(names, factors, strict=True)}
    given = dict(zip(POPULATION_FIELDS, numbers.tolist(), strict=True))
    return dataclasses.replace(profile, **given, **drawn)


def _plain(text: str) -> str:
    """A text that TOML can hold between quotes."""
    return "".join(c if c.isprintable() and c not in '"\\' else "_" for c in text)


def read_population(source: str | Path | Mapping[str, Any] | Population) -> Population:
    """A population by the name of one that ships, from a file, or from a table.

    Numbers count to six digits, so that equal files draw equal drivers.

    Args:
        source: a key of `POPULATIONS`; the path of a TOML file, which has a dot or a slash in it;
            or what such a file says.

    Raises:
        InputError: if it is missing or broken; the message names the file and the key.

    Examples:
        >>> read_population("profiles").log_spread.tolist()
        [0.15, 0.15, 0.15, 0.15, 0.15]
    """
    if isinstance(source, Population):
        return source
    if isinstance(source, Mapping):
        with in_file("population"):
            return _of_table(source)
    if not isinstance(source, str | Path) or not str(source):
        raise InputError(f"population: found {source!r:.60}, expected a name or a file")
    path = shipped_or_path(source, POPULATIONS, "population")
    with in_file(path):
        return _of_table(read_toml(path))


def _of_table(table: Mapping[str, Any]) -> Population:
    """The population that a table describes, as `Population.table` gives it."""
    said: dict[str, Any] = {"schema_version": None, "drivers": 0, "around": "population"}
    for key in table:
        lookup({**said, **dict.fromkeys((*TEXTS, "numbers"))}, key, "key")
    said |= table
    for key, values in (("schema_version", [1]), ("around", [*Around])):
        if said[key] not in values:
            expected = " or ".join(map(str, values))
            raise InputError(f"{key}: found {said[key]!r:.60}, expected {expected}")
    if not isinstance(said["drivers"], int):
        raise InputError(f"drivers: found {said['drivers']!r:.60}, expected a whole number")
    name, source, law = (_plain(str(said.get(key, ""))[:500]) for key in TEXTS)
    numbers = [_number(said.get("numbers"), key) for key in NUMBERS]
    median, spread, correlation = (np.array(values) for values in zip(*numbers, strict=True))
    around = Around(said["around"])
    return Population(name, source, law, said["drivers"], median, spread, correlation, around)


def _number(numbers: Any, name: str) -> tuple[float, float, list[float]]:
    """Median, spread and correlations of one number, to six digits."""
    said = numbers.get(name) if isinstance(numbers, Mapping) else None
    if not isinstance(said, Mapping):
        raise InputError(f"numbers.{name}: found none, expected a table of that name")
    try:
        median, spread = (float(f"{said[key]:.6g}") for key in ("median", "log_spread"))
        correlation = [round(float(value), 6) for value in said["correlation"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"numbers.{name}: {error!s:.80}, expected numbers") from None
    if len(correlation) != len(NUMBERS):
        expected = f"{len(NUMBERS)} numbers, in the order {', '.join(NUMBERS)}"
        raise InputError(f"numbers.{name}.correlation: found {correlation}, expected {expected}")
    return median, spread, correlation
