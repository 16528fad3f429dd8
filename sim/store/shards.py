"""Reads one episode out of the shards that hold many.

Of a shard's steps only the episode's own row group is read. The other tables are small: they are
read once as a whole and the last ones are kept. Every page's checksum is compared.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict

from behaviors.errors import InputError
from sim.arrow.budget import MAX_TEXT_BYTES, check_budget, check_spelled_out
from sim.arrow.parquet import Footer, opened, opened_group, read_footer, read_packed
from sim.store.decode import check_columns
from sim.store.entries import metadata_of, sorted_entries
from sim.store.places import Folder, Place, place_of
from sim.store.schema import (
    BLOCK_EPISODES,
    MAX_CELLS,
    EpisodeEntry,
    FileEntry,
    FileName,
    shard_schema,
)

KEPT_TABLES: Final = 30
"""How many of the smaller tables a process keeps (those of six shards)."""

KEPT_FOOTERS: Final = 16
"""Of how many shards of steps a process keeps the footer (each some MB)."""

MAX_PART_CHARACTERS: Final = 220
"""Longest part of a shard's path (file systems take 255 bytes)."""


def shard_path(name: FileName, entry: EpisodeEntry) -> str:
    """Where in its dataset a table of an episode's shard lies.

    Args:
        name: which table.
        entry: the episode, which has a shard.

    Raises:
        InputError: if the scenario's name is too long for a folder.

    Examples:
        >>> shard_path("steps.parquet", EpisodeEntry(
        ...     scenario="a road", engine="sumo", id="0" * 16, frames=1, agents=1, agent_steps=1,
        ...     shard="000000-000008"))
        'steps/scenario=a%20road/split=train/000000-000008.parquet'
    """
    return shard_file(name, entry.scenario, entry.split, entry.shard or "")


def shard_file(name: FileName, scenario: str, split: str, shard: str) -> str:
    """As `shard_path`, from what the catalogue says of an episode.

    Raises:
        InputError: if the scenario's name is too long for a folder.
    """
    folder = f"scenario={quote(scenario, safe='')}"
    if len(folder) > MAX_PART_CHARACTERS:
        raise InputError(
            f"scenario: found a name of {len(folder)} letters in a path, expected at most "
            f"{MAX_PART_CHARACTERS}: {scenario:.40}..."
        )
    return f"{name.removesuffix('.parquet')}/{folder}/split={split}/{shard}.parquet"


class Sealed(BaseModel):
    """What a shard's table of agents says of the shard.

    Attributes:
        entries: its episodes, in order.
        files: size and checksum of its other tables, by path.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    entries: tuple[EpisodeEntry, ...]
    files: dict[str, FileEntry]


@dataclass(frozen=True, slots=True)
class Shard:
    """A shard that is there. Its episodes stay on the disk: thousands of shards fit in memory.

    Attributes:
        place: the dataset.
        name: path of its table of agents.
        files: size and checksum of each of its tables, by path.
        scenario: of all its episodes.
        count: how many episodes it holds.
        engines: of its episodes.
        roads: checksums of its episodes' roads.
    """

    place: Place
    name: str
    files: dict[str, FileEntry]
    scenario: str
    count: int
    engines: frozenset[str]
    roads: frozenset[str]

    @property
    def block(self) -> int:
        """Number of the block of indices that it belongs to."""
        return int(self.name.rpartition("/")[2].partition("-")[0]) // BLOCK_EPISODES

    def read(self) -> tuple[EpisodeEntry, ...]:
        """Its episodes, in order.

        Raises:
            InputError: if its table of agents is broken.
        """
        footer = open_footer(self.place, self.name)
        return metadata_of(self.place.path / self.name, footer, Sealed).entries


def shard_of(place: Place, entries: Sequence[EpisodeEntry], files: dict[str, FileEntry]) -> Shard:
    """A shard by what it holds."""
    return Shard(
        place=place,
        name=shard_path("agents.parquet", entries[0]),
        files=files,
        scenario=entries[0].scenario,
        count=len(entries),
        engines=frozenset(entry.engine for entry in entries),
        roads=frozenset(entry.road for entry in entries if entry.road is not None),
    )


def in_order(shards: Iterable[Shard]) -> Iterator[list[EpisodeEntry]]:
    """All episodes in the order of catalogues, those of one block and engine at a time."""
    blocks: dict[str, dict[int, list[Shard]]] = {}
    for shard in shards:
        blocks.setdefault(shard.scenario, {}).setdefault(shard.block, []).append(shard)
    for _, by_block in sorted(blocks.items()):
        engines = {name for some in by_block.values() for shard in some for name in shard.engines}
        for engine in sorted(engines):
            for _, some in sorted(by_block.items()):
                found = (
                    entry for shard in some if engine in shard.engines for entry in shard.read()
                )
                yield sorted_entries(entry for entry in found if entry.engine == engine)


@dataclass(frozen=True, slots=True)
class ShardTables:
    """Tables of an episode that is in a shard, as `sim.store.decode.Tables` has them.

    Attributes:
        place: the dataset.
        entry: the episode.
    """

    place: Place
    entry: EpisodeEntry

    def path(self, name: FileName) -> Path:
        """The shard's file."""
        return self.place.path / shard_path(name, self.entry)

    def table(
        self,
        name: FileName,
        schemas: Sequence[pa.Schema],
        max_rows: int,
        columns: list[str] | None = None,
    ) -> pa.Table:
        """The episode's rows of a table, without the columns that only shards have."""
        file = shard_path(name, self.entry)
        path = self.place.path / file
        try:
            stamp = _stamp(self.place, file)
            if name == "steps.parquet":
                return self._steps(file, stamp, max_rows, columns)
            shard = _small_table(self.place.url, file, stamp, name)
        except FileNotFoundError:
            raise InputError(
                f"{path}: found no file, expected the shard of episode {self.entry.id}"
            ) from None
        begin, count = shard.rows.get(self.entry.id, (0, 0))
        if count > max_rows:
            raise InputError(f"{path}: found {count} rows, expected at most {max_rows}")
        part = shard.table.slice(begin, count)
        for column in part.columns:
            check_spelled_out(path, column, MAX_TEXT_BYTES)
        wanted = schemas[0]
        for field in wanted:
            if not field.nullable and part[field.name].null_count:
                raise InputError(f"{path}: found an empty {field.name}, expected one in every row")
        return part.select(wanted.names).cast(wanted)

    def _steps(
        self, file: str, stamp: Hashable, max_rows: int, columns: list[str] | None
    ) -> pa.Table:
        schema = shard_schema("steps.parquet", exact=bool(self.entry.exact))
        if self.entry.agent_steps == 0:
            return schema.empty_table()
        path = self.place.path / file
        footer = _footer(self.place.url, file, stamp)
        names = [name for name in schema.names if columns is None or name in columns]
        with opened_group(
            footer, self.entry.row_group, lambda begin, end: self.place.read(file, begin, end)
        ) as (layout, parquet):
            check_columns(path, parquet.schema_arrow.remove_metadata(), [schema])
            check_budget(path, layout, [*names, "episode"], max_rows)
            whose = parquet.read_row_group(self.entry.row_group, ["episode"], use_threads=False)
            if whose.num_rows and set(whose.column(0).unique().to_pylist()) != {self.entry.id}:
                raise InputError(
                    f"{path}: row group {self.entry.row_group}: found another episode, expected "
                    f"{self.entry.id}"
                )
            return parquet.read_row_group(self.entry.row_group, names, use_threads=False)


