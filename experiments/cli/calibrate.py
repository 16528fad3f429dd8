"""The command ``graphrqi calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import FormatName, Json, Net, Quiet, Source


def calibrate(
    source: Source,
    out: Annotated[
        Path, typer.Option(file_okay=False, metavar="FOLDER", help="New folder for the results.")
    ],
    format: FormatName = None,
    net: Net = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Infer every driver's car-following numbers, and the population they come from."""
    from experiments.calibration import population_rows, write_calibration
    from experiments.console.tables import show_table

    calibrated = write_calibration(source, out, format, net, quiet)
    title = f"{out}: {len(calibrated.drivers)} drivers"
    show_table(population_rows(calibrated), json, title)
