"""The Parquet files of a dataset: how they are written, opened and checked.

Pages carry checksums, which reading compares.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import BaseModel, ValidationError

from behaviors.errors import InputError
from behaviors.profiles import PERCEPTION_FIELDS
from sim.files import Place, place_of
from sim.invalid_fields import first_wrong_field
from sim.store.schema import EpisodeEntry, TableName, shard_file, table_schema

M = TypeVar("M", bound=BaseModel)

METADATA_KEY: Final = "graphrqi"
"""Under which key a Parquet file says in JSON what belongs to the file as a whole."""


def parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """How tables of a schema are written: options of `pyarrow.parquet.ParquetWriter`."""
    encodings, words = {}, []
    for field in schema:
        if pa.types.is_floating(field.type):
            encodings[field.name] = "BYTE_STREAM_SPLIT"
        elif pa.types.is_integer(field.type):
            encodings[field.name] = "DELTA_BINARY_PACKED"
        elif pa.types.is_list(field.type):
            words.append(f"{field.name}.list.element")
        elif not pa.types.is_boolean(field.type):
            words.append(field.name)
    return {
        "compression": "zstd",
        "use_dictionary": words,
        "column_encoding": encodings,
        "store_schema": False,
        "write_page_checksum": True,
    }


@contextmanager
def opened(place: Place, file: str, **options: Any) -> Iterator[pq.ParquetFile]:
    """A Parquet file of a dataset, whose footer is kept for the next time.

    Raises:
        InputError: if it is broken.
        FileNotFoundError: if the file does not exist.
    """
    try:
        known = _footer(place.url, file, place.stamp(file))
        with place.for_arrow(file) as source:
            options["page_checksum_verification"] = True
            yield pq.ParquetFile(source, metadata=known, **options)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split())
        raise InputError(
            f"{place.path / file}: found no readable Parquet ({reason:.200})"
        ) from None


@lru_cache(maxsize=64)
def _footer(url: str, file: str, stamp: str) -> pq.FileMetaData:
    """A file's footer; ``stamp`` changes when the file does."""
    with place_of(url).for_arrow(file) as source:
        return pq.read_metadata(source)


def metadata_of(path: Path, metadata: pq.FileMetaData, model: type[M]) -> M:
    """Metadata of a dataset's Parquet file as a whole.

    Raises:
        InputError: if it says nothing, or something else.
    """
    found = (metadata.metadata or {}).get(METADATA_KEY.encode())
    if found is None:
        raise InputError(f"{path}: found no metadata of graphrqi, expected a file of a dataset")
    try:
        return model.model_validate_json(found)
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None


def check_columns(path: Path, found: pa.Schema, expected: pa.Schema) -> None:
    """Refuse a table that lacks a column, by its name."""
    for field in expected:
        if field.name not in found.names or not found.field(field.name).equals(field):
            raise InputError(f"{path}: found no column {field.name} of {field.type}, expected it")


def read_rows(
    place: Place, table: TableName, entry: EpisodeEntry, columns: list[str] | None = None
) -> pa.Table:
    """An episode's rows of a table, read from its own row group; ``columns``, or all.

    Raises:
        InputError: if the file is missing, broken, or does not fit the schema; names the file.
    """
    file = shard_file(table, entry.scenario, entry.split, entry.index)
    path, schema = place.path / file, table_schema(table, entry.exact)
    wanted = schema.names if columns is None else columns
    rows = schema.empty_table().select(wanted)
    try:
        with opened(place, file) as parquet:
            found = parquet.schema_arrow
            older = {*PERCEPTION_FIELDS} - {*found.names}  # older datasets do not have them
            there = pa.schema(field for field in schema if field.name not in older)
            check_columns(path, found, there)
            for number in range(parquet.num_row_groups):
                ids = parquet.metadata.row_group(number).column(0).statistics
                if ids is not None and ids.min == ids.max == entry.id:
                    rows = parquet.read_row_group(
                        number, [name for name in wanted if name not in older], use_threads=False
                    )
                    break
            for name in older & {*wanted} - {*rows.column_names}:
                rows = rows.append_column(name, pa.nulls(rows.num_rows, pa.float64()))
    except FileNotFoundError:
        raise InputError(f"{path}: found no file, expected the shard of {entry.id}") from None
    for name, column in zip(rows.column_names, rows.columns, strict=True):
        if pa.types.is_floating(column.type) and pc.all(pc.is_finite(column)).as_py() is False:
            raise InputError(f"{path}: found a {name} that is not finite, expected numbers")
    return rows
