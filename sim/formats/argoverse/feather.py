"""Feather files of unknown origin, which are checked before Arrow reads them.

A Feather file is a file of Arrow record batches with a footer. Arrow unpacks a compressed buffer
into as many bytes as the buffer says of itself, and 13 KB can unpack to 400 MB. So the footer and
the head of every batch are read here first: a file whose parts contradict each other, or that
unpacks to more than it may, is refused in one line.

References:
    Apache Arrow (2024), Arrow columnar format: IPC file format, Schema.fbs, Message.fbs, File.fbs.
    Google (2024), FlatBuffers internals.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.ipc

from behaviors.errors import InputError
from sim.formats.common.packed import opened
from sim.formats.common.recording import check_size
from sim.frames import MAX_MAGNITUDE

MAX_BYTES: Final = 2**26
"""Largest file that is read (64 MiB; the tables of a sensor log have some 2)."""

MAX_UNPACKED: Final = 2**28
"""Most bytes that a file's batches may unpack to (256 MiB)."""

MAX_BATCHES: Final = 10**4
"""Most batches of a file (the tables of a sensor log have one)."""

_MAGIC: Final = b"ARROW1"
_FIRST_VERSION_MAGIC: Final = b"FEA1"
_CONTINUATION: Final = 0xFFFFFFFF
_V5: Final = 4
"""The code of the only version of the metadata that is read, written since Arrow 1.0 (2020)."""

_DICTIONARY, _RECORDS = 2, 3
"""What a message holds, by Arrow's code."""

_BLOCK: Final = struct.Struct("<qi4xq")
_BUFFER: Final = struct.Struct("<qq")


class _BrokenError(Exception):
    """What is wrong with a file's own description of itself."""


