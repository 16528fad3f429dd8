"""Named columns of a CSV file as arrays; a broken file raises one error that says what is wrong."""

from __future__ import annotations

import csv
import re
from codecs import BOM_UTF8
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.packed import lines_of, opened
from sim.formats.common.recording import MAX_NAMES, MAX_ROWS, check_size
from sim.written_numbers import real

MAX_HEADER_BYTES: Final = 65536
"""Longest first line (the longest known has 300)."""

MAX_LINE_BYTES: Final = 2**22
"""Longest line (as much as is parsed at a time)."""

CHUNK_BYTES: Final = 2**22
NEWLINE: Final = b"\n"

_LOOSE_QUOTE: Final = re.compile(rb'[^,"\r\n]"[^,"\r\n]')
"""A quotation mark within a field, neither at its beginning nor at its end."""

_COLUMN: Final = re.compile(r"In CSV column #(\d+): ")


@dataclass(frozen=True)
class Columns:
    """The columns that were asked for.

    Attributes:
        path: the file.
        table: one column per name asked for.
    """

    path: Path
    table: pa.Table

    def __contains__(self, name: str) -> bool:
        """Whether the file has the column."""
        return name in self.table.column_names

    def __len__(self) -> int:
        """How many rows there are."""
        return int(self.table.num_rows)

    def numbers(self, name: str) -> NDArray[np.float64]:
        """(m,) a column of numbers, all finite.

        Raises:
            InputError: naming the column and the row of the first that is not.
        """
        values: NDArray[np.float64] = self.table.column(name).to_numpy()
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"{self.path}: column {name}, row {int(bad[0]) + 2}: found {values[bad[0]]}, "
                "expected a finite number"
            )
        return values

    def names(self, *columns: str) -> tuple[NDArray[np.int64], tuple[str, ...]]:
        """(m,) index of each row's agent, and the agents' names, from columns that identify them.

        The values of further columns are added to a name only where the first is not unique.

        Raises:
            InputError: if there are more agents than fit.
        """
        keys = [self.table.column(c).combine_chunks().dictionary_encode() for c in columns]
        for column, key in zip(columns, keys, strict=True):
            if len(key.dictionary) > MAX_NAMES:
                raise InputError(
                    f"{self.path}: column {column}: found {len(key.dictionary)} different values, "
                    f"expected at most {MAX_NAMES}"
                )
        codes = np.stack([np.asarray(k.indices.to_numpy(), dtype=np.int64) for k in keys])
        unique, agent = np.unique(codes, axis=1, return_inverse=True)
        words = [k.dictionary.to_pylist() for k in keys]
        first, counts = np.unique(unique[0], return_counts=True)
        several = set(first[counts > 1].tolist())
        labels = tuple(
            "-".join(str(words[i][column[i]]) for i in range(len(columns)))
            if int(column[0]) in several
            else str(words[0][column[0]])
            for column in unique.T
        )
        return np.asarray(agent, dtype=np.int64).ravel(), labels

    def only(self, name: str, agent: NDArray[np.int64]) -> list[Any]:
        """The one value of a column that each agent has in all its rows.

        Raises:
            InputError: naming an agent's row that has another value.
        """
        _, at = np.unique(agent, return_index=True)
        code = np.asarray(self.table.column(name).combine_chunks().dictionary_encode().indices)
        other = np.flatnonzero(code != code[at][agent])
        column = self.table.column(name)
        if other.size:
            row = int(other[0])
            raise InputError(
                f"{self.path}: column {name}, row {row + 2}: found {column[row].as_py()!r:.60}, "
                f"expected {column[int(at[agent[row]])].as_py()!r:.60} as in the agent's first row"
            )
        values: list[Any] = column.take(pa.array(at)).to_pylist()
        return values


