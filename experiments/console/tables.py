"""Tables for people on standard output."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from behaviors.display import printable
from experiments.rows import Cell, Row, write_json


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


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
    columns = list(dict.fromkeys(key for row in rows for key in row))
    print_table(columns, [[_text(row.get(column)) for column in columns] for row in rows], title)


def print_table(columns: Sequence[str], lines: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table of words.

    Args:
        columns: headings.
        lines: a word for each column; off a terminal, lines are up to 200 characters wide.
        title: what stands above the table.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(*map(printable, columns), title=printable(title) or None)
    for line in lines:
        table.add_row(*map(printable, line))
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, width=200)
    console.print(table)
