"""The commands ``graphrqi calibrate`` and ``graphrqi populations``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import FormatName, Json, Net, Quiet, Source, names_of


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
    from experiments.calibration import write_calibration
    from experiments.console.tables import show_table
    from experiments.scoring.calibration import population_rows

    calibrated = write_calibration(source, out, format, net, quiet)
    title = f"{out}: {len(calibrated.drivers)} drivers"
    show_table(population_rows(calibrated), json, title)


def populations(
    population: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names or files; by default all that ship.",
            metavar="NAME or FILE",
            autocompletion=names_of("population"),
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Say at which quantiles of populations the median driver of each behaviour lies."""
    from behaviors.populations import POPULATIONS, read_population
    from experiments.console.tables import show_table
    from experiments.scoring.calibration import place_rows

    show_table(place_rows([read_population(name) for name in population or POPULATIONS]), json)
