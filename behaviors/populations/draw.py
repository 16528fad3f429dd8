"""Drivers drawn from a population: behaviours keep their order, and numbers correlate.

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
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.elementwise import exponential, logarithm
from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, PROFILES, Behavior
from behaviors.populations.population import Around, Population
from behaviors.profiles import FARTHEST_SPREADS, SPREAD_FIELDS, Profile

FloatArray = NDArray[np.float64]

POPULATION_FIELDS: Final = (
    "speed_factor",
    "time_headway_s",
    "min_gap_m",
    "max_accel_mps2",
    "comfort_decel_mps2",
)
"""The profile's fields that a population gives, in the order of its arrays."""

BETWEEN: Final = 0.5
"""Share of a recorded population's variance that lies between the behaviours (our choice: behaviour
and person count alike)."""

FARTHEST: Final = 3.0
"""Largest distance of a drawn number from its median, in spreads (our choice: 1.4 % of all drivers
are drawn again)."""

LOWEST_HEADWAY_S: Final = 0.35
"""Shortest headway that is drawn, s: with shorter ones vehicles collide (Krauss's law needs more
than a step)."""

MOST_DRAWS: Final = 10_000
"""Most draws for one driver; a population whose drivers need more is refused."""

_AT_ONCE: Final = 16


@dataclass(frozen=True, slots=True, eq=False)
class DriverSource:
    """The distribution of the drivers of each behaviour.

    Attributes:
        population: its population.
        centre: (6, 5) logarithms of the median drivers.
        spread: (5,) log-normal spread within a behaviour.
        root: (5, 5) a root of the correlation within a behaviour.
    """

    population: Population
    centre: FloatArray
    spread: FloatArray
    root: FloatArray

    def _centre_of(self, behavior: Behavior) -> FloatArray:
        """(5,) logarithms of its median driver.

        A behaviour of one's own keeps its distance from that of the six which it is like.
        """
        numbers = [
            logarithm([getattr(profile, name) for name in POPULATION_FIELDS])
            for profile in (behavior.profile, PROFILES[behavior.base])
        ]
        centre: FloatArray = self.centre[behavior.base.code] + (numbers[0] - numbers[1])
        return centre

    def median(self, behavior: Behavior) -> Profile:
        """The median driver of a behaviour; the profile fills what the population does not give."""
        return _replaced(behavior.profile, exponential(self._centre_of(behavior)))

    def draw(self, behavior: Behavior, rng: np.random.Generator, spread: float) -> Profile:
        """One driver of a behaviour.

        Args:
            behavior: the class to draw from.
            rng: source of randomness; the number of draws varies.
            spread: log-normal spread of the profile's other numbers.

        Returns:
            The driver's own profile. Draws beyond `FARTHEST` spreads (`FARTHEST_SPREADS` for the
            profile's other numbers) are drawn again.

        Raises:
            InputError: if no draw reaches `LOWEST_HEADWAY_S`.
        """
        centre = self._centre_of(behavior)
        for _ in range(0, MOST_DRAWS, _AT_ONCE):
            z = rng.standard_normal((_AT_ONCE, centre.size)) @ self.root.T
            numbers = exponential(centre + self.spread * z)
            good = (np.abs(z) <= FARTHEST).all(axis=1)
            good &= numbers[:, POPULATION_FIELDS.index("time_headway_s")] >= LOWEST_HEADWAY_S
            if good.any():
                found = _replaced(behavior.profile, numbers[int(good.argmax())])
                return _varied(found, rng, spread)
        raise InputError(
            f"population {self.population.name}: time_headway_s: found no {behavior} driver with "
            f"{LOWEST_HEADWAY_S:g} s or more, expected a larger median or another spread"
        )


@lru_cache(maxsize=32)
def drivers_of(population: Population) -> DriverSource:
    """The distribution that drivers of a population are drawn from.

    Examples:
        >>> from behaviors.populations import read_population
        >>> source = drivers_of(read_population("profiles"))
        >>> round(source.median(Behavior.TIMID).time_headway_s, 6)
        2.9
    """
    own = logarithm([[getattr(PROFILES[b], n) for n in POPULATION_FIELDS] for b in BEHAVIORS])
    centre, within = own.copy(), population.log_spread.copy()
    if population.around is Around.POPULATION:
        middle, apart = own.mean(axis=0), own.std(axis=0)
        centre = middle + (own - middle) / apart * np.sqrt(BETWEEN) * population.log_spread
        calibrated = slice(
            1, None
        )  # all but the speed factor, whose middle stays that of the profiles
        centre[:, calibrated] += logarithm(population.median[calibrated]) - middle[calibrated]
        within *= np.sqrt(1.0 - BETWEEN)
    values, vectors = np.linalg.eigh(population.correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    for array in (centre, within, root):
        array.flags.writeable = False
    return DriverSource(population, centre, within, root)


def _replaced(profile: Profile, values: FloatArray) -> Profile:
    numbers = {name: float(value) for name, value in zip(POPULATION_FIELDS, values, strict=True)}
    return dataclasses.replace(profile, **numbers)


def _varied(profile: Profile, rng: np.random.Generator, spread: float) -> Profile:
    """The driver with drawn values of the numbers that the population does not give."""
    names = [name for name in SPREAD_FIELDS if name not in POPULATION_FIELDS]
    z = rng.standard_normal(len(names))
    while (far := np.abs(z) > FARTHEST_SPREADS).any():
        z[far] = rng.standard_normal(int(far.sum()))
    factors = exponential(spread * z)
    drawn = {n: float(getattr(profile, n) * f) for n, f in zip(names, factors, strict=True)}
    return dataclasses.replace(profile, **drawn)
