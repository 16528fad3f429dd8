"""Writes and reads shards: the files, one for each table, that hold several episodes.

Every episode is a row group of each file, so it is written when it is done and read by itself.
Pages carry checksums, which reading compares.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from behaviors.errors import InputError
from behaviors.profiles import PERCEPTION_FIELDS
from sim.files import PARTIAL_PREFIX, Place, place_of
from sim.invalid_fields import first_wrong_field
from sim.store.encode import written_schema
from sim.store.schema import (
    TABLES,
    EpisodeEntry,
    FileEntry,
    TableName,
    table_schema,
)

M = TypeVar("M", bound=BaseModel)

METADATA_KEY: Final = b"graphrqi"
"""Under which key a Parquet file says in JSON what belongs to the file as a whole."""

KEPT_FOOTERS: Final = 64
"""Most files whose footers a process keeps."""


@dataclass(frozen=True, slots=True)
class ShardName:
    """Location of a shard, and its episodes.

    Attributes:
        scenario: of all its episodes.
        split: of all its episodes.
        block: its first and its last index.
    """

    scenario: str
    split: str
    block: str

    @classmethod
    def of(cls, entry: EpisodeEntry) -> ShardName:
        """The shard of an episode."""
        return cls(entry.scenario, entry.split, entry.shard)

    def file(self, table: TableName) -> str:
        """Where in its dataset a table of the shard lies.

        Args:
            table: which.

        Examples:
            >>> ShardName("a road", "train", "000000-000004").file("steps")
            'steps/scenario=a%20road/split=train/000000-000004.parquet'
        """
        scenario = quote(self.scenario, safe="")
        return f"{table}/scenario={scenario}/split={self.split}/{self.block}.parquet"


class Shard(BaseModel):
    """A shard that is finished; its table of agents says this in its metadata.

    Attributes:
        configuration: what the dataset is made from.
        entries: its episodes, in order.
        files: size and checksum of its roads and other tables, by name.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    configuration: dict[str, JsonValue]
    entries: tuple[EpisodeEntry, ...]
    files: dict[str, FileEntry]


class ShardWriter:
    """Writes the episodes of one shard into a hidden folder, and moves its files when it is closed.

    Args:
        place: the dataset.
        name: of the shard.
        exact: whether numbers are float64 as they came.
        configuration: what the dataset is made from.
    """

    def __init__(
        self, place: Place, name: ShardName, exact: bool, configuration: Mapping[str, JsonValue]
    ) -> None:
        self._place, self._files = place, {table: name.file(table) for table in TABLES}
        self._configuration = dict(configuration)
        self._entries: list[EpisodeEntry] = []
        self._rows = dict.fromkeys(TABLES, 0)
        self._roads: dict[str, FileEntry] = {}
        home = None if place.remote else place.path
        self._scratch = Path(tempfile.mkdtemp(prefix=f"{PARTIAL_PREFIX}shard-", dir=home))
        self._writers = {
            table: pq.ParquetWriter(
                self._scratch / table,
                written_schema(table, exact),
                write_page_checksum=True,
                **parquet_options(table_schema(table, exact)),
            )
            for table in TABLES
        }

    def add(
        self,
        entry: EpisodeEntry,
        tables: Mapping[TableName, pa.Table],
        road: Mapping[str, FileEntry],
    ) -> None:
        """Write an episode.

        Args:
            entry: what it is.
            tables: all of them.
            road: the file of its road, by name; empty if that is not known.
        """
        self._roads |= road
        for table, rows in tables.items():
            if rows.num_rows:
                self._writers[table].write_table(rows, row_group_size=rows.num_rows)
                self._rows[table] += rows.num_rows
        self._entries.append(entry)

    def close(self, keep: bool = True) -> dict[str, FileEntry]:
        """Move the files to their places, that of agents last.

        Args:
            keep: whether to; otherwise they are removed.

        Returns:
            Size and checksum of each and of the roads, by name.
        """
        files = dict(sorted(self._roads.items()))
        try:
            for table in _AGENTS_LAST if keep else ():
                if table == "agents":
                    shard = Shard(
                        configuration=self._configuration, entries=tuple(self._entries), files=files
                    )
                    text = shard.model_dump_json()
                    self._writers[table].add_key_value_metadata({METADATA_KEY.decode(): text})
                self._writers[table].close()
                file = self._scratch / table
                with file.open("rb") as content:
                    sha256 = hashlib.file_digest(content, "sha256").hexdigest()
                size, rows = file.stat().st_size, self._rows[table]
                files[self._files[table]] = FileEntry(sha256=sha256, size=size, rows=rows)
            for table in _AGENTS_LAST if keep else ():
                self._place.put(self._scratch / table, self._files[table])
        finally:
            shutil.rmtree(self._scratch, ignore_errors=True)
        return files


