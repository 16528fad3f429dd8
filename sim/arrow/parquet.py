"""Parquet files of unknown origin: looked through before Arrow reads them, then read in one way.

Arrow trusts what a file says of its own sizes. A small forged file makes it take gigabytes, or ends
the process. So the footer and the header of every page are read here first: a file whose parts
contradict each other, or that unpacks to more than it may, is refused in one line.

References:
    Apache Parquet (2024), Parquet format: file metadata and data pages.
"""

from __future__ import annotations

import io
import mmap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.errors import InputError
from sim.arrow.budget import Layout, StoredColumn
from sim.arrow.thrift import ThriftError, read_struct

MAX_PAGES: Final = 10**5
"""Most pages of a file (Arrow's own have up to 1 MiB each)."""

MAX_COLUMNS: Final = 1000
"""Most columns of a file (the widest of ours has 26)."""

_TAIL_BYTES: Final = 2**16
"""How much of a file's end is read at first (most footers fit)."""

_MAGIC: Final = b"PAR1"
_PHYSICAL: Final = (
    "BOOLEAN", "INT32", "INT64", "INT96", "FLOAT", "DOUBLE", "BYTE_ARRAY", "FIXED_LEN_BYTE_ARRAY",
)  # fmt: skip
"""How values are stored, in the order of Parquet's codes."""

_REPEATED: Final = 2
_DATA_PAGE, _DICTIONARY_PAGE, _DATA_PAGE_V2 = 0, 2, 3
_DELTA_BYTE_ARRAY: Final = 7
"""An encoding of texts by what they share with the one before: a few bytes make any number."""


@contextmanager
def opened(path: Path, data: bytes | None = None) -> Iterator[tuple[Layout, pa.NativeFile]]:
    """A Parquet file that was looked through, and can be read as Arrow does.

    Args:
        path: the file; of given bytes it is only their name.
        data: its bytes; None to read them from the file.

    Yields:
        What it holds, and what `pyarrow.parquet.ParquetFile` reads it from. What Arrow finds
        broken in the block is an `InputError` too.

    Raises:
        InputError: if it is no file, or a broken one.
    """
    if data is None and not path.is_file():
        raise InputError(f"{path}: found no file, expected a Parquet table")
    try:
        if data is not None:
            yield look_through(path, data), pa.BufferReader(data)
            return
        with path.open("rb") as file, pa.OSFile(str(path)) as source:
            if not path.stat().st_size:
                raise InputError(f"{path}: found an empty file, expected a Parquet table")
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                layout = look_through(path, content)
            yield layout, source
    except InputError:
        raise
    except (pa.ArrowException, OSError, UnicodeDecodeError, ValueError) as error:
        raise _unreadable(path, error) from None


def look_through(path: Path, data: Any) -> Layout:
    """Read the footer and all page headers of a Parquet file.

    Args:
        path: of the file, for messages.
        data: all its bytes.

    Returns:
        What it holds.

    Raises:
        InputError: if a header is broken or contradicts another.
    """
    try:
        return _layout(data)
    except (ThriftError, TypeError, ValueError, KeyError, IndexError, AttributeError) as error:
        raise _unreadable(path, error, "a header is broken") from None


def _unreadable(path: Path, error: Exception, otherwise: str | None = None) -> InputError:
    """What Arrow or we found broken; ``otherwise`` where only our own words say what it is."""
    said = (str(error).splitlines() or [type(error).__name__])[0]
    reason = said if otherwise is None or isinstance(error, ThriftError) else otherwise
    return InputError(f"{path}: found no readable Parquet table ({reason:.200})")


def _require(holds: bool, reason: str) -> None:
    if not holds:
        raise ThriftError(reason)


def _layout(data: Any) -> Layout:
    size = len(data)
    _require(size >= 12 and data[:4] == _MAGIC and data[-4:] == _MAGIC, "it has no Parquet magic")
    footer = int.from_bytes(data[size - 8 : size - 4], "little")
    begin = size - 8 - footer
    _require(begin >= 4, "its footer does not fit")
    content = bytes(data[begin : size - 8])
    head, _ = read_struct(content, 0, len(content))
    rows = head[3]
    columns = _columns(head[2])
    _require(type(rows) is int and rows >= 0, "it has no number of rows")
    found, pages = 0, 0
    for group in head[4]:
        found += group[3]
        pages += _add_group(data, begin, columns, group)
        _require(pages <= MAX_PAGES, f"it has more than {MAX_PAGES} pages")
    _require(found == rows, "its row groups have other rows than the file")
    return Layout(rows, tuple(columns), size)


def _add_group(
    data: Any, begin: int, columns: Sequence[StoredColumn], group: Mapping[int, Any]
) -> int:
    """Add a row group's pages to the columns; how many pages there are."""
    rows, pages = group[3], 0
    _require(len(group[1]) == len(columns), "a row group has other columns than the schema")
    _require(type(rows) is int and rows >= 0, "a row group has no number of rows")
    for column, chunk in zip(columns, group[1], strict=True):
        pages += _add_chunk(data, begin, column, chunk, rows)
        _require(pages <= MAX_PAGES, f"it has more than {MAX_PAGES} pages")
    return pages


