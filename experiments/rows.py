"""Tidy rows: one figure each, with the keys that say what was measured.

A row is a flat mapping: ``bench`` (which bench it belongs to), that bench's own keys, then
``metric``, ``value``, ``low``, ``high`` (a 95 % interval) and ``n`` (how many cases it rests on).
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

from behaviors.errors import InputError
from sim.files import write_whole

Cell = str | int | float | bool | None
Row = Mapping[str, Cell]

FIGURE: Final = frozenset({"metric", "value", "low", "high", "n"})
"""Keys that every row has beside those that say what was measured."""

LARGEST: Final = 1e300
"""Largest absolute number of a row (what is computed from it stays finite)."""

POSITIVE: Final = ("horizon_s", "window_s", "d")
"""Keys that charts are drawn over."""

NEEDED: Final[Mapping[str, tuple[str, ...]]] = {
    "prediction": ("scenario", "predictor", "behavior", "horizon_s"),
    "classification": ("protocol", "scenario", "method"),
    "spectrum": ("solver", "graph", "kind", "end"),
}
"""Keys without which rows of a bench cannot be drawn."""

MAX_BYTES: Final = 2**28
"""Largest file of rows that is read; a full study's are some megabytes."""


EXPECTED: Final = (
    'a list of rows such as {"bench": "loop", "stage": "all", "metric": "ms_median", "value": 9.5},'
    " as graphrqi bench NAME --json FILE writes it"
)
"""What a file of rows should look like, for messages."""


def tidy_row(
    keys: Mapping[str, Cell],
    metric: str,
    value: float | None,
    low: float | None,
    high: float | None,
    n: int | None,
) -> Row:
    """One figure as a row; what is not finite is None, and an interval needs both ends.

    Examples:
        >>> tidy_row({"solver": "eigh"}, "cpu_ms", 2.5, float("nan"), float("nan"), 10)
        {'solver': 'eigh', 'metric': 'cpu_ms', 'value': 2.5, 'low': None, 'high': None, 'n': 10}
    """
    ends = [None if x is None or not math.isfinite(x) else float(x) for x in (low, high)]
    low, high = (None, None) if None in ends else ends
    value = None if value is None or not math.isfinite(value) else float(value)
    return {**keys, "metric": metric, "value": value, "low": low, "high": high, "n": n}


def of_bench(bench: str, rows: Iterable[Row]) -> list[Row]:
    """The rows with the name of their bench in front."""
    return [{"bench": bench, **row} for row in rows]


def write_json(rows: Sequence[Row], path: Path) -> None:
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


def read_rows(path: Path) -> list[Row]:
    """Read rows as a bench's ``--json`` writes them.

    Raises:
        InputError: if the file is not a list of flat rows with a bench, a metric and a value.
    """
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected a list of rows")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{path}: found {size} bytes, expected at most {MAX_BYTES}")
    try:
        found: Any = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: found no JSON ({error}), expected {EXPECTED}") from None
    return checked_rows(found, str(path))


def checked_rows(found: Any, path: str) -> list[Row]:
    """Rows that somebody may have altered.

    Args:
        found: what JSON gave.
        path: where it is from, for messages.

    Raises:
        InputError: if it is not a list of flat rows with a bench, a metric and a value.
    """
    if not isinstance(found, list):
        raise InputError(f"{path}: found {type(found).__name__}, expected {EXPECTED}")
    for number, row in enumerate(found):
        where = f"{path}: row {number}"
        if not isinstance(row, dict) or not isinstance(row.get("metric"), str):
            raise InputError(f"{where}: found no metric, expected {EXPECTED}")
        if not isinstance(row.get("bench"), str):
            raise InputError(
                f"{where}: found no bench, expected its name; files of older versions have none: "
                "measure again"
            )
        if any(isinstance(value, dict | list) for value in row.values()):
            raise InputError(f"{where}: found a nested value, expected flat rows")
        for name in ("value", "low", "high", *POSITIVE):
            value = row.get(name)
            if value is None:
                continue
            if type(value) not in (int, float) or not abs(value) <= LARGEST:
                raise InputError(f"{where}: {name}: found {value!r:.40}, expected a number")
            if name in POSITIVE and value <= 0:
                raise InputError(f"{where}: {name}: found {value!r:.40}, expected more than 0")
        missing = [name for name in NEEDED.get(row["bench"], ()) if row.get(name) is None]
        if missing:
            raise InputError(f"{where}: found no {missing[0]}, which rows of {row['bench']} have")
    return cast("list[Row]", found)
