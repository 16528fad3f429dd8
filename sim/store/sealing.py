"""Puts finished episodes into shards, and completes a dataset by its catalogue.

Which episodes a shard holds follows from the episodes that there are, not from who made them or
when. The table of agents is written last and says, in its metadata, which episodes the shard holds:
so what a killed run has sealed is found again, and a lost catalogue can be written again.
"""

from __future__ import annotations

import itertools
import re
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import JsonValue

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.frames import KINDS
from sim.store.atomic import PARTIAL_PREFIX
from sim.store.catalogue import MANIFEST, is_unaltered, road_is_sound, road_name, tables_of
from sim.store.decode import STEPS, Tables
from sim.store.encode import parquet_options
from sim.store.entries import (
    EPISODES,
    METADATA_KEY,
    as_json,
    catalogue_table,
    header_of,
    metadata_of,
    open_catalogue,
    sorted_entries,
    write_catalogue,
)
from sim.store.places import Folder, Place, Store, file_checksum, place_of
from sim.store.schema import (
    BLOCK_EPISODES,
    EPISODE_FILES,
    MAX_CELLS,
    MAX_SHARD_ROWS,
    MAX_SHARD_STEPS,
    TABLES,
    EpisodeEntry,
    FileEntry,
    FileName,
    Manifest,
    shard_schema,
    table_schema,
)
from sim.store.shards import Sealed, Shard, in_order, open_footer, shard_of, shard_path

_FILES: Final = cast("tuple[FileName, ...]", EPISODE_FILES)
_SHARD: Final = re.compile(
    rf"^({'|'.join(TABLES)})/scenario=[^/]+/split=[a-z]+/\d{{6,}}-\d{{6,}}(-\d+)?\.parquet$"
)


# --- planning -----------------------------------------------------------------------------------


def planned_shards(entries: Iterable[EpisodeEntry]) -> Iterator[list[EpisodeEntry]]:
    """Which episodes belong into one shard.

    Args:
        entries: every episode of some whole blocks.

    Yields:
        Entries with the shard's name, in the order of catalogues.
    """

    def group(entry: EpisodeEntry) -> tuple[str, str, int, bool]:
        return entry.scenario, entry.split, entry.index // BLOCK_EPISODES, bool(entry.exact)

    names: set[tuple[str, str, str]] = set()
    for _, same in itertools.groupby(sorted(sorted_entries(entries), key=group), key=group):
        for part in _within_limits(same):
            indices = [entry.index for entry in part]
            name = f"{min(indices):06}-{max(indices):06}"
            tried = (f"{name}-{n}" if n else name for n in itertools.count())
            scenario, split = part[0].scenario, part[0].split
            name = next(one for one in tried if (scenario, split, one) not in names)
            names.add((scenario, split, name))
            yield [
                entry.model_copy(update={"shard": name, "row_group": number, "files": {}})
                for number, entry in enumerate(part)
            ]


def _within_limits(entries: Iterable[EpisodeEntry]) -> Iterator[list[EpisodeEntry]]:
    """Parts of a sequence that are no larger than shards may be."""
    part: list[EpisodeEntry] = []
    steps = rows = 0
    for entry in entries:
        more = max(sum(entry.drawn.get(kind.value, 0) for kind in KINDS), entry.frames)
        if part and (steps + entry.agent_steps > MAX_SHARD_STEPS or rows + more > MAX_SHARD_ROWS):
            yield part
            part, steps, rows = [], 0, 0
        part.append(entry)
        steps += entry.agent_steps
        rows += more
    if part:
        yield part


# --- writing ------------------------------------------------------------------------------------


