"""Named columns of CSV, Parquet and Feather files, and of text without a header, as arrays."""

from __future__ import annotations

import codecs
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.input_files import broken_as_one_line, opened, read_bytes
from sim.units import in_si

FloatArray = NDArray[np.float64]

HEADER_BYTES: Final = 65536
"""Longest first line of a CSV file (the longest known has 300)."""

CHUNK_BYTES: Final = 2**22
"""How much of a file is looked at at once."""

_NO_NUMBER: Final = re.compile(
    r"In CSV column #(\d+): (?:Row #(\d+): )?CSV conversion error to double: invalid value (.*)"
)
"""What Arrow says of a field that is no number."""


@dataclass(frozen=True)
class Table:
    """Some columns of a file.

    Attributes:
        path: the file.
        columns: one column per name: float64, or dictionaries of strings.
    """

    path: Path
    columns: pa.Table

    def __contains__(self, name: str) -> bool:
        """Whether the file has the column."""
        return name in self.columns.column_names

    def __len__(self) -> int:
        """How many rows there are."""
        return int(self.columns.num_rows)

    def numbers(self, name: str, unit: str = "") -> FloatArray:
        """(m,) a column of finite numbers in SI units.

        Args:
            name: of the column.
            unit: that the column is in, as `sim.units.in_si` takes it.

        Raises:
            InputError: naming the column and the row of the first that is not finite.
        """
        values = self.columns.column(name).to_numpy().astype(np.float64)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"{self.path}: column {name}, row {int(bad[0]) + 2}: found {values[bad[0]]}, "
                "expected a finite number"
            )
        return in_si(values, unit)

    def whole(self, name: str) -> NDArray[np.int64]:
        """(m,) a column of whole numbers.

        Raises:
            InputError: if it has others.
        """
        values = self.columns.column(name).to_numpy()
        bad = np.flatnonzero(values != np.rint(values))
        if bad.size or not (np.abs(values) < 2**63).all():
            found = values[bad[0]] if bad.size else "one of more than 63 bits"
            raise InputError(f"{self.path}: column {name}: found {found}, expected whole numbers")
        return np.asarray(values, dtype=np.int64)

    def words(self, name: str) -> list[Any]:
        """The texts of a column; None where it is empty."""
        found: list[Any] = self.columns.column(name).to_pylist()
        return found

    def codes(self, name: str) -> tuple[NDArray[np.int64], list[str]]:
        """(m,) the place of each text among the different ones of a column (-1: empty), and those.

        The different texts are in the order in which they first occur.
        """
        column = self.columns.column(name)
        if not pa.types.is_dictionary(column.type):  # numbers as names
            column = column.cast(pa.string()).dictionary_encode()
        column = column.unify_dictionaries().combine_chunks()
        different = column.dictionary.dictionary_encode()  # a file's own may have a text twice
        places = np.append(different.indices.to_numpy(), -1)
        codes = places[column.indices.fill_null(-1).to_numpy()]
        return codes.astype(np.int64), different.dictionary.to_pylist()

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
            words = [str(words[code]) for code, (_, words) in zip(codes, coded, strict=True)]
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

    def part(self, rows: NDArray[np.int64]) -> Table:
        """Some of the rows, by their indices."""
        return Table(self.path, self.columns.take(pa.array(rows)))


def read_header(path: Path) -> list[str]:
    """Names in the first line of a CSV file, in lower case.

    Raises:
        InputError: if the line is too long or not UTF-8.
    """
    with opened(path) as file:
        line = file.readline(HEADER_BYTES + 1).removeprefix(codecs.BOM_UTF8)
    if len(line) > HEADER_BYTES:
        raise InputError(f"{path}: line 1: found no end within {HEADER_BYTES} bytes")
    try:
        text = line.decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: line 1: found bytes that are not UTF-8") from None
    first = (text.splitlines() or [""])[0].lower()
    return [name.strip().strip('"') for name in first.split(",")]


def read_csv(
    path: Path, numbers: Sequence[str], words: Sequence[str] = (), optional: Sequence[str] = ()
) -> Table:
    """Read some columns of a CSV file with a header; upper and lower case do not matter.

    Args:
        path: the file, gzipped where its name ends in ``.gz``.
        numbers: names, in lower case, of columns of numbers.
        words: names of columns of text.
        optional: those of ``numbers`` and ``words`` that may be missing.

    Raises:
        InputError: naming the file and the column or row that is wrong.
    """
    header = read_header(path)
    types = dict.fromkeys(numbers, pa.float64())
    types |= dict.fromkeys(words, pa.dictionary(pa.int32(), pa.string()))
    wanted = _each_once(path, header, list(types), optional)
    # columns that are not read may have any name, even the same name twice
    names = [name if name in wanted else f"#{i}" for i, name in enumerate(header)]
    _check_quotes(path)
    try:
        with opened(path) as file:
            table = pyarrow.csv.read_csv(
                file,
                pyarrow.csv.ReadOptions(column_names=names, skip_rows=1, use_threads=False),
                convert_options=pyarrow.csv.ConvertOptions(
                    column_types=types, include_columns=wanted, null_values=[]
                ),
            )
    except pa.ArrowException as error:
        said = " ".join(str(error).split())
        bad = _NO_NUMBER.search(said)
        if bad is not None:
            row = f", row {bad[2]}" if bad[2] else ""
            said = f"column {names[int(bad[1])]}{row}: found {bad[3]:.60}, expected a number"
        raise InputError(f"{path}: {said:.300}") from None
    return _filled(path, table)


