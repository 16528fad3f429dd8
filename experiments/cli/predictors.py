"""The command that trains the predictor for recordings: ``train-predictor``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import Json, Quiet, Seed


def train_predictor(
    data: Annotated[
        list[Path],
        typer.Argument(help="Recordings, datasets, or folders of them; several are mixed."),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the weights.")],
    epochs: Annotated[int, typer.Option(min=1, help="Passes over what is learned from.")] = 4,
    seed: Seed = 0,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Train the predictor for recordings."""
    from experiments.console.tables import show_table
    from experiments.rows import Row
    from experiments.training.recorded import train_on_recordings

    scores = train_on_recordings(data, out, epochs=epochs, seed=seed, quiet=quiet)
    rows: list[Row] = [
        {"dataset": name, "ade_over_constant_velocity": round(value, 3)}
        for name, value in scores.items()
    ]
    show_table(rows, json)