def read_header(path: Path) -> list[str]:
    """Names in the first line, in lower case.

    Raises:
        InputError: if the line is too long or not UTF-8.
    """
    with opened(path) as file:
        (line, *_) = file.readline(MAX_HEADER_BYTES + 1).split(b"\r", 1)  # which ends a line too
    if len(line) > MAX_HEADER_BYTES:
        raise InputError(f"{path}: line 1: found no end within {MAX_HEADER_BYTES} bytes")
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: line 1: found bytes that are not UTF-8") from None
    return [name.strip().strip('"').lower() for name in text.rstrip("\r\n").split(",")]


def read_columns(
    path: Path,
    numbers: Sequence[str],
    words: Sequence[str] = (),
    optional: Sequence[str] = (),
) -> Columns:
    """Read some columns of a CSV file with a header line; upper and lower case do not matter.

    Args:
        path: the file.
        numbers: names, in lower case, of columns of numbers.
        words: names of columns of text.
        optional: those of ``numbers`` and ``words`` that may be missing.

    Returns:
        The columns.

    Raises:
        InputError: naming the file and the column or row that is wrong.
    """
    check_size(path)
    check_lines(path)
    header = read_header(path)
    for name in (*numbers, *words):
        count = header.count(name)
        if count > 1:
            raise InputError(f"{path}: found column {name} {count} times, expected once")
        if count == 0 and name not in optional:
            raise InputError(
                f"{path}: line 1: found {','.join(header)!r:.120}, expected a column {name}"
            )
    types = {name: pa.float64() for name in numbers} | {name: pa.string() for name in words}
    wanted = [name for name in types if name in header]
    return Columns(path, _parse(path, header, wanted, types, skip=1, delimiter=","))


def read_fields(path: Path, header: Sequence[str], wanted: Sequence[str]) -> Columns:
    """Read columns of numbers from a file without a header, fields separated by white space.

    Args:
        path: the file.
        header: names of all columns, in order.
        wanted: names of those to read.

    Returns:
        The columns.

    Raises:
        InputError: naming the file and the line that is wrong.
    """
    check_size(path)
    columns: dict[str, list[float]] = {name: [] for name in wanted}
    places = [(columns[name], header.index(name)) for name in wanted]
    with opened(path) as file:
        for number, line in lines_of(path, file, MAX_HEADER_BYTES):
            fields = line.split()
            if not fields:
                continue
            if len(fields) != len(header):
                raise InputError(
                    f"{path}: line {number}: found {len(fields)} fields, expected {len(header)}"
                )
            if number > MAX_ROWS:
                raise InputError(f"{path}: found more than {MAX_ROWS} lines")
            try:
                for column, place in places:
                    column.append(real(fields[place]))
            except ValueError:
                raise InputError(
                    f"{path}: line {number}: found {line[:60]!r}, expected numbers"
                ) from None
    if not columns[wanted[0]]:
        raise InputError(f"{path}: found no rows, expected at least one")
    return Columns(path, pa.table({n: pa.array(v, pa.float64()) for n, v in columns.items()}))


def check_lines(path: Path) -> None:
    """Refuse lines that a reader of CSV files would split otherwise than an editor shows them.

    A quotation mark that is not closed in its line would join it with the next lines, also in a
    column that nobody reads.

    Args:
        path: a text file.

    Raises:
        InputError: naming the line that has a NUL byte or an open or misplaced quotation mark.
    """
    line = 1
    with opened(path) as file:
        mark = file.read(len(BOM_UTF8))
        rest = b"" if mark == BOM_UTF8 else mark
        while chunk := rest + file.read(CHUNK_BYTES - len(rest)):
            rest = b""
            if len(chunk) == CHUNK_BYTES:
                chunk += file.readline(MAX_LINE_BYTES)
            if b"\0" in chunk:
                at = line + chunk[: chunk.index(b"\0")].count(NEWLINE)
                raise InputError(f"{path}: line {at}: found a NUL byte, expected text")
            if b'"' in chunk:
                bad = _misplaced_quote(chunk)
                if bad is not None:
                    raise InputError(
                        f"{path}: line {line + bad}: found a quotation mark that does not enclose "
                        "a field, expected them in pairs around fields"
                    )
            line += chunk.count(NEWLINE)


