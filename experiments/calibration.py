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
from graphrqi.calibrate.following import RecordedDriver, Stretch, recorded_drivers
from sim.files import new_folder
from sim.store.dataset import open_dataset

SCHEMA: Final = pa.schema(
    [
        ("recording", pa.string()),
        ("agent", pa.int64()),
        ("name", pa.string()),
        ("seconds", pa.float64()),
        ("law", pa.string()),
        ("error_m", pa.float64()),
        ("number", pa.string()),
        ("median", pa.float64()),
        ("low", pa.float64()),
        ("high", pa.float64()),
        ("known", pa.bool_()),
    ]
)
"""Columns of ``drivers.parquet``: a law's position error, a number with its 90 % interval, and
whether the recording identifies it."""

NORMAL_90: Final = 1.6449
"""Standard deviations from the median to the ends of a 90 % interval."""

LEAST_HALF_S: Final = 5.0
"""Shorter halves do not count for the errors of second halves, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """Drivers of recordings under both laws.

    Attributes:
        source: what was calibrated, in words.
        recording: (N,) name of the recording of each driver.
        drivers: (N,) their ids.
        laws: the calibration under each law.
    """

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

    Raises:
        InputError: if there is nothing to calibrate or ``out`` holds anything.
        OSError: if something cannot be written.
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
    parts = []
    count, numbers = len(calibrated.drivers), len(NUMBERS)
    for law, fitted in calibrated.laws.items():
        margin = NORMAL_90 * fitted.deviation
        each = {
            "recording": calibrated.recording,
            **{
                name: [getattr(driver, name) for driver in calibrated.drivers]
                for name in ("agent", "name", "seconds")
            },
            "law": [str(law)] * count,
            "error_m": fitted.error_m,
        }
        columns = {
            **{name: np.repeat(np.asarray(values), numbers) for name, values in each.items()},
            "number": list(NUMBERS) * count,
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
    longest = [_longest_following(driver) for driver in calibrated.drivers]
    halved = [stretch for stretch in longest if stretch is not None]
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


def _longest_following(driver: RecordedDriver) -> Stretch | None:
    """A driver's longest stretch behind one leader, if it is long enough to be halved."""
    behind = [one for one in driver.stretches if np.isfinite(one.leader[0])]
    longest = max(behind, key=lambda one: one.seconds, default=None)
    return longest if longest is not None and longest.seconds >= 2.0 * LEAST_HALF_S else None


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