_AGENTS_LAST: Final = sorted(TABLES, key=lambda table: table == "agents")


def parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """How tables of a schema are written: options of `pyarrow.parquet.ParquetWriter`."""
    numbers = [f.name for f in schema if pa.types.is_floating(f.type)]
    integers = [f.name for f in schema if pa.types.is_integer(f.type)]
    words = [
        f.name if pa.types.is_string(f.type) else f"{f.name}.list.element"
        for f in schema
        if not (f.name in numbers or f.name in integers)
    ]
    return {
        "compression": "zstd",
        "use_dictionary": words,
        "column_encoding": {
            **{name: "BYTE_STREAM_SPLIT" for name in numbers},
            **{name: "DELTA_BINARY_PACKED" for name in integers},
        },
        "store_schema": False,
    }


def metadata_of(path: Path, metadata: pq.FileMetaData, model: type[M]) -> M:
    """Metadata of a dataset's Parquet file as a whole.

    Args:
        path: of the file, for messages.
        metadata: of the file.
        model: what it is expected to be.

    Raises:
        InputError: if it says nothing, or something else.
    """
    found = (metadata.metadata or {}).get(METADATA_KEY)
    if found is None:
        raise InputError(f"{path}: found no metadata of graphrqi, expected a file of a dataset")
    try:
        return model.model_validate_json(found)
    except ValidationError as error:
        raise InputError(f"{path}: {first_wrong_field(error)}") from None


@contextmanager
def opened(place: Place, file: str) -> Iterator[pq.ParquetFile]:
    """A Parquet file of a dataset, whose footer is kept for the next time.

    Raises:
        InputError: if it is broken.
        FileNotFoundError: if the file does not exist.
    """
    path = place.path / file
    try:
        known = _footer(place.url, file, place.stamp(file))
        with place.for_arrow(file) as source:
            yield pq.ParquetFile(source, metadata=known, page_checksum_verification=True)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: found no readable Parquet ({reason:.200})") from None


@lru_cache(maxsize=KEPT_FOOTERS)
def _footer(url: str, file: str, stamp: Hashable) -> pq.FileMetaData:
    """A file's footer; ``stamp`` changes when the file does."""
    with place_of(url).for_arrow(file) as source:
        return pq.read_metadata(source)


def read_rows(
    place: Place, table: TableName, entry: EpisodeEntry, columns: list[str] | None = None
) -> pa.Table:
    """An episode's rows of a table.

    Args:
        place: the dataset.
        table: which.
        entry: the episode.
        columns: those to read; None for all.

    Raises:
        InputError: if the file is missing, broken, or has other columns.
    """
    file = ShardName.of(entry).file(table)
    path = place.path / file
    try:
        with opened(place, file) as parquet:
            schema = table_schema(table, entry.exact)
            missing = set(PERCEPTION_FIELDS) - {*parquet.schema_arrow.names}  # in older datasets
            there = pa.schema([one for one in schema if one.name not in missing])
            check_columns(path, parquet.schema_arrow, there)
            for number in range(parquet.num_row_groups):
                ids = parquet.metadata.row_group(number).column(0).statistics
                if ids is not None and ids.min == ids.max == entry.id:
                    rows = parquet.read_row_group(number, columns, use_threads=False)
                    for name in schema.names[len(there) :] if columns is None else ():
                        rows = rows.append_column(name, pa.nulls(rows.num_rows, pa.float64()))
                    return rows
    except FileNotFoundError:
        raise InputError(f"{path}: found no file, expected the shard of {entry.id}") from None
    none = table_schema(table, entry.exact).empty_table()
    return none if columns is None else none.select(columns)


def check_columns(path: Path, found: pa.Schema, expected: pa.Schema) -> None:
    """Refuse a table that has other columns than the schema, and name the first that differs."""
    for field in expected:
        if field.name not in found.names or not found.field(field.name).equals(field):
            raise InputError(f"{path}: found no column {field.name} of {field.type}, expected it")
    if found.names != expected.names:
        raise InputError(f"{path}: found columns {', '.join(found.names):.120}, expected others")