def with_counts(place: Place, entry: EpisodeEntry) -> EpisodeEntry:
    """An entry, and what a catalogue says beyond the entry of an episode with files of its own.

    Args:
        place: where those files are.
        entry: of the episode.

    Raises:
        InputError: if a file is missing, altered or broken.
    """
    if entry.exact is not None:
        return entry
    tables = tables_of(place, entry)
    agents = tables.table("agents.parquet", [table_schema("agents.parquet")], MAX_CELLS)
    drawn: dict[str, int] = {}
    for column, words in (("kind", KINDS), ("behavior", BEHAVIORS)):
        counts = pc.value_counts(agents.column(column)).to_pylist()
        found = {one["values"]: one["counts"] for one in counts}
        drawn |= {word.value: found[word.value] for word in words if word.value in found}
    steps = tables.table("steps.parquet", STEPS, MAX_CELLS, ["x_m"])
    exact = steps.schema.field("x_m").type == pa.float64()
    return entry.model_copy(update={"exact": exact, "drawn": drawn})


@dataclass(frozen=True, slots=True)
class Sealer:
    """Puts episodes into the shards of a dataset.

    Attributes:
        place: the dataset.
        staging: where episodes are made; for a dataset on this machine, its own folder.
        waiting: where finished episodes wait; None if it is ``staging``.
    """

    place: Place
    staging: Path
    waiting: Place | None = None

    @property
    def _origin(self) -> Place:
        return self.waiting or Folder(self.staging)

    def seal(self, entries: Iterable[EpisodeEntry], there: Iterable[Shard] = ()) -> list[Shard]:
        """Put the episodes of some whole blocks into shards, where they are not.

        Args:
            entries: every episode of the blocks that is there, in a shard or waiting.
            there: shards that are there, whole.

        Returns:
            The shards that hold them now. Those that are no longer needed are still there.

        Raises:
            InputError: if an episode is missing, altered or broken.
            OSError: if a shard cannot be written.
        """
        origins = {entry.id: with_counts(self._origin, entry) for entry in entries}
        known = {shard.name: shard for shard in there}
        shards = []
        for planned in planned_shards(origins.values()):
            name = shard_path("agents.parquet", planned[0])
            found = known.get(name)
            same = found is not None and found.read() == tuple(planned)
            shards.append(found if found and same else self._write(planned, origins))
        return shards

    def _write(self, planned: Sequence[EpisodeEntry], origins: Mapping[str, EpisodeEntry]) -> Shard:
        files: dict[str, FileEntry] = {}
        names = sorted(_FILES, key=lambda name: name == "agents.parquet")  # that one last
        made = []
        for entry in planned:
            origin = origins[entry.id]
            place = self._origin if origin.shard is None else self.place
            made.append((entry, tables_of(place, origin)))
        with scratch_folder(self.staging) as scratch:
            for name in names:
                said = None
                if name == "agents.parquet":
                    sealed = Sealed(entries=tuple(planned), files=files)
                    said = as_json(sealed.model_dump())
                _write_table(scratch / name, name, made, said)
                file = FileEntry(
                    size=(scratch / name).stat().st_size,
                    sha256=file_checksum(Folder(scratch), name),
                )
                path = shard_path(name, planned[0])
                self.place.put(scratch / name, path)
                files[path] = file
        return shard_of(self.place, planned, files)

    def complete(
        self,
        configuration: Mapping[str, JsonValue],
        shards: Sequence[Shard],
    ) -> None:
        """Write the catalogue of a dataset, and remove what is no longer needed beside it.

        Args:
            configuration: what the dataset was generated or imported with.
            shards: all of them. Only the episodes of one block are in memory at a time.

        Raises:
            InputError: if a road is missing.
            OSError: if the catalogue cannot be written; an older one is then still there, whole.
        """
        files = {path: file for shard in shards for path, file in shard.files.items()}
        roads = {road for shard in shards for road in shard.roads}
        self._publish_roads(roads)
        header = header_of(configuration, road_sizes(self.place, roads), files)
        write_catalogue(self.place, header, map(catalogue_table, in_order(shards)))
        self._tidy(header.files, shards)

    def _publish_roads(self, roads: Collection[str]) -> None:
        """Move the roads that are made elsewhere to the dataset."""
        for waiting in (Folder(self.staging), self.waiting or self.place):
            if waiting.url == self.place.url:
                continue
            for sha256 in sorted(roads):
                name = road_name(waiting, sha256)
                if waiting.size(name) is not None:
                    self.place.write(name, waiting.read(name))

    def _tidy(self, files: Collection[str], shards: Sequence[Shard]) -> None:
        """Remove shards that the catalogue does not list, and episodes that are in a shard now."""
        for table in TABLES:
            for name in list(self.place.files(table)):
                if name not in files and _SHARD.match(name):
                    self.place.remove(name)
        there = self._waiting_ids()
        for entries in in_order(shards) if there else ():
            self.remove_waiting([entry.id for entry in entries if entry.id in there])
        if self.place.size(MANIFEST) is not None:
            self.place.remove(MANIFEST)

    def _waiting_ids(self) -> set[str]:
        """Ids of the episodes that wait, here or in the object store."""
        found = {path.name for path in (self.staging / "episodes").glob("*")}
        if self._waits_in_store:
            found |= {name.split("/")[1] for name in self._origin.files("episodes")}
        return found

    @property
    def _waits_in_store(self) -> bool:
        return isinstance(self.waiting, Store) and self.waiting.url == self.place.url

    def remove_waiting(self, identities: Collection[str]) -> None:
        """Remove the folders of episodes that are in a shard now."""
        if self._waits_in_store and identities:
            wanted = set(identities)
            for name in list(self._origin.files("episodes")):
                if name.split("/")[1] in wanted:
                    self._origin.remove(name)
        home = self.staging / "episodes"
        for identity in identities:
            shutil.rmtree(home / identity, ignore_errors=True)
        with suppress(OSError):
            home.rmdir()


