"""Named columns of CSV, Parquet and Feather files, and of text without a header, as arrays."""

from __future__ import annotations

import codecs
import csv
import gzip
import re
import warnings
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
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

DELIMITERS: Final = ",;\t|"
EMPTY: Final = ("", "NA", "null", "None")
"""What stands in a field of a CSV file that has no value."""

_ENCODINGS: Final = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_SEPARATOR_LINE: Final = re.compile(r'"?sep=(.)"?\r?\n', re.IGNORECASE)
_DECIMAL_COMMA: Final = re.compile(r"\s*[-+]?\d+,\d+(?:[eE][-+]?\d+)?\s*")
_DECIMAL_POINT: Final = re.compile(r"\s*[-+]?\d*\.\d+(?:[eE][-+]?\d+)?\s*")
_NO_NUMBER: Final = re.compile(
    r"In CSV column #(\d+): (?:Row #(\d+): )?CSV conversion error to double: invalid value (.*)"
)
"""What Arrow says of a field that is no number."""


def head_of(path: Path) -> bytes:
    """The beginning of a file as UTF-8 without a byte order mark; b"" where it cannot be unpacked.

    Args:
        path: the file; text in UTF-16 is decoded, everything else stays as it is.
    """
    try:
        with opened(path) as file:
            head = file.read(HEAD_BYTES)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        return b""
    encoding = _encoding(head)
    if encoding.startswith("utf-16"):
        return head.decode(encoding, "ignore").encode()
    return head.removeprefix(codecs.BOM_UTF8)


def _encoding(head: bytes) -> str:
    """The encoding of a text: UTF-16 by its mark or its zeros, UTF-8, or Latin-1."""
    for mark, name in _ENCODINGS:
        if head.startswith(mark):
            return name
    if len(head) > 8 and not head[0:64:2].strip(b"\0"):
        return "utf-16-be"
    if len(head) > 8 and not head[1:64:2].strip(b"\0"):
        return "utf-16-le"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


class _Dialect(NamedTuple):
    """How a CSV file is written; names of columns are in lower case."""

    encoding: str
    delimiter: str
    decimal: str
    skipped: int
    header: tuple[str, ...]


def _dialect_of(path: Path) -> _Dialect:
    """How a CSV file is written, told from its beginning."""
    with opened(path) as file:
        encoding = _encoding(file.read(HEAD_BYTES))
    text = head_of(path).decode("utf-8" if encoding.startswith("utf-16") else encoding, "ignore")
    if "\0" in text:
        raise InputError(f"{path}: found no text, expected a table as CSV, Parquet or Feather")
    stated = _SEPARATOR_LINE.match(text)
    lines = text[stated.end() if stated else 0 :].splitlines()
    first = lines[0] if lines else ""
    if len(text) >= HEAD_BYTES // 2 and len(lines) < 2:
        raise InputError(f"{path}: line 1: found no end within {HEAD_BYTES} bytes")
    delimiter = stated[1] if stated else max(DELIMITERS, key=first.count)
    fields = [field for row in csv.reader(lines[1:200], delimiter=delimiter) for field in row]
    commas = any(_DECIMAL_COMMA.fullmatch(field) for field in fields)
    points = any(_DECIMAL_POINT.fullmatch(field) for field in fields)
    header = tuple(name.strip().strip('"').strip().lower() for name in first.split(delimiter))
    decimal = "," if commas and not points else "."
    return _Dialect(encoding, delimiter, decimal, 2 if stated else 1, header)


def column_names(path: Path, head: bytes | None = None) -> tuple[str, ...]:
    """Names of a table's columns in lower case; () where the file is no table.

    Args:
        path: a CSV, Parquet or Feather file.
        head: its beginning, if it is known.
    """
    head = head_of(path) if head is None else head
    try:
        with opened(path) as file:
            if head.startswith(PARQUET):
                names = pyarrow.parquet.read_schema(file).names
            elif head.startswith(FEATHER[0]):
                names = pa.ipc.open_file(file).schema.names
            else:
                return _dialect_of(path).header if head else ()
        return tuple(name.lower() for name in names)
    except (pa.ArrowException, OSError, EOFError, zlib.error, InputError, ValueError):
        return ()  # whoever reads it says why


