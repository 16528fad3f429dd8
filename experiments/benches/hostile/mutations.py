"""Alterations of files that are valid, by what their formats are made of.

A text is taken apart into numbers, words, separators and lines, an archive into its members, a
Parquet table into its cells, a folder into its files; then some of the pieces are changed.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import random
import re
import zipfile
from collections.abc import Mapping
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import feather

from experiments.benches.hostile.grammars import HOSTILE
from experiments.benches.hostile.scenes import feather_bytes
from sim.formats.waymo.tfrecord import write_record

Files = Mapping[str, bytes]
"""The files of an input, by their path in its folder."""

TOKEN: Final = re.compile(rb"\s+|[\w.+-]+|[^\w\s]")
"""A word or number, white space, or one other sign."""

DEEP: Final = 3000
"""How deep brackets are nested, sometimes (three times Python's limit)."""

LONG: Final = 100_000
"""Length of a field that is made long, sometimes."""

CUT, FLIP, WORDS, LINES, DEEPER, LONGER = range(6)
RECORD_HEAD, RECORD_TAIL = 12, 4
"""Bytes before and after the message in a TFRecord: its length, and checksums."""

BITS: Final = (1, 2, 4, 8, 16, 32, 64, 128, 255)


def altered(files: Files, choose: random.Random) -> dict[str, bytes]:
    """Some files, mostly one of them changed.

    Args:
        files: a valid input.
        choose: decides what changes.

    Returns:
        The changed input; sometimes checksums in JSON are those of the changed files again, so
        that what lies behind them is tried too.
    """
    found = dict(files)
    for name in choose.sample(sorted(found), min(len(found), choose.choice([1, 1, 1, 2]))):
        found[name] = alter(name, found[name], choose)
        if choose.random() < 0.03:
            del found[name]
    return _checked(files, found) if choose.random() < 0.8 else found


def alter(name: str, data: bytes, choose: random.Random) -> bytes:
    """One file, changed by what it is made of.

    Args:
        name: tells the format.
        data: its content.
        choose: decides what changes.
    """
    if name.endswith(".gz"):
        if choose.random() < 0.3:
            return _of_bytes(data, choose)
        inside = alter(name.removesuffix(".gz"), gzip.decompress(data), choose)
        return gzip.compress(inside, 1, mtime=0)
    if name.endswith(".xlsx"):
        return _of_archive(data, choose)
    if name.endswith((".parquet", ".feather")) and choose.random() < 0.5:
        return _of_table(name, data, choose)
    if name.endswith(".tfrecord") and choose.random() < 0.8:
        return _of_record(data, choose)
    if name.endswith((".parquet", ".feather", ".safetensors", ".tfrecord", ".pkl")):
        return _of_bytes(data, choose)
    return _of_text(data, choose)


def _of_bytes(data: bytes, choose: random.Random) -> bytes:
    """Bytes flipped, put in, taken out or cut off; mostly near the end or the beginning."""
    found = bytearray(data)
    for _ in range(choose.choice([1, 1, 2, 4, 16])):
        if not found:
            break
        near = min(len(found), choose.choice([64, 512, len(found)]))
        at = choose.randrange(near)
        at = len(found) - 1 - at if choose.random() < 0.5 else at
        how = choose.random()
        if how < 0.6:
            found[at] ^= choose.choice(BITS)
        elif how < 0.75:
            found.insert(at, choose.randrange(256))
        elif how < 0.95:
            del found[at]
        else:
            del found[at:]
    return bytes(found)


def _of_record(data: bytes, choose: random.Random) -> bytes:
    """The message in a TFRecord changed, with checksums of its own."""
    return write_record(_of_bytes(data[RECORD_HEAD:-RECORD_TAIL], choose))


def _of_text(data: bytes, choose: random.Random) -> bytes:
    """Tokens, lines or bytes of a text changed."""
    for _ in range(choose.choice([1, 1, 2, 5])):
        how = choose.choices((CUT, FLIP, WORDS, LINES, DEEPER, LONGER), (1, 2, 12, 4, 0.3, 0.3))[0]
        if how == CUT and data:
            data = data[: choose.randrange(len(data))]
        elif how == FLIP:
            data = _of_bytes(data, choose)
        elif how == WORDS:
            data = _of_tokens(data, choose)
        elif how == LINES:
            data = _of_lines(data, choose)
        elif how == DEEPER:
            opening = choose.choice([b"[", b"{", b"(", b"<a>", b'{"a":'])
            at = choose.randrange(len(data) + 1)
            data = data[:at] + opening * DEEP + data[at:]
        elif data:
            at = choose.randrange(len(data))
            data = data[:at] + data[at : at + 1] * LONG + data[at:]
    return data


def _of_tokens(data: bytes, choose: random.Random) -> bytes:
    """One token replaced by a hostile one, or by another token of the same text."""
    tokens = [match.span() for match in TOKEN.finditer(data)]
    if not tokens:
        return data
    begin, end = choose.choice(tokens)
    other = choose.choice(tokens)
    new = choose.choice(
        [choose.choice(HOSTILE).encode(), data[slice(*other)], b"", data[begin:end] * 2]
    )
    return data[:begin] + new + data[end:]


def _of_lines(data: bytes, choose: random.Random) -> bytes:
    """A line, or an element where all stands in one line, repeated, moved or taken out."""
    ends = choose.choice([b"\n", b">", b","])
    lines = data.split(ends)
    at = choose.randrange(len(lines))
    one = lines.pop(at) if choose.random() < 0.5 else lines[at]
    if choose.random() < 0.6:
        lines.insert(choose.randrange(len(lines) + 1), one)
    return ends.join(lines)


def _of_archive(data: bytes, choose: random.Random) -> bytes:
    """A member of a zip archive changed, or the archive's own bytes."""
    if choose.random() < 0.3:
        return _of_bytes(data, choose)
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(packed, "w") as new:
        names = old.namelist()
        chosen = choose.choice(names)
        for name in names:
            inside = old.read(name)
            if name == chosen:
                if choose.random() < 0.05:
                    continue
                inside = _of_text(inside, choose)
                if choose.random() < 0.1:
                    inside = inside.decode("utf-8", "replace").encode("utf-16")
            new.writestr(name, inside, choose.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]))
    return packed.getvalue()


