"""Populations of drivers as data: what a file says, which ones ship, and drivers drawn from one."""

from behaviors.populations.draw import POPULATION_FIELDS, DriverSource, drivers_of
from behaviors.populations.files import POPULATIONS, read_population
from behaviors.populations.population import NUMBERS, Around, Population

__all__ = [
    "NUMBERS",
    "POPULATIONS",
    "POPULATION_FIELDS",
    "Around",
    "DriverSource",
    "Population",
    "drivers_of",
    "read_population",
]
