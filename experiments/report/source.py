"""Sources of a report: tidy rows in a file, in a folder, or in a trained model's card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from behaviors.errors import InputError
from experiments.score.rows import Row, checked_rows, read_rows
from graphrqi.model_files import FILE, load_model
from sim.store.catalogue import is_dataset


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One thing to report on.

    Attributes:
        path: the file or folder.
        name: what it is called.
        rows: the figures, a row each; those without a value are left out.
    """

    path: Path
    name: str
    rows: pd.DataFrame

    @property
    def is_run(self) -> bool:
        """Whether the data and the model of the figures lie beside them, as ``make demo`` does."""
        return (self.path / "model" / FILE).is_file() and is_dataset(self.path / "data")


def read_source(path: Path) -> Source:
    """Read the rows of a file or of a folder.

    Args:
        path: a file of rows, a folder with such files, or a model's folder.

    Returns:
        The source.

    Raises:
        InputError: if there is nothing to report on, or a file is broken.
    """
    if path.is_file():
        return Source(path, path.stem, table_of(read_rows(path), path))
    if not path.is_dir():
        raise InputError(f"{path}: found nothing there, expected a file of rows or a folder")
    if (path / FILE).is_file():
        card = load_model(path).card
        rows = checked_rows(card.get("scores", []), f"{path / FILE}: card.scores")
    else:
        rows = [row for file in sorted(path.glob("*.json")) for row in read_rows(file)]
    return Source(path, path.resolve().name, table_of(rows, path))


def table_of(rows: Sequence[Row], path: Path) -> pd.DataFrame:
    """Rows with a value as a table.

    Args:
        rows: tidy rows.
        path: where they are from, for the message.

    Returns:
        A line for each row.

    Raises:
        InputError: if no row has a value.
    """
    measured = [row for row in rows if row.get("value") is not None]
    if not measured:
        raise InputError(
            f"{path}: found no figure, expected rows as graphrqi COMMAND --json FILE writes them"
        )
    table = pd.DataFrame(measured)
    for column in ("low", "high", "n"):
        table[column] = pd.to_numeric(table[column]) if column in table else np.nan
    return table
