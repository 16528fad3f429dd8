"""Tables for people on standard output, and rows for programs as JSON."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from behaviors.display import printable
from sim.files import write_whole

Row = Mapping[str, Any]

MADE: Final = ("command", "version", "seed", "dataset")
"""Keys of tidy rows that say how a figure was made; tables for people leave them out."""


def _text(cell: object) -> str:
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """Write rows as a JSON list; a number that is not finite becomes null.

    Args:
        rows: flat rows.
        path: the file; ``-`` for standard output.

    Raises:
        OSError: if the file cannot be written.
    """
    finite = [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
        for row in rows
    ]
    text = json.dumps(finite, indent=1, allow_nan=False, default=str) + "\n"
    if str(path) == "-":
        sys.stdout.write(text)
    else:
        write_whole(path, text.encode())


def show_table(
    rows: Sequence[Row],
    json_path: Path | None = None,
    title: str = "",
    lines: Sequence[Row] | None = None,
) -> None:
    """Print a table for people, and write tidy rows as JSON if a file is named.

    Args:
        rows: tidy rows.
        json_path: file for the rows; ``-`` prints JSON instead of the table.
        title: what stands above the table.
        lines: what is printed, as mappings with the same keys; None for the rows themselves. Off a
            terminal, a line is up to 200 characters wide.

    Raises:
        OSError: if the file cannot be written.
    """
    if json_path is not None:
        write_rows(rows, json_path)
        if str(json_path) == "-":
            return
    from rich.console import Console
    from rich.table import Table

    shown = rows if lines is None else lines
    columns = list(dict.fromkeys(key for row in shown for key in row if key not in MADE))
    table = Table(*map(printable, columns), title=printable(title) or None)
    for row in shown:
        table.add_row(*(printable(_text(row.get(column))) for column in columns))
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, width=200)
    console.print(table)