@dataclass(frozen=True)
class Footer:
    """The end of a Parquet file, from which its row groups can be read one by one.

    Attributes:
        path: of the file, for messages.
        size: of the file, bytes.
        content: the footer's bytes with the length and the magic behind them.
        rows: how many rows there are.
        groups: the row groups, as `sim.arrow.thrift.read_struct` gives them.
        schema: the columns' tree, in the same form.
        metadata: what the file says of itself as a whole, by key.
    """

    path: Path
    size: int
    content: bytes
    rows: int
    groups: list[dict[int, Any]]
    schema: list[dict[int, Any]]
    metadata: dict[bytes, bytes]

    @property
    def begin(self) -> int:
        """Where in the file it begins."""
        return self.size - len(self.content)

    @cached_property
    def arrow(self) -> pq.FileMetaData:
        """The same as Arrow reads it; done once, since a shard has thousands of row groups."""
        with pa.PythonFile(_Parts(self.size, [(self.begin, self.content)]), mode="r") as source:
            return pq.read_metadata(source)


def read_footer(path: Path, size: int, read: Callable[[int, int], bytes]) -> Footer:
    """Read the end of a Parquet file, and nothing else of it.

    Args:
        path: of the file, for messages.
        size: of the file, bytes.
        read: gives the bytes from one place in the file to another.

    Raises:
        InputError: if it is broken.
    """
    try:
        tail = read(max(0, size - _TAIL_BYTES), size)
        _require(size >= 12 and tail[-4:] == _MAGIC, "it has no Parquet magic")
        length = int.from_bytes(tail[-8:-4], "little") + 8
        _require(12 <= length + 4 <= size, "its footer does not fit")
        content = tail[-length:] if length <= len(tail) else read(size - length, size)
        _require(len(content) == length, "its footer does not fit")
        head, _ = read_struct(content, 0, length - 8)
        rows, groups = head[3], head.get(4, [])
        _require(type(rows) is int and rows >= 0, "it has no number of rows")
        _require(rows == sum(g[3] for g in groups), "its row groups have other rows than the file")
        said = {pair[1]: pair[2] for pair in head.get(5, []) if 2 in pair}
        return Footer(path, size, content, rows, groups, head[2], said)
    except (ThriftError, TypeError, ValueError, KeyError, IndexError, AttributeError) as error:
        raise _unreadable(path, error, "its footer is broken") from None


class _Parts(io.RawIOBase):
    """A file of which only some parts are known: reading anything else gives zeros."""

    def __init__(self, size: int, parts: Sequence[tuple[int, bytes]]) -> None:
        self._size, self._parts, self._at = size, parts, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = offset + (0, self._at, self._size)[whence]
        return self._at

    def read(self, size: int = -1) -> bytes:
        end = self._size if size < 0 else min(self._at + size, self._size)
        begin, self._at = self._at, end
        read = bytearray(max(0, end - begin))
        for first, data in self._parts:
            low, high = max(begin, first), min(end, first + len(data))
            if low < high:
                read[low - begin : high - begin] = data[low - first : high - first]
        return bytes(read)


class _Shifted:
    """Bytes that begin at a later place of their file."""

    def __init__(self, data: bytes, first: int) -> None:
        self._data, self._first = data, first

    def __getitem__(self, at: int | slice) -> Any:
        if isinstance(at, slice):
            return self._data[at.start - self._first : at.stop - self._first]
        if at < self._first:
            raise IndexError(at)
        return self._data[at - self._first]


@contextmanager
def opened_group(
    footer: Footer, number: int, read: Callable[[int, int], bytes]
) -> Iterator[tuple[Layout, pq.ParquetFile]]:
    """One row group of a file that was looked through; nothing else of the file is read.

    Args:
        footer: of the file.
        number: of the row group.
        read: gives the bytes from one place in the file to another.

    Yields:
        What the row group holds, and the file, of which ``read_row_group(number)`` can be called.
        Its pages' checksums are compared.

    Raises:
        InputError: if it is broken, also by what Arrow finds in the block.
    """
    path = footer.path
    try:
        if not 0 <= number < len(footer.groups):
            raise InputError(f"{path}: found {len(footer.groups)} row groups, expected {number}")
        group = footer.groups[number]
        columns = _columns(footer.schema)
        first, end = _extent(group, footer.begin)
        data = read(first, end)
        _require(len(data) == end - first, "a row group lies outside of the file")
        _add_group(_Shifted(data, first), end, columns, group)
        layout = Layout(group[3], tuple(columns), end - first)
        parts = [(first, data), (footer.begin, footer.content)]
        with pa.PythonFile(_Parts(footer.size, parts), mode="r") as source:
            # Reading ahead would give Python's memory to Arrow's threads; one that frees it while
            # the interpreter ends aborts the process.
            options = {"page_checksum_verification": True, "pre_buffer": False}
            yield layout, pq.ParquetFile(source, metadata=footer.arrow, **options)
    except (InputError, FileNotFoundError):
        raise
    except (ThriftError, TypeError, KeyError, IndexError, AttributeError) as error:
        raise _unreadable(path, error, "a header is broken") from None
    except (pa.ArrowException, OSError, UnicodeDecodeError, ValueError) as error:
        raise _unreadable(path, error) from None


