"""Columns of CSV, Parquet and Feather files, and of text without a header, as data frames.

A format says once which column of its files is what: `rows_of` makes rows in SI units of them,
whose columns have the names of `sim.formats.common.recording.recorded`.
"""

from __future__ import annotations

import codecs
import csv
import re
import warnings
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas
import pyarrow as pa
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.frames import AgentKind, FloatArray
from sim.input_files import broken_as_one_line, opened, read_bytes
from sim.units import in_si

HEAD_BYTES: Final = 65536
"""Beginning of a file by which its format and its dialect are recognised."""

PARQUET, FEATHER = b"PAR1", (b"ARROW1", b"FEA1")
"""How such tables begin."""

EMPTY: Final = ("", "NA", "null", "None")
"""What stands in a field of a CSV file that has no value."""

NEEDED: Final = ("id", "t", "x", "y")
"""What the rows of every recording have."""

KIND_WORDS: Final = {
    **{kind.value: kind for kind in AgentKind},
    **dict.fromkeys(("vehicle", "van"), AgentKind.CAR),
    **dict.fromkeys(("trailer", "truck_bus"), AgentKind.TRUCK),
    **dict.fromkeys(("cyclist", "bike"), AgentKind.BICYCLE),
    **dict.fromkeys(("walker", "person", "pedestrian/bicycle"), AgentKind.PEDESTRIAN),
    "motorbike": AgentKind.MOTORCYCLE,
}
"""The kind that each word of a table stands for, whatever its format."""

MOVING_MPS: Final = 0.5
"""From this speed on, the direction of motion is taken for the heading (noise of some centimetres
at 10 Hz is slower)."""

MOST_EMPTY: Final = 0.5
"""Share of the fields of a column of numbers that may be empty or infinite."""

_SEPARATOR_LINE: Final = re.compile(r'"?sep=(.)"?\r?\n', re.IGNORECASE)
_DECIMAL: Final = re.compile(r"\s*[-+]?\d*([.,])\d+(?:[eE][-+]?\d+)?\s*")
_NO_NUMBER: Final = re.compile(
    r"In CSV column #(\d+): (?:Row #(\d+): )?CSV conversion error to double: invalid value (.*)"
)
"""Arrow's message about a field that is not a number."""


# --- the beginning of a file --------------------------------------------------------------------


def beginning_of(path: Path) -> tuple[bytes, tuple[str, ...]]:
    """The beginning of a file, and the names of its columns in lower case if it is a table.

    Text in UTF-16 is decoded; both are empty where the file cannot be unpacked.
    """
    stat = path.stat()  # it is read once as long as the file stays as it is
    return _beginning(path, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=1024)
def _beginning(path: Path, changed_ns: int, size: int) -> tuple[bytes, tuple[str, ...]]:
    """See `beginning_of`."""
    try:
        head, encoding = _head_of(path)
    except (OSError, EOFError, zlib.error):
        return b"", ()
    try:
        with opened(path) as file:
            if head.startswith(PARQUET):
                names = pyarrow.parquet.read_schema(file).names
            elif head.startswith(FEATHER[0]):
                names = pa.ipc.open_file(file).schema.names
            else:
                names = _dialect_of(head, encoding).header if head else ()
        return head[:4096], tuple(name.lower() for name in names)
    except (pa.ArrowException, OSError, EOFError, InputError, ValueError):
        return head[:4096], ()  # whoever reads it says why


def _head_of(path: Path) -> tuple[bytes, str]:
    """The beginning of a file without a byte order mark, UTF-16 as UTF-8, and its encoding."""
    with opened(path) as file:
        head = file.read(HEAD_BYTES)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return head.decode("utf-16", "ignore").encode(), "utf-16"
    for encoding, first in (("utf-16-be", 0), ("utf-16-le", 1)):
        if len(head) > 8 and not head[first:64:2].strip(b"\0"):
            return head.decode(encoding, "ignore").encode(), encoding
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return head, "latin-1"
    return head.removeprefix(codecs.BOM_UTF8), "utf-8"


