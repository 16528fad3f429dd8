"""Tidy rows: one figure each, with the keys that say what was measured.

A row is a flat mapping. First come ``command``, ``version``, ``seed`` and ``dataset``, then keys
of the command's own (such as ``scenario``). Last come ``metric``, ``value``, its interval ``low``
to ``high`` (95 %), and ``n``, the number of cases.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from behaviors.errors import InputError, printable
from sim.files import write_whole
from sim.invalid_fields import first_wrong_field

if TYPE_CHECKING:
    from sim.store.dataset import Dataset

Cell = str | int | float | bool | None
Row = Mapping[str, Cell]

MADE, FIGURE = ("command", "version", "seed", "dataset"), ("metric", "value", "low", "high", "n")
"""Keys that say how a figure was made, which tables for people leave out, and of itself."""

_Number = Annotated[float, Field(ge=-1e300, le=1e300, allow_inf_nan=False)]


def tidy_row(
    keys: Mapping[str, Cell], metric: str, value: float | None, low: float | None = None,
    high: float | None = None, n: int | None = None,
) -> Row:  # fmt: skip
    """One figure of n cases with its 95 % interval; what is not finite is None.

    The keys say what was measured, and the metric's name has its unit. An interval needs both ends.

    Examples:
        >>> tidy_row({"solver": "eigh"}, "cpu_ms", 2.5, float("nan"), float("nan"), 10)
        {'solver': 'eigh', 'metric': 'cpu_ms', 'value': 2.5, 'low': None, 'high': None, 'n': 10}
    """
    numbers = [None if x is None or not math.isfinite(x) else float(x) for x in (value, low, high)]
    value, *ends = numbers
    low, high = (None, None) if None in ends else ends
    return {**keys, "metric": metric, "value": value, "low": low, "high": high, "n": n}


def melted(lines: Iterable[Row], keys: Sequence[str]) -> list[Row]:
    """Tidy rows of a table that has a column for each figure; ``keys`` are its other columns."""
    return [
        tidy_row({key: line.get(key) for key in keys}, name, float(value))
        for line in lines
        for name, value in line.items()
        if name not in keys and isinstance(value, int | float)
    ]


def pivoted(
    rows: Iterable[Row], down: Sequence[str], column: Callable[[Row], str | None],
    cell: Callable[[Row], Cell],
) -> list[dict[str, Cell]]:  # fmt: skip
    """A table for people: a line for each combination of some keys, with a cell for each row.

    Rows without a column are left out; of several rows of one cell, the last is shown.
    """
    lines: dict[tuple[Cell, ...], dict[str, Cell]] = {}
    for row in rows:
        name = column(row)
        if name is not None:
            place = {key: row.get(key) for key in down}
            lines.setdefault(tuple(place.values()), place)[name] = cell(row)
    return list(lines.values())


def stamped(
    rows: Iterable[Row], command: str, seed: int | None = None, dataset: str | None = None
) -> list[Row]:
    """Rows that say how they were made.

    The command is as on the command line (``evaluate``, ``bench loop``), the seed None where
    nothing is drawn at random, and the dataset as from `dataset_id`.
    """
    made = {"command": command, "version": metadata.version("graphrqi"), "seed": seed}
    return [{**made, "dataset": dataset, **row} for row in rows]


def dataset_id(dataset: Dataset) -> str:
    """Name of a dataset in rows: 12 hexadecimal digits of a hash over the ids of its episodes."""
    ids = sorted(entry.id for entry in dataset.episodes())
    return hashlib.sha256("\n".join(ids).encode()).hexdigest()[:12]


class _Figure(BaseModel):
    """A row as a file may say it; keys of its own hold one value each."""

    model_config = ConfigDict(extra="allow", strict=True)

    __pydantic_extra__: dict[str, str | _Number | None]
    command: str
    metric: str
    value: _Number | None = None
    low: _Number | None = None
    high: _Number | None = None
    n: _Number | None = None


def read_rows(path: Path) -> list[Row]:
    """Read rows as a command's ``--json`` writes them."""
    try:
        found: Any = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: found no JSON ({error!s:.80}), expected rows") from None
    return checked_rows(found, str(path))


def checked_rows(found: Any, where: str) -> list[Row]:
    """Rows from a place that is named in errors, refused unless they are a list of flat rows."""
    if not isinstance(found, list):
        raise InputError(f"{where}: found no list, expected a list of rows")
    for number, row in enumerate(found):
        try:
            _Figure.model_validate(row)
        except ValidationError as error:
            wrong = first_wrong_field(error)
            if wrong.startswith(("command: found none", "metric: found none")):
                wrong += ": rows as graphrqi COMMAND --json writes them"
            raise InputError(f"{where}: row {number}: {wrong}") from None
    return found


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """Write rows as a JSON list (``-``: to standard output); a number not finite becomes null."""
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
    rows: Sequence[Row], json: Path | None = None, title: str = "",
    lines: Sequence[Mapping[str, Any]] | None = None, legend: str = "",
) -> None:  # fmt: skip
    """Print a table for people, and write tidy rows as JSON if a file is named (``-``: instead).

    What is printed are ``lines``, mappings with the same keys, or the rows themselves. Off a
    terminal, a line is up to 200 characters wide.
    """
    if json is not None:
        write_rows(rows, json)
        if str(json) == "-":
            return
    from rich.console import Console
    from rich.table import Table

    shown = rows if lines is None else lines
    columns = list(dict.fromkeys(key for row in shown for key in row if key not in MADE))
    table = Table(*map(printable, columns), title=printable(title) or None)
    for row in shown:
        table.add_row(*(printable(_text(row.get(column))) for column in columns))
    width = None if sys.stdout.isatty() else 200
    console = Console(highlight=False, markup=False, width=width)
    console.print(table)
    if legend:
        console.print(legend)


def _text(cell: object) -> str:
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def show_parts(
    name: str, parts: Iterable[Sequence[Row]], json: Path | None,
    table: Callable[[Sequence[Row]], Sequence[Row]] | None = None,
) -> None:  # fmt: skip
    """Print rows of a command that come part by part, with `show_table`, laid out by ``table``.

    A file of JSON is written after every part, so a measurement that is stopped has left some.
    """
    rows: list[Row] = []
    for part in parts:
        rows += stamped(part, name)
        if json is not None and str(json) != "-":
            write_rows(rows, json)
    show_table(rows, json, lines=None if table is None else table(rows))