def _of_table(name: str, data: bytes, choose: random.Random) -> bytes:
    """A Parquet or Feather table with other cells, rows, types or columns, written anew."""
    packed = name.endswith(".feather")
    source = io.BytesIO(data)
    table = feather.read_table(source) if packed else pq.ParquetFile(source).read()
    for _ in range(choose.choice([1, 1, 2])):
        at = choose.randrange(table.num_columns)
        field, column = table.schema.field(at), table.column(at)
        how = choose.random()
        if how < 0.6 and table.num_rows:
            table = table.set_column(at, field.with_nullable(True), _with_cell(column, choose))
        elif how < 0.7:
            table = table.slice(choose.randrange(table.num_rows + 1))
        elif how < 0.8:
            table = pa.concat_tables([table, table.slice(0, 1)])
        elif how < 0.9:
            table = table.remove_column(at) if table.num_columns > 1 else table
        else:
            table = table.set_column(at, field.name, pa.array(column.to_pylist()).cast(pa.string()))
    if packed:
        return _of_feather(table, choose)
    sink = io.BytesIO()
    pq.write_table(table, sink, compression=choose.choice(["none", "zstd", "gzip"]))
    return sink.getvalue()


def _of_feather(table: pa.Table, choose: random.Random) -> bytes:
    """A table as a Feather file, packed, cut and encoded in any way, sometimes a few bytes altered.

    So the heads of dictionaries and of several batches are altered, too.
    """
    for at, field in enumerate(table.schema):
        if pa.types.is_string(field.type) and choose.random() < 0.3:
            table = table.set_column(at, field.name, table.column(at).dictionary_encode())
    compression = choose.choice(["uncompressed", "lz4", "zstd"])
    data = feather_bytes(table, compression, choose.choice([3, 10**6]))
    return _of_bytes(data, choose) if choose.random() < 0.3 else data


def _with_cell(column: pa.ChunkedArray, choose: random.Random) -> pa.ChunkedArray:
    values: list[Any] = column.to_pylist()
    row = choose.randrange(len(values))
    if pa.types.is_floating(column.type):
        values[row] = choose.choice([float("nan"), float("inf"), -1.0, 1e300, 0.0, None])
    elif pa.types.is_integer(column.type):
        low = 0 if pa.types.is_unsigned_integer(column.type) else -1
        values[row] = choose.choice([low, 0, 7, 100, 127, None])
    elif pa.types.is_string(column.type):
        values[row] = choose.choice([*HOSTILE, None, choose.choice(values)])
    else:
        values[row] = choose.choice(values)
    return pa.chunked_array([pa.array(values, column.type, from_pandas=False)])


def _checked(before: Files, after: dict[str, bytes]) -> dict[str, bytes]:
    """The files with the checksums and sizes of the changed ones wherever the old are told.

    That is in JSON, and in the JSON that describes a dataset in its catalogue.
    """
    new = {
        hashlib.sha256(data).hexdigest(): after[name]
        for name, data in before.items()
        if name in after and after[name] != data
    }

    def mended(value: Any) -> Any:
        if isinstance(value, list):
            return [mended(one) for one in value]
        if not isinstance(value, dict):
            return value
        data = new.get(str(value.get("sha256")))
        found = {key: mended(one) for key, one in value.items()}
        if data is not None:
            found |= {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data)}
        return found

    for name in [name for name in after if name.endswith(".json")]:
        try:
            value = json.loads(after[name])
            if (again := mended(value)) != value:
                after[name] = json.dumps(again, separators=(",", ":")).encode()
        except (ValueError, RecursionError):
            continue
    name, key = "episodes.parquet", b"graphrqi"
    if new and name in after and after[name] == before[name]:
        table = pq.ParquetFile(io.BytesIO(after[name])).read()
        told = json.loads(table.schema.metadata[key])
        sink = io.BytesIO()
        pq.write_table(table.replace_schema_metadata({key: json.dumps(mended(told))}), sink)
        after[name] = sink.getvalue()
    return after