class _Dialect(NamedTuple):
    """How a CSV file is written; names of columns are in lower case."""

    encoding: str
    delimiter: str
    decimal: str
    skipped: int
    header: tuple[str, ...]


def _dialect_of(head: bytes, encoding: str) -> _Dialect:
    """How a CSV file is written, told from its beginning."""
    text = head.decode("latin-1" if encoding == "latin-1" else "utf-8", "ignore")
    if "\0" in text:
        raise InputError("found no text, expected a table as CSV, Parquet or Feather")
    stated = _SEPARATOR_LINE.match(text)
    first, *lines = text[stated.end() if stated else 0 :].splitlines() or [""]
    delimiter = stated[1] if stated else max(",;\t|", key=first.count)
    fields = [field for row in csv.reader(lines[:199], delimiter=delimiter) for field in row]
    points = {found[1] for field in fields if (found := _DECIMAL.fullmatch(field))}
    header = tuple(name.strip().strip('"').strip().lower() for name in first.split(delimiter))
    decimal = "," if points == {","} else "."
    return _Dialect(encoding, delimiter, decimal, 2 if stated else 1, header)


# --- tables -------------------------------------------------------------------------------------


def read_table(
    path: Path, numbers: Sequence[str], words: Sequence[str] = (), optional: Collection[str] = ()
) -> pandas.DataFrame:
    """Some columns, named in lower case, of a Parquet or Feather file, or of a CSV file.

    A CSV file has a header, fields separated by comma, semicolon, tab or bar, and decimals by point
    or comma, in UTF-8 or UTF-16. Words become categories; numbers that are not finite become NaN.
    Those that are ``optional`` may be missing, and may be empty anywhere.
    """
    with broken_as_one_line(path, "a table"):
        head, encoding = _head_of(path)
        if head.startswith((PARQUET, *FEATHER)):
            stored = _read_stored(path, head, [*numbers, *words], words, optional)
        else:
            dialect = _dialect_of(head, encoding)
            stored = _read_csv(path, dialect, [*numbers, *words], words, optional)
        if not stored.num_rows:
            raise InputError("found no rows, expected at least one")
        table = stored.to_pandas()
        for name in table:
            empty = table[name].isna() if name in words else ~np.isfinite(table[name])
            most = 1.0 if name in optional else 0.0 if name in words else MOST_EMPTY
            if empty.sum() > most * empty.size:
                row = int(empty.argmax())
                found = table[name].iloc[row]
                raise InputError(
                    f"column {name}, row {row + 2}: found "
                    f"{'an empty field' if pandas.isna(found) else found}, expected a value"
                )
            if empty.any() and name not in words:
                table[name] = table[name].where(~empty)
        return table


def _read_stored(
    path: Path, head: bytes, wanted: list[str], words: Sequence[str], optional: Collection[str]
) -> pa.Table:
    """Columns of a Parquet or Feather file."""
    if head.startswith(PARQUET):
        with opened(path) as file:
            # texts stay dictionaries: a small file can repeat a long text for millions of rows
            names = pyarrow.parquet.read_schema(file).names
            kept = _each_once([name.lower() for name in names], wanted, optional)
            texts = [name for name in names if name.lower() in words]
            stored = pyarrow.parquet.ParquetFile(file, read_dictionary=texts)
            table = stored.read([n for n in names if n.lower() in kept], use_threads=False)
    else:
        source = pa.BufferReader(read_bytes(path))
        table = pyarrow.feather.read_table(source, use_threads=False, memory_map=False)
    table = table.rename_columns([name.lower() for name in table.column_names])
    table = table.select(_each_once(table.column_names, wanted, optional))
    for at, field in enumerate(table.schema):
        if field.name in words:
            column = table.column(at)
            if pa.types.is_dictionary(field.type):  # some writers have texts as bytes
                column = column.cast(pa.dictionary(field.type.index_type, pa.string()))
            else:
                column = column.cast(pa.string()).dictionary_encode()
            table = table.set_column(at, field.name, column)
        elif not (pa.types.is_integer(field.type) or pa.types.is_floating(field.type)):
            raise InputError(f"column {field.name}: found {field.type!s:.60}, expected numbers")
    return table