@dataclass(frozen=True)
class Table:
    """Some columns of a file.

    Attributes:
        path: the file.
        columns: numbers and texts.
        empty: columns that may have empty fields.
    """

    path: Path
    columns: pandas.DataFrame
    empty: frozenset[str] = frozenset()

    def __contains__(self, name: str) -> bool:
        """Whether the file has the column."""
        return name in self.columns

    def __len__(self) -> int:
        """How many rows there are."""
        return len(self.columns)

    def numbers(self, name: str, unit: str = "") -> FloatArray:
        """(m,) a column of finite numbers in SI units.

        Args:
            name: of the column.
            unit: that the column is in, as `sim.units.in_si` takes it.

        Raises:
            InputError: naming the column and the row of the first that is not finite.
        """
        return self._finite(name, unit, 0.0)

    def measured(self, name: str, unit: str = "") -> FloatArray:
        """(m,) a column of numbers in SI units, NaN where a field is empty or not finite.

        Args:
            name: of the column; all is NaN where the file does not have it.
            unit: that the column is in.

        Raises:
            InputError: if more than half of the fields of a column that is not `empty` are NaN.
        """
        if name not in self:
            return np.full(len(self), np.nan)
        return self._finite(name, unit, 1.0 if name in self.empty else 0.5)

    def stacked(self, *names: str, unit: str = "") -> FloatArray:
        """(m, len(names)) columns as `measured` has them, side by side."""
        return np.stack([self.measured(name, unit) for name in names], axis=1)

    def _finite(self, name: str, unit: str, share: float) -> FloatArray:
        values = self.columns[name].to_numpy(np.float64, copy=True)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size > share * values.size:
            found = values[bad[0]]
            raise InputError(
                f"{self.path}: column {name}, row {bad[0] + 2}: found "
                f"{'an empty field' if np.isnan(found) else found}, expected a finite number"
            )
        values[bad] = np.nan
        return in_si(values, unit)

    def whole(self, name: str) -> NDArray[np.int64]:
        """(m,) a column of whole numbers.

        Raises:
            InputError: if it has others.
        """
        values = self.columns[name].to_numpy()
        if values.dtype.kind not in "iu":
            values = self.numbers(name)
        bad = np.flatnonzero(values != np.rint(values))
        if bad.size or not (np.abs(values) < 2**63).all():
            found = values[bad[0]] if bad.size else "one of more than 63 bits"
            raise InputError(f"{self.path}: column {name}: found {found}, expected whole numbers")
        return np.asarray(values, dtype=np.int64)

    def words(self, name: str) -> list[Any]:
        """The texts of a column; None where it is empty."""
        code, words = self.codes(name)
        return [words[k] if k >= 0 else None for k in code.tolist()]

    def codes(self, name: str) -> tuple[NDArray[np.int64], list[str]]:
        """(m,) the place of each text among the different ones of a column (-1: empty), and those.

        The different texts are in the order in which they first occur.
        """
        code, words = pandas.factorize(self.columns[name])
        if getattr(words, "dtype", None) == np.float64:  # numbers as names
            return code.astype(np.int64), [f"{word:.17g}" for word in words]
        return code.astype(np.int64), [str(word) for word in words]

    def names(self, *columns: str) -> tuple[NDArray[np.int64], tuple[str, ...]]:
        """(m,) index of each row's agent, and the agents' names, from columns that identify them.

        The values of further columns are added to a name only where the first is not unique.
        """
        coded = [self.codes(column) for column in columns]
        unique, agent = np.unique(
            np.stack([codes for codes, _ in coded]), axis=1, return_inverse=True
        )
        first, counts = np.unique(unique[0], return_counts=True)
        several = set(first[counts > 1].tolist())
        labels = []
        for codes in unique.T.tolist():
            words = [words[code] for code, (_, words) in zip(codes, coded, strict=True)]
            labels.append("-".join(words) if codes[0] in several else words[0])
        return agent.ravel().astype(np.int64), tuple(labels)

    def only(self, name: str, agent: NDArray[np.int64]) -> list[Any]:
        """The one value of a column that each agent has in all its rows.

        Raises:
            InputError: naming an agent's row that has another value.
        """
        code, words = self.codes(name)
        _, first = np.unique(agent, return_index=True)
        other = np.flatnonzero(code != code[first][agent])
        if other.size:
            row = int(other[0])
            raise InputError(
                f"{self.path}: column {name}, row {row + 2}: found {words[code[row]]!r:.60}, "
                f"expected {words[code[first[agent[row]]]]!r:.60} as in the agent's first row"
            )
        return [words[c] for c in code[first].tolist()]

    def kinds(
        self, name: str, agent: NDArray[np.int64], known: Mapping[str, AgentKind]
    ) -> list[AgentKind]:
        """The kind of each agent, from the word that a column has in all its rows.

        Args:
            name: of the column.
            agent: (m,) of each row.
            known: the kind of each word; upper and lower case do not matter.

        Raises:
            InputError: naming the first word that is not known.
        """
        lower = {word.lower(): kind for word, kind in known.items()}
        words = [word.strip() for word in self.only(name, agent)]
        wrong = next((word for word in words if word.lower() not in lower), None)
        if wrong is not None:
            raise InputError(
                f"{self.path}: column {name}: found {wrong!r:.60}, expected one of "
                f"{', '.join(known)}"
            )
        return [lower[word.lower()] for word in words]

    def among(self, name: str, known: Collection[str]) -> tuple[NDArray[np.int64], list[str]]:
        """(k,) the rows in which a column has one of some words, and the other words there."""
        codes, words = self.codes(name)
        return np.flatnonzero(np.isin(words, list(known))[codes]), sorted({*words} - {*known})

    def part(self, rows: NDArray[np.int64]) -> Table:
        """Some of the rows, by their indices."""
        return Table(self.path, self.columns.iloc[rows], self.empty)

    def by_word(self, name: str) -> list[tuple[str, Table]]:
        """The rows of each word of a column; all, under no word, where the file lacks it."""
        if name not in self:
            return [("", self)]
        code, words = self.codes(name)
        return [(word, self.part(np.flatnonzero(code == k))) for k, word in enumerate(words)]


