"""Rows that come part by part: kept in a file as they come, and shown as a table at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from experiments.console.tables import show_table, write_rows
from experiments.score.rows import Row, stamped


def show_parts(
    name: str,
    parts: Iterable[Sequence[Row]],
    json: Path | None,
    table: Callable[[Sequence[Row]], Sequence[Row]] | None = None,
) -> list[Row]:
    """Collect rows, and print them.

    Args:
        name: what measured them; the ``command`` of every row.
        parts: the rows; a long measurement that is stopped has written those before.
        json: file for all rows so far, written after every part; ``-`` prints them as JSON instead
            of the table; None for none.
        table: lays rows out for reading; None to print them as they are.

    Returns:
        All rows.
    """
    rows: list[Row] = []
    for part in parts:
        rows += stamped(part, name)
        if json is not None and str(json) != "-":
            write_rows(rows, json)
    show_table(rows, json, lines=None if table is None else table(rows))
    return rows
