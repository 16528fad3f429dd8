"""Drivers drawn from a population: each behaviour keeps its place in it, and numbers correlate.

Where a population was told from recordings (``around = "population"``), the six behaviours are
moved into it. Their order in every number is that of the profiles, and their distances shrink or
grow by one factor for each number, so that drivers of all six in equal shares have the population's
median and spread together: `BETWEEN` of the variance lies between behaviours and the rest within
them. Within a behaviour, numbers correlate as the population says. The desired speed of a recording
depends on its limit, which no population tells: only its spread and its correlations count, around
the behaviours' speed factors.

With ``around = "profiles"``, each behaviour is drawn around its profile, with the whole of the
population's spread.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.elementwise import exponential, logarithm
from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from behaviors.populations.population import Around, Population
from behaviors.profiles import FARTHEST_SPREADS, PROFILES, SPREAD_FIELDS, Profile

FloatArray = NDArray[np.float64]

POPULATION_TOLD: Final = (
    "speed_factor",
    "time_headway_s",
    "min_gap_m",
    "max_accel_mps2",
    "comfort_decel_mps2",
)
"""The profile's fields that a population tells, in the order of its arrays."""

BETWEEN: Final = 0.5
"""Share of a recorded population's variance that lies between the behaviours (our choice: of two
reasons for which drivers differ, behaviour and person, none counts more)."""

FARTHEST: Final = 3.0
"""Largest distance of a drawn number from its median, in spreads (our choice: 1.4 % of all drivers
are drawn again)."""

LOWEST_HEADWAY_S: Final = 0.35
"""Shortest headway that is drawn, s: with shorter ones vehicles collide (Krauss's law needs more
than a step)."""

MOST_DRAWS: Final = 10_000
"""Most draws for one driver; a population whose drivers need more is refused (a median is allowed
half of them)."""

_AT_ONCE: Final = 16


@dataclass(frozen=True, slots=True, eq=False)
class DriverSource:
    """What drivers of each behaviour are drawn from.

    Attributes:
        population: where it comes from.
        centre: (6, 5) logarithms of the median driver of each behaviour, columns as
            `POPULATION_TOLD`.
        spread: (5,) log-normal spread within a behaviour.
        root: (5, 5) a root of the correlation within a behaviour.
    """

    population: Population
    centre: FloatArray
    spread: FloatArray
    root: FloatArray

    def median(self, behavior: Behavior) -> Profile:
        """The median driver of a behaviour; what the population does not tell is the profile's."""
        return _replaced(PROFILES[behavior], exponential(self.centre[BEHAVIORS.index(behavior)]))

    def draw(self, behavior: Behavior, rng: np.random.Generator, spread: float) -> Profile:
        """One driver of a behaviour.

        Args:
            behavior: the class to draw from.
            rng: source of randomness; how much of it is used depends on the draws.
            spread: of the numbers that the population does not tell.

        Returns:
            The driver's own profile. Draws beyond `FARTHEST` spreads, or beyond
            `FARTHEST_SPREADS` of the numbers that the population does not tell, are drawn again,
            so that nobody stands at a cut.

        Raises:
            InputError: if nobody is found (see `LOWEST_HEADWAY_S`).
        """
        centre = self.centre[BEHAVIORS.index(behavior)]
        for _ in range(0, MOST_DRAWS, _AT_ONCE):
            z = rng.standard_normal((_AT_ONCE, centre.size)) @ self.root.T
            told = exponential(centre + self.spread * z)
            good = (np.abs(z) <= FARTHEST).all(axis=1)
            good &= told[:, POPULATION_TOLD.index("time_headway_s")] >= LOWEST_HEADWAY_S
            if good.any():
                found = _replaced(PROFILES[behavior], told[int(good.argmax())])
                return _varied(found, rng, spread)
        raise InputError(
            f"population {self.population.name}: time_headway_s: found no {behavior} driver with "
            f"{LOWEST_HEADWAY_S:g} s or more, expected a larger median or another spread"
        )


@lru_cache(maxsize=32)
def drivers_of(population: Population) -> DriverSource:
    """What drivers of a population are drawn from.

    Examples:
        >>> from behaviors.populations import read_population
        >>> source = drivers_of(read_population("profiles"))
        >>> round(source.median(Behavior.TIMID).time_headway_s, 6)
        2.9
    """
    own = logarithm([[getattr(PROFILES[b], n) for n in POPULATION_TOLD] for b in BEHAVIORS])
    centre, within = own.copy(), population.log_spread.copy()
    if population.around is Around.POPULATION:
        middle, apart = own.mean(axis=0), own.std(axis=0)
        centre = middle + (own - middle) / apart * np.sqrt(BETWEEN) * population.log_spread
        told = slice(1, None)  # all but the speed factor, whose middle stays that of the profiles
        centre[:, told] += logarithm(population.median[told]) - middle[told]
        within *= np.sqrt(1.0 - BETWEEN)
    values, vectors = np.linalg.eigh(population.correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    for array in (centre, within, root):
        array.flags.writeable = False
    return DriverSource(population, centre, within, root)


def _replaced(profile: Profile, told: FloatArray) -> Profile:
    numbers = {name: float(value) for name, value in zip(POPULATION_TOLD, told, strict=True)}
    return dataclasses.replace(profile, **numbers)


def _varied(profile: Profile, rng: np.random.Generator, spread: float) -> Profile:
    """The driver with its own numbers where the population tells none."""
    names = [name for name in SPREAD_FIELDS if name not in POPULATION_TOLD]
    z = rng.standard_normal(len(names))
    while (far := np.abs(z) > FARTHEST_SPREADS).any():
        z[far] = rng.standard_normal(int(far.sum()))
    factors = exponential(spread * z)
    drawn = {n: float(getattr(profile, n) * f) for n, f in zip(names, factors, strict=True)}
    return dataclasses.replace(profile, **drawn)