def _read_csv(
    path: Path, dialect: _Dialect, wanted: list[str], words: Sequence[str],
    optional: Collection[str],
) -> pa.Table:  # fmt: skip
    """Columns of a CSV file as numbers and dictionaries of texts."""
    text = pa.dictionary(pa.int32(), pa.string())
    types = {name: text if name in words else pa.float64() for name in wanted}
    kept = _each_once(dialect.header, wanted, optional)
    # columns that are not read may have any name, even the same name twice
    names = [name if name in kept else f"#{i}" for i, name in enumerate(dialect.header)]
    reading = pyarrow.csv.ReadOptions(
        column_names=names, skip_rows=dialect.skipped, use_threads=False, encoding=dialect.encoding
    )
    converting = pyarrow.csv.ConvertOptions(
        column_types=types, include_columns=kept, null_values=EMPTY, decimal_point=dialect.decimal
    )
    if not dialect.encoding.startswith("utf-16"):  # else lines would be read as one field
        with opened(path) as file:
            odd = next((k for k, line in enumerate(file, 1) if line.count(b'"') % 2), None)
        if odd is not None:
            raise InputError(f"line {odd}: found a quotation mark that is not closed")
    try:
        with opened(path) as file:
            return pyarrow.csv.read_csv(
                file, reading, pyarrow.csv.ParseOptions(delimiter=dialect.delimiter), converting
            )
    except (pa.ArrowException, UnicodeError) as error:
        said = " ".join(str(error).split())
        bad = _NO_NUMBER.search(said)
        if bad is not None:
            row = f", row {bad[2]}" if bad[2] else ""
            said = f"column {names[int(bad[1])]}{row}: found {bad[3]:.60}, expected a number"
        raise InputError(f"{said:.300}") from None


def _each_once(names: Sequence[str], wanted: Sequence[str], optional: Collection[str]) -> list[str]:
    """The wanted columns that a file has; each must be there once, unless it is optional."""
    for name in wanted:
        count = list(names).count(name)
        if count > 1:
            raise InputError(f"found column {name} {count} times, expected once")
    check_there(names, [name for name in wanted if name not in optional])
    return [name for name in wanted if name in names]


def check_there(names: Sequence[str], wanted: Iterable[str]) -> None:
    """Refuse a table whose columns have these names unless all that are wanted are there."""
    if absent := [name for name in wanted if name not in names]:
        expected = f"expected a column {', a column '.join(absent)}"
        raise InputError(f"found the columns {', '.join(names)!r:.160}, {expected}")


def read_text(
    path: Path, header: Sequence[str], numbers: Sequence[str], words: Sequence[str] = ()
) -> pandas.DataFrame:
    """Columns of numbers and of words of a file without a header, split by white space.

    The header are the names of all columns, in order, as far as they are read.
    """
    wanted = [*numbers, *words]
    types = [(name, "U80" if name in words else "f8") for name in wanted]
    places = [header.index(name) for name in wanted]
    try:
        with opened(path) as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of no data, which is an error below
            rows = np.loadtxt(file, dtype=types, comments=None, usecols=places, ndmin=1)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if not len(rows):
        raise InputError(f"{path}: found no rows, expected at least one")
    return pandas.DataFrame({name: rows[name] for name in wanted})


# --- rows ---------------------------------------------------------------------------------------


def read_columns(
    path: Path, columns: Mapping[str, str], words: Collection[str] = (),
    optional: Collection[str] = (),
) -> pandas.DataFrame:  # fmt: skip
    """The columns of a table that `rows_of` takes, and further ones of text."""
    texts = [columns[key] for key in ("id", "kind") if key in columns]
    # one column may be two things, such as length and width
    numbers = dict.fromkeys(name for key, name in columns.items() if key not in ("id", "kind"))
    return read_table(path, [*numbers], [*texts, *words], optional)


