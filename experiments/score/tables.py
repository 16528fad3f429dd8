"""Tables of answers on disk: Parquet or CSV, as the file's ending says."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from behaviors.errors import InputError
from sim.files import whole_file
from sim.store.schema import EpisodeEntry

ENDINGS: Final = (".parquet", ".csv")
"""Endings of the files that are written; a path without an ending is Parquet."""

JOINED: Final = (
    pa.field("episode", pa.string()),
    pa.field("recording", pa.string()),
    pa.field("file", pa.string()),
    pa.field("scenario", pa.string()),
    pa.field("split", pa.string()),
)
"""First columns of every table of answers; the recording and file are null for simulated
episodes."""


def joined_columns(entry: EpisodeEntry, rows: int) -> dict[str, pa.Array]:
    """The columns `JOINED`, by name, of rows that are all of one episode."""
    words = (entry.id, entry.recording, entry.file, entry.scenario, entry.split)
    at = pa.array(np.zeros(rows, int))
    return {
        field.name: pa.array([word], pa.string()).take(at)
        for field, word in zip(JOINED, words, strict=True)
    }


class TakesTables(Protocol):
    """Sink of written tables."""

    def write_table(self, table: pa.Table) -> None:
        """Add a table's rows."""
        ...


def check_ending(path: Path) -> Path:
    """Refuse a file of an ending that is not written.

    Args:
        path: the file to write.

    Returns:
        The path.

    Raises:
        InputError: naming the ending.

    Examples:
        >>> check_ending(Path("labels.xlsx"))
        Traceback (most recent call last):
        ...
        behaviors.errors.InputError: labels.xlsx: found the ending .xlsx, expected .parquet or .csv
    """
    if path.suffix.lower() not in ("", *ENDINGS):
        raise InputError(f"{path}: found the ending {path.suffix}, expected {' or '.join(ENDINGS)}")
    return path


@contextmanager
def table_file(path: Path, schema: pa.Schema) -> Iterator[TakesTables]:
    """A new file of rows; it appears complete when the block ends, or not at all.

    Args:
        path: the file; its ending says whether it is CSV or Parquet, see `ENDINGS`.
        schema: its columns; CSV takes no dictionaries.

    Yields:
        Sink of the tables. In CSV, null is an empty cell.

    Raises:
        InputError: if the file has another ending.
        OSError: if it cannot be written.
    """
    check_ending(path)
    with whole_file(path) as partial:
        if path.suffix.lower() == ".csv":
            with pyarrow.csv.CSVWriter(partial, schema) as lines:
                yield lines
        else:
            with pq.ParquetWriter(partial, schema, compression="zstd") as writer:
                yield writer
