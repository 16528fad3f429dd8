"""Calibrates the drivers of recordings: ``graphrqi calibrate RECORDING_OR_DATASET --out FOLDER``.

Writes ``drivers.parquet`` (a row per driver, law and number), a ``population_LAW.toml`` per law,
and ``population.toml`` for the better law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.errors import InputError
from behaviors.labels import PROFILES
from behaviors.populations import NUMBERS, Population
from experiments.console.progress import Progress
from experiments.data.exchange import as_dataset
from experiments.score.rows import Cell, Row
from graphrqi.calibrate.fit import ROUNDS, Calibration, Law, calibrate, second_half_errors
from graphrqi.calibrate.following import RecordedDriver, recorded_drivers
from sim.files import new_folder
from sim.store.dataset import open_dataset

SCHEMA: Final = pa.schema(
    {
        "recording": pa.string(), "agent": pa.int64(), "name": pa.string(),
        "seconds": pa.float64(), "law": pa.string(), "error_m": pa.float64(),
        "number": pa.string(), "median": pa.float64(), "low": pa.float64(), "high": pa.float64(),
        "known": pa.bool_(),
    }
)  # fmt: skip
"""Columns of ``drivers.parquet``: a law's position error, a number with its 90 % interval, and
whether the recording identifies it."""

NORMAL_90: Final = 1.6449
"""Standard deviations from the median to the ends of a 90 % interval."""

LEAST_HALF_S: Final = 5.0
"""Shorter halves do not count for the errors of second halves, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """The N drivers of recordings, the recording of each, and their calibration under each law."""

    source: str
    recording: tuple[str, ...]
    drivers: tuple[RecordedDriver, ...]
    laws: Mapping[Law, Calibration]

    @property
    def better(self) -> Law:
        """The law with the smaller median error."""
        return min(self.laws, key=lambda law: float(np.median(self.laws[law].error_m)))

    def population(self, law: Law) -> Population:
        """The population under a law."""
        fitted = self.laws[law]
        spread = np.sqrt(np.diag(fitted.covariance))
        return Population(
            name=self.source,
            source=f"{len(self.drivers)} drivers of {self.source}",
            law=str(law),
            drivers=len(self.drivers),
            median=np.exp(fitted.mean),
            log_spread=spread,
            correlation=fitted.covariance / np.outer(spread, spread),
        )


def write_calibration(
    source: Path, out: Path, format: str | None = None, net: Path | None = None, quiet: bool = False
) -> Calibrated:
    """Calibrate all drivers of a dataset or of recordings, and write a new or empty folder.

    Format and net are those of `experiments.data.exchange.as_dataset`.
    """
    with new_folder(out) as folder:
        names: list[str] = []
        drivers: list[RecordedDriver] = []
        with as_dataset(source, format, net) as data:
            dataset = open_dataset(data)
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
        label = source.resolve().name.split(".")[0] or "recordings"
        stretches = [driver.stretches for driver in drivers]
        with Progress("calibrating drivers", len(Law) * ROUNDS * len(drivers), quiet) as shown:
            laws = {law: calibrate(law, stretches, shown.advance) for law in Law}
        calibrated = Calibrated(label, tuple(names), tuple(drivers), laws)
        pq.write_table(_drivers_table(calibrated), folder / "drivers.parquet")
        populations = {f"population_{law}": calibrated.population(law) for law in Law}
        populations["population"] = calibrated.population(calibrated.better)
        for name, population in populations.items():
            (folder / f"{name}.toml").write_text(population.to_toml())
    return calibrated


def _drivers_table(calibrated: Calibrated) -> pa.Table:
    """A row for each law, driver and number; columns as `SCHEMA`."""
    drivers, parts = calibrated.drivers, []
    for law, fitted in calibrated.laws.items():
        margin = NORMAL_90 * fitted.deviation
        of_drivers = {
            "recording": calibrated.recording,
            "agent": [driver.agent for driver in drivers],
            "name": [driver.name for driver in drivers],
            "seconds": [driver.seconds for driver in drivers],
            "law": [str(law)] * len(drivers),
            "error_m": fitted.error_m,
        }
        columns = {
            **{
                name: np.repeat(np.asarray(each), len(NUMBERS)) for name, each in of_drivers.items()
            },
            "number": list(NUMBERS) * len(drivers),
            "median": np.exp(fitted.logs).ravel(),
            "low": np.exp(fitted.logs - margin).ravel(),
            "high": np.exp(fitted.logs + margin).ravel(),
            "known": fitted.known.ravel(),
        }
        parts.append(pa.table(columns, schema=SCHEMA))
    return pa.concat_tables(parts)


def population_rows(calibrated: Calibrated) -> list[Row]:
    """A row for each law and number: the population, and how well the law holds.

    ``error_m`` is the median position error, ``second_half_m`` that of gaps predicted from the
    first half. None if no driver follows one leader for 10 s.
    """
    halved = []
    for driver in calibrated.drivers:
        behind = [one for one in driver.stretches if np.isfinite(one.leader[0])]
        longest = max(behind, key=lambda one: one.seconds, default=None)
        if longest is not None and longest.seconds >= 2.0 * LEAST_HALF_S:
            halved.append(longest)
    rows: list[Row] = []
    for law, fitted in calibrated.laws.items():
        population = calibrated.population(law)
        later = float(np.median(second_half_errors(law, halved))) if halved else None
        rows += [
            {
                "law": str(law),
                "number": number,
                "median": float(population.median[k]),
                "log_spread": float(population.log_spread[k]),
                "known": float(fitted.known[:, k].mean()),
                "drivers": len(calibrated.drivers),
                "error_m": float(np.median(fitted.error_m)),
                "second_half_m": later,
            }
            for k, number in enumerate(NUMBERS)
        ]
    return rows


def quantile_rows(population: Population) -> list[Row]:
    """The quantiles of a population at which the median driver of each behaviour lies.

    A desired speed has none: profiles have a factor of the limit instead.

    Examples:
        >>> from behaviors.populations import read_population
        >>> rows = quantile_rows(read_population("profiles"))
        >>> rows[0]["number"], rows[0]["timid"]
        ('time_headway_s', 1.0)
    """
    from scipy.stats import norm

    rows: list[Row] = []
    for number, median, spread in zip(
        NUMBERS[1:], population.median[1:].tolist(), population.log_spread[1:].tolist(), strict=True
    ):
        row: dict[str, Cell] = {"number": number, "median": median, "log_spread": spread}
        for behavior, profile in PROFILES.items():
            z = np.log(getattr(profile, number) / median) / max(spread, 1e-12)
            row[str(behavior)] = round(float(norm.cdf(z)), 3)
        rows.append(row)
    return rows
