"""The command ``graphrqi classify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import FormatName, Json, LabelsFile, ModelName, Net, Quiet


def classify(
    source: Annotated[Path, typer.Argument(help="A dataset, a recording, or a folder of them.")],
    out: LabelsFile,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Name each driver's behaviour as it drives."""
    from experiments.console.tables import show_table
    from experiments.data.exchange import as_dataset
    from experiments.rows import write_json
    from experiments.scoring.classification import (
        classify_dataset,
        episodes_table,
        foreign_notice,
        totals_table,
    )

    with as_dataset(source, format, net) as dataset:
        rows = classify_dataset(dataset, model, out, quiet)
    if json is not None:
        write_json(rows, json)
    if str(json) != "-":
        show_table(episodes_table(rows), title="drivers by their last answer")
        show_table(totals_table(rows), title="in all")
    if notice := foreign_notice(rows):
        typer.echo(notice, err=True)