def _extent(group: Mapping[int, Any], limit: int) -> tuple[int, int]:
    """From where to where in its file a row group lies."""
    begins, ends = [], []
    for chunk in group[1]:
        meta = chunk[3]
        at = min((meta[number] for number in (9, 11) if meta.get(number, 0) > 0), default=4)
        begins.append(at)
        ends.append(at + meta[7])
    first, end = min(begins), max(ends)
    _require(4 <= first <= end <= limit, "a row group lies outside of the file")
    return first, end


def _columns(elements: list[dict[int, Any]]) -> list[StoredColumn]:
    """The columns of a schema, which is a tree in preorder."""
    _require(0 < len(elements) <= 4 * MAX_COLUMNS, f"it has more than {MAX_COLUMNS} columns")
    columns: list[StoredColumn] = []
    at = 0

    def walk(prefix: str, repeated: bool, depth: int) -> None:
        nonlocal at
        element = elements[at]
        at += 1
        _require(depth < 8, "its columns lie more than 8 deep")
        name = element[4].decode()
        path = f"{prefix}.{name}" if prefix else name
        again = repeated or element.get(3) == _REPEATED
        children = element.get(5, 0)
        if children:
            for _ in range(children):
                walk(path if depth else "", again, depth + 1)
        else:
            columns.append(StoredColumn(path, _PHYSICAL[element[1]], again))

    walk("", False, 0)
    _require(at == len(elements) and len(columns) <= MAX_COLUMNS, "its schema is broken")
    return columns


def _add_chunk(
    data: Any, end: int, column: StoredColumn, chunk: Mapping[int, Any], rows: int
) -> int:
    """Add a chunk's pages to its column; how many pages there are."""
    _require(1 not in chunk and 8 not in chunk, "it refers to another file or is encrypted")
    meta = chunk[3]
    _require(_PHYSICAL[meta[1]] == column.physical, "a chunk has another type than its column")
    values = meta[5]
    begins = [meta[number] for number in (9, 11) if meta.get(number, 0) > 0]  # data, dictionary
    at = min(begins, default=4)
    stop = at + (meta[7] if begins else 0)
    _require(4 <= at <= stop <= end, "a chunk lies outside of the file")
    _require(values == rows or (column.repeated and values >= rows), "a chunk has other rows")
    histograms = meta.get(16, {})
    levels = [part for number in (2, 3) for part in histograms.get(number, ())]
    _require(all(0 <= level <= values for level in levels), "its statistics are broken")
    seen = pages = 0
    while at < stop:
        # texts in a header are the smallest and largest value of its page
        page, at = read_struct(data, at, stop)
        kind, unpacked, packed = page[1], page[2], page[3]
        _require(0 <= packed <= stop - at and unpacked >= 0, "a page has no proper size")
        if kind in (_DATA_PAGE, _DATA_PAGE_V2):
            header = page[5 if kind == _DATA_PAGE else 8]
            encoding = header[2 if kind == _DATA_PAGE else 4]
            _require(encoding != _DELTA_BYTE_ARRAY, "its texts are in DELTA_BYTE_ARRAY")
            _require(header[1] >= 0, "a page has no number of values")
            seen += header[1]
        elif kind == _DICTIONARY_PAGE:
            _require(page[7][1] >= 0, "a page has no number of values")
        column.size += unpacked
        column.largest_page = max(column.largest_page, unpacked)
        at += packed
        pages += 1
        _require(pages <= MAX_PAGES, f"it has more than {MAX_PAGES} pages")
    _require(seen == values, "its pages have other values than their chunk")
    column.values += values
    column.pages += pages
    return pages


def read_packed(source: pa.NativeFile, texts: Sequence[str], columns: list[str] | None) -> pa.Table:
    """A table with every text in memory once, because a small file can repeat a long one.

    Args:
        source: as `opened` gives it.
        texts: the columns of texts, as `check_budget` names them.
        columns: those to read; None for all.

    Returns:
        The table; its texts are dictionaries, valid UTF-8 where they say so.

    Raises:
        pyarrow.ArrowException: if it is broken; `opened` turns it into an InputError.
    """
    file = pq.ParquetFile(source, read_dictionary=list(texts), page_checksum_verification=True)
    table = file.read(columns=columns, use_threads=False)
    table.validate(full=True)
    if missing := sorted({*(columns or ())} - {*table.column_names}):  # told otherwise before
        raise pa.ArrowInvalid(f"found no column {missing[0]}")
    return table