@dataclass(frozen=True, slots=True)
class _SmallTable:
    """One of a shard's smaller tables, and where each episode's rows begin and how many."""

    table: pa.Table
    rows: dict[str, tuple[int, int]]


def _stamp(place: Place, file: str) -> Hashable:
    """What changes when a file does; of object stores nothing, since it would be asked for."""
    if not isinstance(place, Folder):
        return None
    status = (place.path / file).stat()
    return status.st_size, status.st_mtime_ns, status.st_ino


def open_footer(place: Place, file: str) -> Footer:
    """The end of a file of a dataset.

    Raises:
        InputError: if it is broken.
        FileNotFoundError: if there is no such file.
    """
    size = place.size(file)
    if size is None:
        raise FileNotFoundError(2, "No such file", str(place.path / file))
    return read_footer(place.path / file, size, lambda begin, end: place.read(file, begin, end))


@lru_cache(maxsize=KEPT_FOOTERS)
def _footer(url: str, file: str, stamp: Hashable) -> Footer:
    return open_footer(place_of(url), file)


@lru_cache(maxsize=KEPT_TABLES)
def _small_table(url: str, file: str, stamp: Hashable, name: FileName) -> _SmallTable:
    place = place_of(url)
    path = place.path / file
    schema = shard_schema(name)
    with opened(path, place.read(file)) as (layout, source):
        check_columns(path, pq.read_schema(source).remove_metadata(), [schema])
        texts = check_budget(path, layout, None, MAX_CELLS)
        table = read_packed(source, texts, None)
    episode = table.column("episode").combine_chunks()
    if isinstance(episode, pa.ChunkedArray):
        episode = episode.chunk(0) if episode.num_chunks else pa.array([], schema.field(0).type)
    if episode.null_count:
        raise InputError(f"{path}: found an empty episode, expected one in every row")
    return _SmallTable(table, _runs(path, episode))


def _runs(path: Path, episode: pa.Array) -> dict[str, tuple[int, int]]:
    """Where each episode's rows are."""
    if not len(episode):
        return {}
    packed = episode if pa.types.is_dictionary(episode.type) else episode.dictionary_encode()
    code = packed.indices.to_numpy()
    words = packed.dictionary.to_pylist()
    begins = np.flatnonzero(np.diff(code, prepend=-1))
    counts = np.diff(begins, append=code.size)
    found = {words[code[b]]: (int(b), int(n)) for b, n in zip(begins, counts, strict=True)}
    if len(found) != begins.size:
        raise InputError(f"{path}: found rows of an episode apart, expected them in one piece")
    return found
