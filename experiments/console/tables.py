"""Tables for people on standard output, and the same rows as JSON for scripts."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from sim.store.atomic import write_whole

Cell = str | int | float | bool | None
Row = Mapping[str, Cell]


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _known(cell: Cell) -> Cell:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell


def write_json(rows: Sequence[Row], json_path: Path) -> None:
    """Write rows as a JSON list; what is not finite, of which nothing is known, as null.

    Args:
        rows: flat rows.
        json_path: the file; ``-`` for standard output.

    Raises:
        OSError: if the file cannot be written.
    """
    known = [{name: _known(cell) for name, cell in row.items()} for row in rows]
    text = json.dumps(known, indent=1, allow_nan=False, default=str) + "\n"
    if str(json_path) == "-":
        sys.stdout.write(text)
    else:
        write_whole(json_path, text.encode())


def show_table(rows: Sequence[Row], json_path: Path | None = None, title: str = "") -> None:
    """Print rows as a table, or write them as JSON.

    Args:
        rows: flat rows; the columns are the keys of all rows in order of appearance.
        json_path: file for a JSON list of the rows; ``-`` prints JSON instead of the table.
        title: what stands above the table.

    Raises:
        OSError: if the file cannot be written.
    """
    if json_path is not None:
        write_json(rows, json_path)
        if str(json_path) == "-":
            return
    from rich.console import Console
    from rich.table import Table

    columns = list(dict.fromkeys(key for row in rows for key in row))
    table = Table(*columns, title=title or None)
    for row in rows:
        table.add_row(*(_text(row.get(column)) for column in columns))
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, width=200)
    console.print(table)