def read_feather(
    path: Path, texts: Sequence[str], whole: Sequence[str], real: Sequence[str], max_rows: int
) -> pa.Table:
    """Read some columns of a file; none of their fields may be empty.

    Args:
        path: the file, gzipped where its name ends in ``.gz``.
        texts: columns of texts.
        whole: columns of whole numbers.
        real: columns of numbers.
        max_rows: most rows that the file may have.

    Returns:
        The columns: texts as dictionaries, whole numbers as int64, others as float64, finite and
        not above ``sim.frames.MAX_MAGNITUDE`` in size.

    Raises:
        InputError: if the file is no Feather file, is broken or has other columns; the message
            names file and column.
    """
    check_size(path)
    with opened(path) as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(f"{path}: found more than {MAX_BYTES} bytes, expected at most as many")
    if data.startswith(_FIRST_VERSION_MAGIC):
        raise InputError(f"{path}: found Feather of version 1, expected version 2 (Arrow's)")
    try:
        _look_through(data, max_rows)
        table = _columns(path, data, (*texts, *whole, *real))
    except (_BrokenError, struct.error, pa.ArrowException, OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        said = "one of its heads ends too early" if isinstance(error, struct.error) else str(error)
        reason = (said.splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: found no readable Feather table ({reason:.200})") from None
    columns = {name: _texts(path, name, table.column(name)) for name in texts}
    columns |= {name: _numbers(path, name, table.column(name), pa.int64()) for name in whole}
    columns |= {name: _numbers(path, name, table.column(name), pa.float64()) for name in real}
    return pa.table(columns)


def _columns(path: Path, data: bytes, names: Sequence[str]) -> pa.Table:
    """Columns of a file that was looked through."""
    source = pa.BufferReader(data)
    schema = pa.ipc.open_file(source).schema
    places = []
    for name in names:
        found = schema.get_all_field_indices(name)
        if len(found) != 1:
            seen = f"column {name} {len(found)} times" if found else f"no column {name}"
            raise InputError(f"{path}: found {seen}, expected it once")
        places += found
    options = pa.ipc.IpcReadOptions(included_fields=places, use_threads=False)
    table = pa.ipc.open_file(source, options=options).read_all()
    table.validate(full=True)
    return table


def _texts(path: Path, name: str, column: pa.ChunkedArray) -> pa.DictionaryArray:
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        # texts that are views may repeat a long one in every row, so that they cannot be bounded
        raise InputError(
            f"{path}: column {name}: found {column.type!s:.60}, expected string, large_string or a "
            "dictionary of them"
        )
    _check_full(path, name, column)
    encoded = column.unify_dictionaries().combine_chunks().dictionary_encode()
    if encoded.dictionary.null_count:
        raise InputError(f"{path}: column {name}: found an empty field, expected a value")
    words = encoded.dictionary.cast(pa.string())
    # a file's own indices may be unsigned, as those of Polars are
    return pa.DictionaryArray.from_arrays(encoded.indices.cast(pa.int64()), words)


def _numbers(path: Path, name: str, column: pa.ChunkedArray, wanted: pa.DataType) -> pa.Array:
    able = pa.types.is_integer(column.type) or (
        pa.types.is_floating(column.type) and pa.types.is_floating(wanted)
    )
    if not able:
        expected = "numbers" if pa.types.is_floating(wanted) else "whole numbers"
        raise InputError(f"{path}: column {name}: found {column.type!s:.60}, expected {expected}")
    _check_full(path, name, column)
    try:
        array = column.combine_chunks().cast(wanted)
    except pa.ArrowInvalid:
        raise InputError(
            f"{path}: column {name}: found a number that {wanted} cannot hold, expected a smaller"
        ) from None
    if pa.types.is_floating(wanted):
        values = array.to_numpy(zero_copy_only=False)
        bad = ~(np.abs(values) <= MAX_MAGNITUDE)
        if bad.any():
            raise InputError(
                f"{path}: column {name}: found {values[bad][0]}, expected a number up to "
                f"{MAX_MAGNITUDE:g}"
            )
    return array


def _check_full(path: Path, name: str, column: pa.ChunkedArray) -> None:
    if column.null_count:
        raise InputError(f"{path}: column {name}: found an empty field, expected a value")


# --- looking through ----------------------------------------------------------------------------


def _require(holds: bool, reason: str) -> None:
    if not holds:
        raise _BrokenError(reason)


def _look_through(content: bytes, max_rows: int) -> None:
    """Check what a file says of its batches, before any of them is unpacked.

    Raises:
        _BrokenError: if it contradicts itself or unpacks to too much.
        struct.error: if a head ends before what it has to say.
    """
    data = memoryview(content)
    ends = content.startswith(_MAGIC) and content.endswith(_MAGIC) and len(data) >= 18
    _require(ends, "it does not begin and end as such files do")
    (length,) = struct.unpack_from("<i", data, len(data) - 10)
    begin = len(data) - 10 - length
    _require(length >= 0 and begin >= 8, "its footer does not fit")
    footer = _Table.root(data[begin : len(data) - 10])
    rows = unpacked = batches = taken = 0
    for field, expected in ((2, _DICTIONARY), (3, _RECORDS)):
        for block in footer.structs(field, _BLOCK):
            batches, taken = batches + 1, taken + block[1] + block[2]
            _require(batches <= MAX_BATCHES, f"it has more than {MAX_BATCHES} batches")
            _require(taken <= begin, "its batches overlap")
            more_rows, more = _batch(data[:begin], block, expected)
            rows += more_rows if expected == _RECORDS else 0
            unpacked += more
            _require(rows <= max_rows, f"it has {rows} rows, and {max_rows} are allowed")
            _require(unpacked <= MAX_UNPACKED, f"it unpacks to more than {MAX_UNPACKED} bytes")


def _batch(data: memoryview, block: tuple[int, ...], expected: int) -> tuple[int, int]:
    """Rows of a batch, and bytes that its buffers unpack to."""
    at, head_length, body_length = block
    body = at + head_length
    _require(
        min(at, head_length) >= 8 and body_length >= 0 and body + body_length <= len(data),
        "a batch does not fit",
    )
    continuation, length = struct.unpack_from("<Ii", data, at)
    _require(continuation == _CONTINUATION, "a batch has no head as Arrow writes since 0.15")
    _require(0 <= length <= head_length - 8, "the head of a batch does not fit")
    message = _Table.root(data[at + 8 : at + 8 + length])
    _require(message.number(0, "<h") == _V5, "it was written by Arrow before 1.0")
    _require(message.number(1, "<B") == expected, "a batch is of another kind than the footer says")
    _require(message.number(3, "<q") == body_length, "a batch has another length than it says")
    batch = message.table(2)
    if expected == _DICTIONARY:
        batch = batch.table(1)
    rows = batch.number(0, "<q")
    _require(rows >= 0, "a batch has fewer than no rows")
    packed, unpacked = batch.has(3), 0
    for offset, size in batch.structs(2, _BUFFER):
        fits = min(offset, size) >= 0 and offset + size <= body_length
        _require(fits, "a buffer does not fit")
        told = size
        if packed and size:
            (told,) = struct.unpack_from("<q", data, body + offset)
            _require(told >= -1, "a buffer has fewer than no bytes")
        unpacked += size if told == -1 else told
    return rows, unpacked


class _Table:
    """A table of a FlatBuffer: fields by number, each of which may be absent."""

    def __init__(self, data: memoryview, at: int) -> None:
        (back,) = struct.unpack_from("<i", data, at)
        self._data, self._at, self._fields = data, at, at - back
        _require(self._fields >= 0, "a head is broken")
        (self._size,) = struct.unpack_from("<H", data, self._fields)

    @classmethod
    def root(cls, data: memoryview) -> _Table:
        (at,) = struct.unpack_from("<I", data, 0)
        return cls(data, at)

    def _place(self, field: int) -> int | None:
        """Where the value of a field is; None where it is absent."""
        entry = 4 + 2 * field
        if entry + 2 > self._size:
            return None
        (offset,) = struct.unpack_from("<H", self._data, self._fields + entry)
        return self._at + offset if offset else None

    def has(self, field: int) -> bool:
        return self._place(field) is not None

    def number(self, field: int, form: str) -> int:
        """A number; 0 where it is absent, as FlatBuffers define it."""
        place = self._place(field)
        if place is None:
            return 0
        (value,) = struct.unpack_from(form, self._data, place)
        return int(value)

    def _target(self, field: int) -> int:
        place = self._place(field)
        _require(place is not None, "a head lacks a field")
        assert place is not None
        (offset,) = struct.unpack_from("<I", self._data, place)
        return place + int(offset)

    def table(self, field: int) -> _Table:
        return _Table(self._data, self._target(field))

    def structs(self, field: int, form: struct.Struct) -> Iterator[tuple[int, ...]]:
        """The entries of a list of structs; none where it is absent."""
        if not self.has(field):
            return
        at = self._target(field)
        (count,) = struct.unpack_from("<I", self._data, at)
        _require(at + 4 + count * form.size <= len(self._data), "a list does not fit")
        yield from form.iter_unpack(self._data[at + 4 : at + 4 + count * form.size])