def _check_quotes(path: Path) -> None:
    """Refuse a quotation mark that is not closed in its line: lines would be read as one field."""
    with opened(path) as file:
        if not any(b'"' in chunk for chunk in iter(lambda: file.read(CHUNK_BYTES), b"")):
            return
        file.seek(0)
        for number, line in enumerate(file, 1):
            if line.count(b'"') % 2:
                raise InputError(
                    f"{path}: line {number}: found a quotation mark that is not closed, expected "
                    "pairs around fields"
                )


def read_text(path: Path, header: Sequence[str], wanted: Sequence[str]) -> Table:
    """Read columns of numbers from a file without a header, fields separated by white space.

    Args:
        path: the file.
        header: names of all columns, in order.
        wanted: names of those to read.

    Raises:
        InputError: naming the file and the row that is wrong.
    """
    places = [header.index(name) for name in wanted]
    try:
        with opened(path) as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of no data, which is an error below
            rows = np.loadtxt(file, comments=None, usecols=places, ndmin=2)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    columns = {name: rows[:, i] for i, name in enumerate(wanted)}
    return _filled(path, pa.table(columns))


def read_parquet(
    path: Path, numbers: Sequence[str], words: Sequence[str], empty: Sequence[str] = ()
) -> Table:
    """Read some columns of a Parquet file.

    Args:
        path: the file.
        numbers: names of columns of numbers.
        words: names of columns of text; numbers in them become text.
        empty: those that may have empty fields.

    Raises:
        InputError: naming the file and the column that is wrong.
    """
    with broken_as_one_line(path, "a Parquet table"), opened(path) as file:
        # texts stay dictionaries: a small file can repeat a long text for millions of rows
        stored = pyarrow.parquet.ParquetFile(file, read_dictionary=list(words))
        wanted = _each_once(path, stored.schema_arrow.names, [*numbers, *words])
        return _typed(path, stored.read(wanted, use_threads=False), numbers, words, empty)


def read_feather(path: Path, numbers: Sequence[str], words: Sequence[str]) -> Table:
    """Read some columns of a Feather file.

    Args:
        path: the file, gzipped where its name ends in ``.gz``.
        numbers: names of columns of numbers.
        words: names of columns of text.

    Raises:
        InputError: naming the file and the column that is wrong.
    """
    source = pa.BufferReader(read_bytes(path))
    with broken_as_one_line(path, "a Feather table"):
        table = pyarrow.feather.read_table(source, use_threads=False, memory_map=False)
    wanted = _each_once(path, table.column_names, [*numbers, *words])
    return _typed(path, table.select(wanted), numbers, words, ())


def _each_once(
    path: Path, names: Sequence[str], wanted: Sequence[str], optional: Sequence[str] = ()
) -> list[str]:
    """The wanted columns that a file has; each must be there once, unless it is optional."""
    for name in wanted:
        count = list(names).count(name)
        if count > 1:
            raise InputError(f"{path}: found column {name} {count} times, expected once")
        if count == 0 and name not in optional:
            raise InputError(f"{path}: found {','.join(names)!r:.120}, expected a column {name}")
    return [name for name in wanted if name in names]


def _typed(
    path: Path, table: pa.Table, numbers: Sequence[str], words: Sequence[str], empty: Sequence[str]
) -> Table:
    """Columns as numbers, whole ones to the last digit, and dictionaries of texts."""
    columns = {name: table.column(name) for name in numbers}
    for name, column in columns.items():
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
            raise InputError(f"{path}: column {name}: found {column.type!s:.60}, expected numbers")
    for name in words:
        column = table.column(name)
        if not pa.types.is_dictionary(column.type):
            column = column.cast(pa.string()).dictionary_encode()
        columns[name] = column.cast(pa.dictionary(column.type.index_type, pa.string()))
    return _filled(path, pa.table(columns), empty)


def _filled(path: Path, table: pa.Table, empty: Sequence[str] = ()) -> Table:
    """A table with rows, and without empty fields."""
    if not table.num_rows:
        raise InputError(f"{path}: found no rows, expected at least one")
    for name in table.column_names:
        if table.column(name).null_count and name not in empty:
            raise InputError(f"{path}: column {name}: found an empty field, expected a value")
    return Table(path, table)
