"""Calibrates the drivers of recordings: ``graphrqi calibrate RECORDING_OR_DATASET --out FOLDER``.

Writes a folder with ``drivers.parquet`` (a row for each driver, law and number), one
``population_LAW.toml`` for each law and ``population.toml`` for the law that fits better, and
``calibration.json``. ``python -m experiments.calibration FOLDER`` (or ``make
population``) makes the population that ships again.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.errors import InputError
from behaviors.populations import NUMBERS, POPULATIONS, read_population
from experiments.console.exit_codes import exit_on_user_error
from experiments.console.notices import show_notices
from experiments.score.calibration import (
    Calibrated,
    calibrate_recordings,
    label_of,
    quantile_rows,
)
from graphrqi.calibrate.laws import FIELDS, Law
from sim.store.atomic import whole_file, write_whole
from sim.store.lock import LOCK, new_folder, same_again

SCHEMA: Final = pa.schema(
    [
        ("recording", pa.string()),
        ("agent", pa.int64()),
        ("name", pa.string()),
        ("seconds", pa.float64()),
        ("law", pa.string()),
        ("law_probability", pa.float64()),
        ("number", pa.string()),
        ("mean", pa.float64()),
        ("low", pa.float64()),
        ("high", pa.float64()),
        ("known", pa.bool_()),
    ]
)
"""Columns of ``drivers.parquet``: mean and 90 % interval of a number, and whether the data tell it;
``law_probability`` is that of the row's law, both laws being as likely beforehand."""


FILES: Final = frozenset(
    {"drivers.parquet", "population.toml", "calibration.json"}
    | {f"population_{law}.toml" for law in Law}
)
"""What is written into the folder."""


def driver_rows(calibrated: Calibrated) -> list[dict[str, Any]]:
    """A row for each driver, law and number; columns as `SCHEMA`."""
    rows: list[dict[str, Any]] = []
    for law, fitted in calibrated.laws.items():
        told, share = fitted.summary(), calibrated.law_probability(law)
        for i, driver in enumerate(calibrated.drivers):
            rows += [
                {
                    "recording": calibrated.recording[i],
                    "agent": driver.agent,
                    "name": driver.name,
                    "seconds": driver.drive.seconds,
                    "law": str(law),
                    "law_probability": float(share[i]),
                    "number": number,
                    "mean": float(told.mean[i, k]),
                    "low": float(told.low[i, k]),
                    "high": float(told.high[i, k]),
                    "known": bool(told.known[i, k]),
                }
                for k, number in enumerate(NUMBERS)
            ]
    return rows


def write_calibration(
    source: Path, out: Path, format: str | None = None, net: Path | None = None, quiet: bool = False
) -> Calibrated:
    """Calibrate and write everything into a new folder.

    Where ``out`` already holds the same it stays as it is: so a command that was stopped at its
    very end can be run again.

    Args:
        source: a dataset, a recording or a folder of recordings.
        out: folder: new, empty, or with the same calibration.
        format: as in `calibrate_recordings`.
        net: as in `calibrate_recordings`.
        quiet: whether to show no progress.

    Raises:
        InputError: if there is nothing to calibrate or ``out`` holds anything else.
        OSError: if something cannot be written.
    """
    again = _calibrated_before(source, out)
    with same_again(out, "calibration") if again else new_folder(out, FILES) as folder:
        calibrated = calibrate_recordings(source, format, net, quiet)
        table = pa.Table.from_pylist(driver_rows(calibrated), schema=SCHEMA)
        with whole_file(folder / "drivers.parquet") as partial:
            pq.write_table(table, partial)
        for law in Law:
            text = calibrated.population(law).to_toml()
            write_whole(folder / f"population_{law}.toml", text.encode())
        best = calibrated.population(calibrated.better)
        write_whole(folder / "population.toml", best.to_toml().encode())
        write_whole(
            folder / "calibration.json", (json.dumps(_card(calibrated), indent=1) + "\n").encode()
        )
    return calibrated


SHIPPED: Final = "us101"
SHIPPED_SOURCE: Final = (
    "{drivers:,} drives on US-101 at Los Angeles (NGSIM, US Department of Transportation, 2005), "
    "by graphrqi calibrate"
)
"""The population of recorded drivers that ships, and what it says of where it comes from."""


def write_shipped(source: Path, out: Path = POPULATIONS[SHIPPED], quiet: bool = False) -> None:
    """Make the population that ships again.

    Args:
        source: the 55 scenes of US-101 that CommonRoad made of NGSIM's recordings, a folder.
        out: file of the population, which is written anew.
        quiet: whether to show no progress.

    Raises:
        InputError: if there is nothing to calibrate.
        OSError: if the file cannot be written.
    """
    calibrated = calibrate_recordings(source, quiet=quiet)
    found = calibrated.population(Law.IDM)
    told = SHIPPED_SOURCE.format(drivers=found.drivers)
    write_whole(out, dataclasses.replace(found, name=SHIPPED, source=told).to_toml().encode())


def _calibrated_before(source: Path, out: Path) -> bool:
    """Whether a folder holds a whole calibration of something of this name."""
    if (out / LOCK).exists() or not all((out / name).is_file() for name in FILES):
        return False
    try:
        return read_population(out / "population.toml").name == label_of(source)
    except InputError:
        return False


def _card(calibrated: Calibrated) -> dict[str, Any]:
    """What ``calibration.json`` says."""
    return {
        "schema_version": 1,
        "source": calibrated.source,
        "drivers": len(calibrated.drivers),
        "seconds": round(sum(driver.drive.seconds for driver in calibrated.drivers), 1),
        "better_law": str(calibrated.better),
        **{f"law_told_{law}": calibrated.law_told(law) for law in Law},
        "populations": {
            str(law): {
                "log_likelihood": float(fitted.evidence.sum()),
                "counts": fitted.counts,
                **{
                    name: {
                        "median": float(np.exp(fitted.mean[k])),
                        "log_spread": float(fitted.spread[k]),
                    }
                    for k, name in enumerate(FIELDS[law])
                },
                "correlation": calibrated.population(law).correlation.round(6).tolist(),
                "known": dict(
                    zip(NUMBERS, map(float, fitted.summary().known.mean(axis=0)), strict=True)
                ),
            }
            for law, fitted in calibrated.laws.items()
        },
        "profiles": quantile_rows([calibrated.population(law) for law in Law]),
    }


if __name__ == "__main__":
    show_notices()
    with exit_on_user_error():
        write_shipped(Path(sys.argv[1]))
