"""Calibrates all drivers of recordings under both laws, and says what was found in rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from behaviors.populations import NUMBERS, Population
from behaviors.profiles import PROFILES
from experiments.console.progress import Progress
from experiments.data.exchange import as_dataset
from experiments.score.rows import Row
from graphrqi.calibrate.laws import Law
from graphrqi.calibrate.posterior import Calibration, calibrate, visits
from graphrqi.calibrate.recorded import RecordedDriver, recorded_drivers
from sim.store.dataset import open_dataset

FloatArray = NDArray[np.float64]

LAW_KNOWN: Final = 0.95
"""From this probability on the data tell a driver's law."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """Drivers of recordings under both laws.

    Attributes:
        source: what was calibrated, in words.
        recording: (N,) name of the recording of each driver.
        drivers: (N,) who they are.
        laws: the calibration under each law.
    """

    source: str
    recording: tuple[str, ...]
    drivers: tuple[RecordedDriver, ...]
    laws: Mapping[Law, Calibration]

    def law_probability(self, law: Law) -> FloatArray:
        """(N,) probability that each driver drives by a law."""
        other = next(one for one in Law if one is not law)
        return np.asarray(expit(self.laws[law].evidence - self.laws[other].evidence))

    def law_told(self, law: Law) -> float:
        """Share of the drivers of whom the data tell that they drive by a law."""
        return float((self.law_probability(law) >= LAW_KNOWN).mean())

    @property
    def better(self) -> Law:
        """The law under which all recordings together are likelier."""
        return max(self.laws, key=lambda law: float(self.laws[law].evidence.sum()))

    def population(self, law: Law) -> Population:
        """The population under a law."""
        fitted = self.laws[law]
        size = len(NUMBERS)
        spread = fitted.spread[:size]
        return Population(
            name=self.source,
            source=f"{len(self.drivers)} drivers of {self.source}",
            law=str(law),
            drivers=len(self.drivers),
            median=np.exp(fitted.mean[:size]),
            log_spread=spread,
            correlation=fitted.covariance[:size, :size] / np.outer(spread, spread),
        )


def label_of(source: Path) -> str:
    """What calibrated recordings are called: the name of their file or folder."""
    return source.resolve().name.split(".")[0] or "recordings"


def calibrate_recordings(
    source: Path, format: str | None = None, net: Path | None = None, quiet: bool = True
) -> Calibrated:
    """Calibrate all drivers of a dataset, a recording or a folder of recordings.

    Args:
        source: where they are.
        format: key of the recordings' format; None to tell it from the content.
        net: their map; None for what comes with them.
        quiet: whether to show no progress.

    Raises:
        InputError: if a file is broken, or nobody follows or drives freely for long enough.
    """
    names: list[str] = []
    drivers: list[RecordedDriver] = []
    with as_dataset(source, format, net) as folder:
        dataset = open_dataset(folder)
        episodes = list(dataset.episodes())
        with Progress("finding drivers", len(episodes), quiet) as shown:
            for entry in episodes:
                if not entry.options.get("pixels_per_m"):
                    found = recorded_drivers(dataset.read(entry).tracks, dataset.road(entry))
                    drivers += found
                    names += [str(entry.options.get("recording", entry.id))] * len(found)
                shown.advance(entry.agents, entry.agent_steps)
    if not drivers:
        raise InputError(
            f"{source}: found no driver that follows another one for 4 s, expected some"
        )
    drives = [driver.drive for driver in drivers]
    with Progress("calibrating drivers", 2 * visits(len(drives)), quiet) as shown:
        laws = {law: calibrate(law, drives, shown.advance) for law in Law}
    label = label_of(source)
    return Calibrated(label, tuple(names), tuple(drivers), laws)


def population_rows(calibrated: Calibrated) -> list[Row]:
    """A row for each law and number: the population, and who it could be told of."""
    rows: list[Row] = []
    for law, fitted in calibrated.laws.items():
        population, told = calibrated.population(law), fitted.summary()
        for k, number in enumerate(NUMBERS):
            rows.append(
                {
                    "law": str(law),
                    "number": number,
                    "median": float(population.median[k]),
                    "log_spread": float(population.log_spread[k]),
                    "known": float(told.known[:, k].mean()),
                    "drivers": len(calibrated.drivers),
                }
            )
    return rows


def place_rows(populations: Sequence[Population]) -> list[Row]:
    """Every number of each population, and the quantiles at which the profiles' medians lie.

    A desired speed has no quantiles: profiles have a factor of the limit instead.

    Examples:
        >>> from behaviors.populations import read_population
        >>> rows = place_rows([read_population("profiles")])
        >>> [row["timid"] for row in rows[:2]]
        [None, 1.0]
    """
    found: list[Row] = []
    for population in populations:
        placed = {row["behavior"]: row for row in quantile_rows([population])}
        found += [
            {
                "population": population.name,
                "number": number,
                "median": float(population.median[k]),
                "log_spread": float(population.log_spread[k]),
                **{str(b): placed[str(b)].get(number) for b in BEHAVIORS},
            }
            for k, number in enumerate(NUMBERS)
        ]
    return found


def quantile_rows(populations: Sequence[Population]) -> list[Row]:
    """At which quantile of each population the median driver of each behaviour lies."""
    return [
        {
            "population": population.name,
            "behavior": str(behavior),
            **{
                name: round(population.quantile(name, getattr(PROFILES[behavior], name)), 3)
                for name in NUMBERS[1:]
            },
        }
        for population in populations
        for behavior in BEHAVIORS
    ]