def rows_of(
    table: pandas.DataFrame,
    columns: Mapping[str, str],
    units: Mapping[str, str] | None = None,
    kinds: Mapping[str, AgentKind] = KIND_WORDS,
    *,
    from_zero: bool = False,
) -> pandas.DataFrame:
    """Rows of a recording in SI units, as `sim.formats.common.recording.recorded` takes them.

    Args:
        table: as `read_table` gives it, or a part of it.
        columns: name in the table of ``id``, ``t``, ``x``, ``y``, and of any of ``heading``,
            ``speed``, ``vx``, ``vy``, ``length``, ``width``, ``kind``. Those that the table does
            not have are left out.
        units: of columns that are in no SI unit, as `sim.units.in_si` takes them.
        kinds: the kind that each word of the column ``kind`` stands for.
        from_zero: whether the first time becomes 0.

    Returns:
        Rows; headings that are missing are those of velocities above `MOVING_MPS`.

    Raises:
        InputError: naming the column that has a word which is no kind.
    """
    rows: dict[str, Any] = {}
    for key, name in columns.items():
        if name not in table:
            continue
        if key == "id":
            rows[key] = table[name]
        elif key == "kind":
            rows[key] = kinds_in(table[name], kinds)
        else:
            values = table[name].to_numpy(np.float64)
            if from_zero and key == "t":
                values = values - np.nanmin(values)
            rows[key] = in_si(values, (units or {}).get(key, ""))
    vx, vy = rows.pop("vx", None), rows.pop("vy", None)
    if vx is not None and vy is not None:
        rows["speed"] = np.hypot(vx, vy)
        course = np.where(rows["speed"] >= MOVING_MPS, np.arctan2(vy, vx), np.nan)
        heading = rows.get("heading", course)
        rows["heading"] = np.where(np.isnan(heading), course, heading)
    return pandas.DataFrame(rows, index=table.index)


def words_in(column: pandas.Series) -> list[str | None]:
    """The texts of a column; None where it is empty."""
    return list(column.astype(object).where(column.notna(), None))


def kinds_in(
    column: pandas.Series, known: Mapping[str, AgentKind] = KIND_WORDS
) -> NDArray[np.int8]:
    """(m,) codes of the kinds that words stand for, in upper or lower case; all must be known."""
    lower = {word.lower(): kind.code for word, kind in known.items()}
    code, words = pandas.factorize(column)
    wrong = next((word for word in words if word.strip().lower() not in lower), None)
    if wrong is not None or (code < 0).any():
        found = "an empty field" if wrong is None else f"{wrong.strip()!r:.60}"
        raise InputError(f"column {column.name}: found {found}, expected one of {', '.join(known)}")
    known_codes = np.array([lower[word.strip().lower()] for word in words], dtype=np.int8)
    return np.asarray(known_codes[code])


def among(
    table: pandas.DataFrame, name: str, known: Collection[str]
) -> tuple[pandas.DataFrame, list[str]]:
    """The rows in which a column has one of some words, and the other words there."""
    return table[table[name].isin(known)], sorted({*table[name].unique()} - {*known})


def by_word(table: pandas.DataFrame, name: str) -> list[tuple[str, pandas.DataFrame]]:
    """The rows of each word of a column; all, under no word, where the table lacks it."""
    if name not in table:
        return [("", table)]
    if table[name].isna().any():
        raise InputError(f"column {name}: found an empty field, expected a value")
    return [(str(word), part) for word, part in table.groupby(name, observed=True, sort=False)]


def finite(table: pandas.DataFrame, name: str) -> FloatArray:
    """(m,) a column of numbers, all of which must be finite."""
    values: FloatArray = table[name].to_numpy(np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        found = "an empty field" if np.isnan(values[bad[0]]) else values[bad[0]]
        raise InputError(
            f"column {name}, row {table.index[bad[0]] + 2}: found {found}, expected a number"
        )
    return values


def whole(table: pandas.DataFrame, name: str) -> NDArray[np.int64]:
    """(m,) a column of numbers, all of which must be whole."""
    values = table[name].to_numpy()
    if values.dtype.kind not in "iu":
        values = finite(table, name)
    bad = np.flatnonzero((values != np.rint(values)) | (np.abs(values) >= 2.0**63))
    if bad.size:
        raise InputError(f"column {name}: found {values[bad[0]]}, expected whole numbers")
    return np.asarray(values, dtype=np.int64)