def joined(one: Table, other: Table) -> Table:
    """Rows of two tables; fields of columns that one of them lacks are empty."""
    return Table(one.path, pandas.concat([one.columns, other.columns]), one.empty)


def read_table(
    path: Path,
    numbers: Sequence[str],
    words: Sequence[str] = (),
    optional: Sequence[str] = (),
    empty: Sequence[str] = (),
) -> Table:
    """Read some columns of a table; upper and lower case of their names do not matter.

    Args:
        path: a Parquet file, a Feather file, or a CSV file with a header: fields separated by
            comma, semicolon, tab or bar, decimals by point or comma, in UTF-8 or UTF-16; gzipped
            where its name ends in ``.gz``.
        numbers: names, in lower case, of columns of numbers.
        words: names of columns of text; numbers in them become text.
        optional: those of ``numbers`` and ``words`` that may be missing.
        empty: those that may have empty fields.

    Raises:
        InputError: naming the file and the column or row that is wrong.
    """
    head, wanted = head_of(path), [*numbers, *words]
    if head.startswith((PARQUET, *FEATHER)):
        with broken_as_one_line(path, "a table"):
            table = _stored(path, head, wanted, words, optional)
    else:
        table = _read_csv(path, wanted, words, optional)
    if not table.num_rows:
        raise InputError(f"{path}: found no rows, expected at least one")
    for name in table.column_names:
        column = table.column(name)
        if name in words and name not in empty and column.null_count:
            raise InputError(f"{path}: column {name}: found an empty field, expected a value")
        if name not in words and pa.types.is_integer(column.type) and column.null_count:
            table = table.set_column(
                table.column_names.index(name), name, column.cast(pa.float64())
            )
    with broken_as_one_line(path, "a table"):
        return Table(path, table.to_pandas(), frozenset(empty))


