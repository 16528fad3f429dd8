"""The command ``graphrqi adapt``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import FormatName, GivenLabels, Json, Net, Quiet, Source


def adapt(
    model: Annotated[str, typer.Argument(help="A model that ships, or a folder.")],
    source: Source,
    out: Annotated[
        Path, typer.Option(file_okay=False, metavar="FOLDER", help="Folder of the adapted model.")
    ],
    labels: GivenLabels = None,
    format: FormatName = None,
    net: Net = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Adapt a model to the place of some recordings, with few labels or none."""
    from experiments.console.tables import show_table
    from experiments.data.exchange import as_dataset
    from experiments.rows import write_json
    from experiments.training.adapt import adapt, adapted_table

    with as_dataset(source, format, net) as dataset:
        rows = adapt(model, dataset, out, labels, quiet)
    if json is not None:
        write_json(rows, json)
    if str(json) != "-":
        show_table(adapted_table(rows), title=f"{out}: {model} adapted")