@contextmanager
def scratch_folder(home: Path) -> Iterator[Path]:
    """A hidden folder for the files of a shard, removed at the end of the block."""
    home.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f"{PARTIAL_PREFIX}shard-", dir=home))
    try:
        yield scratch
    except OSError as error:
        if error.filename is None:
            error.filename = str(home)
        raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _write_table(
    file: Path,
    name: FileName,
    episodes: Sequence[tuple[EpisodeEntry, Tables]],
    said: str | None,
) -> None:
    """Write one table of a shard: steps in a row group per episode, all others in one."""
    exact = bool(episodes[0][0].exact)
    schema, own = shard_schema(name, exact), table_schema(name, exact)
    rest: list[pa.Table] = []
    with pq.ParquetWriter(
        file, schema, write_page_checksum=True, **parquet_options(schema)
    ) as writer:
        for entry, tables in episodes:
            table = tables.table(name, [own], MAX_CELLS)
            count = table.num_rows
            added = [pa.repeat(pa.scalar(entry.id), count)]
            if name == "frames.parquet":
                added.append(pa.array(np.arange(count, dtype=np.int32)))
            whole = pa.Table.from_arrays([*added, *table.select(own.names).columns], schema=schema)
            if name == "steps.parquet":
                writer.write_table(whole.combine_chunks(), row_group_size=max(1, count))
            else:
                rest.append(whole)
        if rest:
            whole = pa.concat_tables(rest).combine_chunks()
            writer.write_table(whole, row_group_size=max(1, whole.num_rows))
        if said is not None:
            writer.add_key_value_metadata({METADATA_KEY.decode(): said})


# --- what is there ------------------------------------------------------------------------------


def shards_in(place: Place, blocks: Collection[int] | None = None) -> Iterator[Shard]:
    """The shards of a dataset, whether a catalogue lists them or not, and whether whole or not.

    Args:
        place: the dataset.
        blocks: only those of these blocks; None for all.

    Yields:
        Every shard whose table of agents can be read, in order of path.
    """
    for name in list(place.files("agents")):
        if not _SHARD.match(name):
            continue
        block = int(name.rpartition("/")[2].partition("-")[0]) // BLOCK_EPISODES
        if blocks is not None and block not in blocks:
            continue
        try:
            path = place.path / name
            sealed = metadata_of(path, open_footer(place, name), Sealed)
            if not sealed.entries or shard_path("agents.parquet", sealed.entries[0]) != name:
                continue
            size = place.size(name)
            own = FileEntry(sha256=file_checksum(place, name), size=size or 0)
        except (InputError, FileNotFoundError):
            continue
        yield shard_of(place, sealed.entries, {**sealed.files, name: own})


