"""The command ``graphrqi verify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import Json
from experiments.console.notices import say


def verify(
    dataset: Annotated[Path, typer.Argument(help="Folder written by generate or import.")],
    json: Json = None,
) -> None:
    """Compare every file with its checksum."""
    from experiments.console.tables import show_table
    from experiments.data.verify import verify_dataset
    from experiments.score.rows import stamped, tidy_row

    flaws = verify_dataset(dataset)
    if flaws or json is not None:
        lines = [{"file": str(f.path), "state": f.state} for f in flaws]
        rows = [tidy_row(line, "wrong_files", 1) for line in lines]
        show_table(stamped(rows, "verify"), json, lines=lines)
    if flaws:
        say(f"graphrqi: error: {dataset}: found {len(flaws)} wrong files", err=True)
        raise typer.Exit(2)
    if json is None:
        say(f"{dataset}: every file is as its catalogue says")
