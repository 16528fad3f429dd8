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
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.errors import InputError
from behaviors.populations import NUMBERS, Population
from experiments.console.progress import Progress
from experiments.data.exchange import as_dataset
from experiments.score.rows import Row
from experiments.score.tables import as_table
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

    def table(self) -> pa.Table:
        """A row for each law, driver and number; columns as `SCHEMA`."""
        drivers = pd.DataFrame({
            "recording": self.recording,
            "agent": [driver.agent for driver in self.drivers],
            "name": [driver.name for driver in self.drivers],
            "seconds": [driver.seconds for driver in self.drivers],
        })  # fmt: skip
        each = drivers.loc[drivers.index.repeat(len(NUMBERS))].reset_index(drop=True)
        parts = [
            each.assign(
                law=str(law),
                error_m=np.repeat(fitted.error_m, len(NUMBERS)),
                number=list(NUMBERS) * len(drivers),
                median=np.exp(fitted.logs).ravel(),
                low=np.exp(fitted.logs - NORMAL_90 * fitted.deviation).ravel(),
                high=np.exp(fitted.logs + NORMAL_90 * fitted.deviation).ravel(),
                known=fitted.known.ravel(),
            )
            for law, fitted in self.laws.items()
        ]
        return as_table(pd.concat(parts), SCHEMA).replace_schema_metadata(None)


def write_calibration(
    source: Path, out: Path, format: str | None = None, net: Path | None = None, quiet: bool = False
) -> Calibrated:
    """Calibrate all drivers of a dataset or of recordings, and write a new or empty folder.

    Format and net are those of `experiments.data.exchange.as_dataset`.
    """
    names: list[str] = []
    drivers: list[RecordedDriver] = []
    with new_folder(out) as folder:
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
        pq.write_table(calibrated.table(), folder / "drivers.parquet")
        populations = {f"population_{law}": calibrated.population(law) for law in Law}
        populations["population"] = calibrated.population(calibrated.better)
        for name, population in populations.items():
            (folder / f"{name}.toml").write_text(population.to_toml())
    return calibrated


def population_rows(calibrated: Calibrated) -> list[Row]:
    """A row for each law and number: the population, and how well the law holds.

    ``error_m`` is the median position error, ``second_half_m`` that of gaps predicted from the
    first half. None if no driver follows one leader for 10 s.
    """
    behind = [[s for s in d.stretches if np.isfinite(s.leader[0])] for d in calibrated.drivers]
    longest = [max(some, key=lambda one: one.seconds) for some in behind if some]
    halved = [one for one in longest if one.seconds >= 2.0 * LEAST_HALF_S]
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