def is_whole(place: Place, shard: Shard, hashed: bool = True) -> bool:
    """Whether every table of a shard is there, unaltered.

    Args:
        place: the dataset.
        shard: which.
        hashed: whether to read and compare everything; otherwise sizes are.
    """
    rest = shard.name.partition("/")[2]
    expected = {f"{table}/{rest}" for table in TABLES}
    return expected == set(shard.files) and all(
        is_unaltered(place, path, file, hashed) for path, file in shard.files.items()
    )


def whole_shards(
    place: Place,
    listed: Mapping[str, FileEntry] | None,
    blocks: Collection[int] | None = None,
    hashed: bool = True,
) -> list[Shard]:
    """The shards of a dataset that are whole.

    Args:
        place: the dataset.
        listed: the checksums that the catalogue has; None where there is no catalogue.
        blocks: only those of these blocks; None for all.
        hashed: whether to compare content on this machine, too, and not only sizes.

    Returns:
        Shards whose tables agree with each other and with the catalogue. In object stores, the
        sizes of tables are compared, not their content.
    """
    remote = not isinstance(place, Folder)
    found = []
    for shard in shards_in(place, blocks):
        known = listed is None or all(
            listed.get(path, file) == file for path, file in shard.files.items()
        )
        if known and is_whole(place, shard, hashed=hashed and not remote):
            found.append(shard)
    return found


def entries_in(place: Place) -> dict[str, EpisodeEntry]:
    """The episodes that are in whole shards of a dataset, by id.

    Args:
        place: the dataset. Shards that are not as its catalogue says, and episodes whose road is
            altered, are left out.
    """
    catalogue = open_catalogue(place)
    shards = whole_shards(place, None if catalogue is None else catalogue.header.files)
    roads = {road for shard in shards for road in shard.roads}
    unsound = {road for road in roads if not road_is_sound(place, road)}
    return {e.id: e for shard in shards for e in shard.read() if e.road not in unsound}


def write_manifest(
    folder: Path,
    configuration: Mapping[str, JsonValue],
    entries: Iterable[EpisodeEntry],
    out: Path | None = None,
) -> Manifest:
    """Complete a dataset: put its episodes into shards and write the catalogue.

    Args:
        folder: where its episodes were written.
        configuration: what it was generated or imported with.
        entries: its episodes.
        out: the dataset, a folder or a URL; None if it is ``folder``.

    Returns:
        What the catalogue says.

    Raises:
        InputError: if an episode is missing, altered or broken.
        OSError: if something cannot be written; an older catalogue is then still there, whole.
    """
    place = place_of(out or folder)
    sealer = Sealer(place, folder)
    everything = list(entries)
    shards = sealer.seal(everything, whole_shards(place, None))
    sealer.complete(configuration, shards)
    return manifest_of(place)


def manifest_of(place: Place) -> Manifest:
    """What the catalogue of a dataset says, an object for each episode."""
    catalogue = open_catalogue(place)
    if catalogue is None:
        raise InputError(f"{place.url}: found no {EPISODES}, expected one")
    return catalogue.manifest


def road_sizes(place: Place, roads: Collection[str]) -> dict[str, int]:
    """Size of every road of a dataset, by its checksum.

    Raises:
        InputError: if one is missing.
    """
    found = {}
    for sha256 in sorted(roads):
        name = road_name(place, sha256)
        size = place.size(name)
        if size is None:
            raise InputError(f"{place.path / name}: found no file, expected a road")
        found[sha256] = size
    return found