def _stored(
    path: Path, head: bytes, wanted: list[str], words: Sequence[str], optional: Sequence[str]
) -> pa.Table:
    """Columns of a Parquet or Feather file."""
    if head.startswith(PARQUET):
        with opened(path) as file:
            # texts stay dictionaries: a small file can repeat a long text for millions of rows
            names = pyarrow.parquet.read_schema(file).names
            kept = _each_once(path, [name.lower() for name in names], wanted, optional)
            texts = [name for name in names if name.lower() in words]
            stored = pyarrow.parquet.ParquetFile(file, read_dictionary=texts)
            table = stored.read([n for n in names if n.lower() in kept], use_threads=False)
    else:
        source = pa.BufferReader(read_bytes(path))
        table = pyarrow.feather.read_table(source, use_threads=False, memory_map=False)
    table = table.rename_columns([name.lower() for name in table.column_names])
    table = table.select(_each_once(path, table.column_names, wanted, optional))
    for at, name in enumerate(table.column_names):
        kind = table.schema.field(name).type
        if name in words and not pa.types.is_integer(kind):  # some writers have texts as bytes
            if pa.types.is_dictionary(kind):
                text = table.column(name).cast(pa.dictionary(kind.index_type, pa.string()))
            else:
                text = table.column(name).cast(pa.string())
            table = table.set_column(at, name, text)
        elif name not in words and not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
            raise InputError(f"{path}: column {name}: found {kind!s:.60}, expected numbers")
    return table


def _read_csv(
    path: Path, wanted: list[str], words: Sequence[str], optional: Sequence[str]
) -> pa.Table:
    """Columns of a CSV file as numbers and dictionaries of texts."""
    dialect = _dialect_of(path)
    text = pa.dictionary(pa.int32(), pa.string())
    types = {name: text if name in words else pa.float64() for name in wanted}
    kept = _each_once(path, dialect.header, wanted, optional)
    # columns that are not read may have any name, even the same name twice
    names = [name if name in kept else f"#{i}" for i, name in enumerate(dialect.header)]
    if not dialect.encoding.startswith("utf-16"):  # else lines would be read as one field
        with opened(path) as file:
            odd = next((k for k, line in enumerate(file, 1) if line.count(b'"') % 2), None)
        if odd is not None:
            raise InputError(
                f"{path}: line {odd}: found a quotation mark that is not closed, expected pairs "
                "around fields"
            )
    try:
        with opened(path) as file:
            return pyarrow.csv.read_csv(
                file,
                pyarrow.csv.ReadOptions(
                    column_names=names, skip_rows=dialect.skipped, use_threads=False,
                    encoding=dialect.encoding,
                ),
                pyarrow.csv.ParseOptions(delimiter=dialect.delimiter),
                pyarrow.csv.ConvertOptions(
                    column_types=types, include_columns=kept, null_values=EMPTY,
                    decimal_point=dialect.decimal,
                ),
            )  # fmt: skip
    except (pa.ArrowException, UnicodeError) as error:
        said = " ".join(str(error).split())
        bad = _NO_NUMBER.search(said)
        if bad is not None:
            row = f", row {bad[2]}" if bad[2] else ""
            said = f"column {names[int(bad[1])]}{row}: found {bad[3]:.60}, expected a number"
        raise InputError(f"{path}: {said:.300}") from None


def read_text(
    path: Path, header: Sequence[str], numbers: Sequence[str], words: Sequence[str] = ()
) -> Table:
    """Read columns of a file without a header, fields separated by white space.

    Args:
        path: the file.
        header: names of the columns, in order, as far as they are read.
        numbers: names of columns of numbers.
        words: names of columns of text.

    Raises:
        InputError: naming the file and the row that is wrong.
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
    return Table(path, pandas.DataFrame({name: rows[name] for name in wanted}))


def _each_once(
    path: Path, names: Sequence[str], wanted: Sequence[str], optional: Sequence[str] = ()
) -> list[str]:
    """The wanted columns that a file has; each must be there once, unless it is optional."""
    for name in wanted:
        count = list(names).count(name)
        if count > 1:
            raise InputError(f"{path}: found column {name} {count} times, expected once")
        if count == 0 and name not in optional:
            raise InputError(
                f"{path}: found the columns {', '.join(names)!r:.160}, expected a column {name}"
            )
    return [name for name in wanted if name in names]