def _misplaced_quote(chunk: bytes) -> int | None:
    """The first of some whole lines with a quotation mark that does not enclose a field."""
    code = np.frombuffer(chunk, dtype=np.uint8)
    open_after = np.cumsum(code == ord('"')) % 2 == 1
    ends = np.flatnonzero((code == ord("\n")) | (code == ord("\r")))
    broken = np.append(ends, code.size - 1)[open_after[np.append(ends, code.size - 1)]]
    if broken.size:
        return chunk[: int(broken[0])].count(NEWLINE)
    chunk = chunk.replace(b'""', b"")  # within a field, two stand for one
    match = _LOOSE_QUOTE.search(chunk)
    return None if match is None else chunk[: match.start()].count(NEWLINE)


def _parse(
    path: Path,
    header: Sequence[str],
    wanted: Sequence[str],
    types: Mapping[str, pa.DataType],
    skip: int,
    delimiter: str,
) -> pa.Table:
    # columns that are not read may have any name, even the same name twice
    names = [name if name in wanted else f"#{i}" for i, name in enumerate(header)]
    tables: list[pa.Table] = []
    rows = 0
    try:
        with pv.open_csv(
            path,
            read_options=pv.ReadOptions(
                column_names=names, skip_rows=skip, block_size=2**22, use_threads=False
            ),
            parse_options=pv.ParseOptions(delimiter=delimiter),
            convert_options=pv.ConvertOptions(
                column_types=dict(types),
                include_columns=list(wanted),
                null_values=[],
                strings_can_be_null=False,
            ),
        ) as reader:
            for batch in reader:
                rows += batch.num_rows
                if rows > MAX_ROWS:
                    raise InputError(f"{path}: found more than {MAX_ROWS} rows")
                tables.append(pa.Table.from_batches([batch]))
    except (pa.ArrowException, OSError) as error:
        numbers = {i for i, name in enumerate(names) if types.get(name) == pa.float64()}
        reason = _broken_line(path, header, numbers) or _reason(error, names)
        raise InputError(f"{path}: {reason}") from None
    if not tables:
        raise InputError(f"{path}: found no rows, expected at least one")
    table = pa.concat_tables(tables)
    for name in wanted:
        if pc.any(pc.is_null(table.column(name))).as_py():
            raise InputError(f"{path}: column {name}: found an empty field, expected a value")
    return table


def _broken_line(path: Path, header: Sequence[str], numbers: set[int]) -> str | None:
    """What is wrong with the first line that is broken; None where none seems to be."""
    with opened(path) as file:
        for row, line in enumerate(iter(lambda: file.readline(MAX_LINE_BYTES), b""), 1):
            try:
                (fields,) = csv.reader([line.decode("utf-8-sig" if row == 1 else "utf-8")])
            except UnicodeDecodeError:
                return f"row {row}: found bytes that are not UTF-8"
            except (csv.Error, ValueError):
                continue
            if row == 1 or not fields:
                continue
            if len(fields) != len(header):
                return f"row {row}: found {len(fields)} fields, expected {len(header)}"
            for i in numbers:
                try:
                    real(fields[i])
                except ValueError:
                    return (
                        f"column {header[i]}, row {row}: found {fields[i]!r:.60}, expected a number"
                    )
    return None


def _reason(error: Exception, names: Sequence[str]) -> str:
    """Arrow's message in one line, with the column's name instead of its number."""
    text = " ".join(str(error).split())

    def named(match: re.Match[str]) -> str:
        number = int(match.group(1))
        return f"column {names[number]}: " if number < len(names) else match.group()

    return _COLUMN.sub(named, text)
