"""A table of one's own: any CSV, Parquet or Feather file whose columns are named by the user."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import NEEDED, beginning_of, read_columns, rows_of
from sim.input_files import stem
from sim.units import PARTS

NUMBERS: Final = ("t", "x", "y", "heading", "speed", "vx", "vy", "length", "width")
WORDS: Final = ("id", "kind")
"""What columns may be."""

METRES: Final = {"m": "", "km": "km", "ft": "ft"}
SPEEDS: Final = {"m/s": "", "km/h": "km/h", "mph": "mph", "ft/s": "ft/s"}
UNITS: Final[dict[str, dict[str, str]]] = {
    "t": {"s": "", **{unit: unit for unit in PARTS}},
    "heading": {"rad": "", "deg": "deg"},
    **dict.fromkeys(("x", "y", "length", "width"), METRES),
    **dict.fromkeys(("speed", "vx", "vy"), SPEEDS),
}
"""The units that each column may have, as `sim.units.in_si` takes them; the first is its usual."""


def check_columns(columns: Mapping[str, str], units: Mapping[str, str]) -> None:
    """Refuse columns that are not known or missing, and units that a column cannot have.

    Args:
        columns: name in the file of each of ``NUMBERS`` and ``WORDS``.
        units: of some of ``NUMBERS``.
    """
    for key in columns:
        if key not in (*NUMBERS, *WORDS):
            known = ", ".join((*WORDS, *NUMBERS))
            raise InputError(f"columns: found {key[:60]!r}, expected one of {known}")
    for key in NEEDED:
        if key not in columns:
            raise InputError(f"columns: found no {key}, expected {key}=NAME as in the file")
    for key, unit in units.items():
        if key not in columns or key in WORDS:
            raise InputError(f"units: found {key[:60]!r}, expected one of the numbers in columns")
        if unit not in UNITS[key]:
            known = ", ".join(UNITS[key])
            raise InputError(f"units: {key}: found {unit[:60]!r}, expected one of {known}")


def read(
    path: Path, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> Iterator[Recording]:
    """Read one table; headings, speeds and sizes that it does not have are told or assumed.

    Args:
        path: the file.
        columns: as `check_columns` takes them; by default ``id``, ``t``, ``x`` and ``y``.
        units: of the columns; SI units, and radians from +x, where they say nothing.
    """
    columns = dict(zip(NEEDED, NEEDED, strict=True)) if columns is None else columns
    units = {} if units is None else units
    check_columns(columns, units)
    names = {key: name.strip().lower() for key, name in columns.items()}
    if "speed" in names:
        names = {key: name for key, name in names.items() if key not in ("vx", "vy")}
    in_file = beginning_of(path)[1]
    absent = next((name for name in names.values() if name not in in_file), None)
    if absent is not None and in_file:
        raise InputError(
            f"{path}: found the columns {', '.join(in_file)!r:.160}, expected a column {absent}"
        )
    known = {key: UNITS[key][unit] for key, unit in units.items()}
    optional = [name for key, name in names.items() if key not in NEEDED]
    rows = rows_of(read_columns(path, names, (), optional), names, known, from_zero=True)
    missing = [key for key in ("heading", "speed", "kind", "length") if key not in columns]
    notes = [f"not in the table, taken from the motion or assumed: {', '.join(missing)}"]
    yield recorded(stem(path), rows, notes if missing else ())
