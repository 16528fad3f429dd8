"""Writes episodes into shards, and whole datasets.

A shard is a file for each table that holds several episodes, each a row group of its own. Its files
are written into a hidden folder and moved to their places when the shard is finished.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import JsonValue

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Style
from behaviors.traits import ShownTrait
from sim.episode.annotate import annotate
from sim.files import (
    PARTIAL_PREFIX,
    Place,
    local_path,
    new_folder,
    place_of,
    temporary_folder,
    whole_file,
)
from sim.frames import KINDS, Frame, Tracks
from sim.road import Road
from sim.road.road_files import ENDINGS, SUFFIX, encode_road, read_road_file
from sim.safety import Conflicts, conflicts
from sim.scenario import AgentSpec
from sim.store.encoding import encode, road_columns, rounded, written_schema
from sim.store.schema import (
    CATALOGUE,
    DRAWN,
    EPISODE_VERSION,
    EPISODES,
    METADATA_KEY,
    SCHEMA_VERSION,
    TABLES,
    WORDS,
    EpisodeEntry,
    EpisodeMeta,
    FileEntry,
    Header,
    Shard,
    TableName,
    as_json,
    shard_file,
    table_schema,
    words_of,
)

_DETERMINING: Final = {
    "sumo": "libsumo",
    "sumo-idm": "libsumo",
    "highway": "highway-env",
    "highway-krauss": "highway-env",
}
"""The package that determines an engine's bytes, beside this one, numpy and pyarrow."""


def made_with(*engines: str) -> dict[str, str]:
    """Versions, by name, of the packages that determine the bytes of episodes of some engines."""
    own = [_DETERMINING[engine] for engine in engines if engine in _DETERMINING]
    return {name: metadata.version(name) for name in ("graphrqi", "numpy", "pyarrow", *own)}


def checksum(data: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


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


class _OpenShard:
    """A shard to which episodes are added, in a hidden folder."""

    def __init__(self, place: Place, first: EpisodeEntry) -> None:
        self.entries: list[EpisodeEntry] = []
        self.roads: dict[str, FileEntry] = {}
        self._place, self._rows = place, dict.fromkeys(TABLES, 0)
        home = None if place.remote else place.path
        self._folder = Path(tempfile.mkdtemp(prefix=f"{PARTIAL_PREFIX}shard-", dir=home))
        self._writers = {
            table: pq.ParquetWriter(
                self._folder / table,
                written_schema(table, first.exact),
                **parquet_options(table_schema(table, first.exact)),
            )
            for table in sorted(TABLES, key=lambda table: table == "agents")
        }

    def add(
        self,
        entry: EpisodeEntry,
        tables: Mapping[TableName, pa.Table],
        road: Mapping[str, FileEntry],
    ) -> None:
        """Write an episode."""
        self.roads |= road
        for table, rows in tables.items():
            if rows.num_rows:
                self._writers[table].write_table(rows, row_group_size=rows.num_rows)
                self._rows[table] += rows.num_rows
        self.entries.append(entry)

    def close(self, configuration: Mapping[str, JsonValue]) -> dict[str, FileEntry]:
        """Move the files to their places, that of agents last; returns them and the roads."""
        files, first = dict(sorted(self.roads.items())), self.entries[0]
        names = {t: shard_file(t, first.scenario, first.split, first.index) for t in self._writers}
        for table, writer in self._writers.items():
            if table == "agents":
                said = dict(configuration)
                shard = Shard(configuration=said, entries=tuple(self.entries), files=files)
                writer.add_key_value_metadata({METADATA_KEY: shard.model_dump_json()})
            writer.close()
            sha256 = Place(str(self._folder)).checksum(table)
            size = (self._folder / table).stat().st_size
            files[names[table]] = FileEntry(sha256=sha256, size=size, rows=self._rows[table])
        for table, name in names.items():
            self._place.put(self._folder / table, name)
        self.remove()
        return files

    def remove(self) -> None:
        """Remove what is left in the hidden folder."""
        shutil.rmtree(self._folder, ignore_errors=True)


class EpisodeWriter:
    """Writes episodes one after another into the shards that they belong to; a context manager.

    The files of a shard appear when an episode of another block follows, or when the ``with`` block
    ends without an error.

    Args:
        place: the dataset.
        configuration: what the dataset is made from.

    Attributes:
        entries: what the catalogue says of the episodes that were written.
        files: size and checksum of the files that have appeared, by name.
    """

    def __init__(self, place: Place, configuration: Mapping[str, JsonValue]) -> None:
        self._place, self._configuration = place, configuration
        self._open: dict[tuple[str, str], _OpenShard] = {}  # by scenario and split
        self._roads: set[str] = set()
        self.entries: list[EpisodeEntry] = []
        self.files: dict[str, FileEntry] = {}

    def __enter__(self) -> EpisodeWriter:
        """Begin; nothing is written yet."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Put the shards in their places, or remove them after an error."""
        try:
            for shard in self._open.values() if kind is None else ():
                self.files |= shard.close(self._configuration)
        finally:
            for shard in self._open.values():
                shard.remove()

    def write_episode(
        self,
        meta: EpisodeMeta,
        frames: Iterable[Frame],
        agents: Sequence[AgentSpec],
        road: Path | None = None,
        since_s: float | None = None,
    ) -> EpisodeEntry:
        """Run frames to their end and write them as one episode.

        Args:
            meta: what the episode is made from.
            frames: the episode, in time order; closed here, also on an error.
            agents: all agents that may appear in a frame.
            road: the episode's SUMO net (``scenario.road.source``); it is needed for rule events,
                near misses, causes, lanes, leaders and shown traits.
            since_s: write only what is later than this, s. Events and traits are found with all
                frames in sight. None writes everything.
        """
        frames = iter(frames)
        try:
            tracks = rounded(Tracks.from_frames(_checked(frames)))
        finally:
            getattr(frames, "close", lambda: None)()
        strangers = sorted({*tracks.ids.tolist()} - {agent.id for agent in agents})
        if strangers:
            raise InputError(f"frames: found agent {strangers[0]}, expected one of those given")
        shown: tuple[ShownTrait, ...] = ()
        known: dict[str, pa.Array] = {}
        met: Conflicts | None = None
        if road is not None and tracks.time_s.size > 2:
            where = read_road_file(road)
            found = annotate(tracks, where)
            tracks = replace(tracks, events=found.events)
            shown, met = found.shown_traits, found.conflicts
            known = road_columns(tracks, found, where)
        if since_s is not None:
            first = int(np.searchsorted(tracks.time_s, since_s + 1e-9))
            later = pa.array(tracks.index.step >= first)
            known = {name: column.filter(later) for name, column in known.items()}
            shown = tuple(trait for trait in shown if trait.begin_s > since_s)
            tracks = tracks.part(np.arange(tracks.ids.size), slice(first, None))
            met = None
        ordered = sorted(agents, key=lambda a: a.id)
        return self.write_tracks(meta, tracks, ordered, road, shown=shown, known=known, met=met)

    def write_recording(
        self,
        meta: EpisodeMeta,
        tracks: Tracks,
        road: Path | Road | None = None,
        styles: Mapping[str, Style] = MappingProxyType({}),
    ) -> EpisodeEntry:
        """Write recorded tracks as one episode, exactly as they are.

        Args:
            meta: where the recording comes from.
            tracks: the recording.
            road: the road that it happened on, or the file of its SUMO net or Argoverse 2 map.
            styles: by name, of drivers with a known style and an unknown behaviour.
        """
        n, index = tracks.ids.size, tracks.index
        codes = np.full(n, -1) if tracks.behavior is None else tracks.behavior
        seen, first_s = np.diff(index.first) > 0, np.full(n, tracks.time_s[:1].sum())
        first_s[seen] = tracks.time_s[index.step[index.first[:-1][seen]]]
        agents = [
            AgentSpec(
                id=int(tracks.ids[i]),
                kind=KINDS[tracks.kind[i]],
                behavior=None if codes[i] < 0 else tracks.classes[codes[i]],
                profile=None,
                route=(),
                depart_s=float(first_s[i]),
                length_m=float(tracks.length[i]),
                width_m=float(tracks.width[i]),
                style_label=styles.get(tracks.names[i]) if codes[i] < 0 else None,
            )
            for i in range(n)
        ]
        return self.write_tracks(meta, tracks, agents, road, exact=True)

    def write_tracks(
        self,
        meta: EpisodeMeta,
        tracks: Tracks,
        agents: Sequence[AgentSpec],
        road: Path | Road | None = None,
        *,
        exact: bool = False,
        drawn: Sequence[AgentSpec] | None = None,
        shown: Sequence[ShownTrait] = (),
        known: Mapping[str, pa.Array] = MappingProxyType({}),
        met: Conflicts | None = None,
    ) -> EpisodeEntry:
        """Write tracks as one episode.

        Args:
            meta: what the episode is made from.
            tracks: what was seen, with its events.
            agents: the agents that are written, in order of id.
            road: the road that it happened on, or the file of its SUMO net or Argoverse 2 map.
            exact: whether to write float64 as it is; else the tracks are `rounded`.
            drawn: the agents that determine the episode; None for ``agents``.
            shown: the traits that were shown.
            known: columns of the steps that come from the road; those left out are null.
            met: its conflicts; None to look for them.
        """
        kept = {} if road is None else self._keep_road(road)
        sha256 = next((file.sha256 for file in kept.values()), None)
        index = tracks.index
        entry = EpisodeEntry(
            **meta.model_dump(),
            id=_identity(meta, drawn or agents, sha256, tracks if exact else None),
            road=sha256,
            frames=int(tracks.time_s.size),
            agents=int((np.diff(index.first) > 0).sum()),
            agent_steps=int(index.agent.size),
            exact=exact,
            drawn=_drawn(agents),
        )
        if met is None:
            met = conflicts(tracks, read_road_file(road) if isinstance(road, Path) else road)
        tables = encode(tracks, exact, known, agents, shown, met, entry.id)
        of = entry.scenario, entry.split
        if of in self._open and self._open[of].entries[0].shard != entry.shard:
            self.files |= self._open[of].close(self._configuration)
            del self._open[of]
        if of not in self._open:
            self._open[of] = _OpenShard(self._place, entry)
        self._open[of].add(entry, tables, kept)
        self.entries.append(entry)
        return entry

    def _keep_road(self, road: Path | Road) -> dict[str, FileEntry]:
        """Put a road into the dataset, unless it is there already; returns its file."""
        data = encode_road(road) if isinstance(road, Road) else road.read_bytes()
        sha256 = checksum(data)
        name = SUFFIX if isinstance(road, Road) else road.name
        file = f"roads/{sha256}{next((e for e in ENDINGS if name.endswith(e)), ENDINGS[-1])}"
        if file not in self._roads and self._place.size(file) != len(data):
            self._place.write(file, data)
        self._roads.add(file)
        return {file: FileEntry(sha256=sha256, size=len(data))}


def _identity(
    meta: EpisodeMeta, agents: Sequence[AgentSpec], road: str | None, recorded: Tracks | None
) -> str:
    """An episode's id: the hash of everything that determines its content."""
    made_from = {**meta.model_dump(), "version": EPISODE_VERSION, "road": road}
    content = hashlib.sha256(as_json(made_from).encode())
    content.update(repr(list(agents)).encode())
    if recorded is not None:
        for values in (recorded.time_s, recorded.signals, recorded.index.agent, recorded.index.step,
                       recorded.row_xy, recorded.row_heading, recorded.row_speed):  # fmt: skip
            content.update(np.ascontiguousarray(values).tobytes())
    return content.hexdigest()[:16]


def _drawn(agents: Sequence[AgentSpec]) -> dict[str, int]:
    """How many agents of each kind and behaviour there are."""
    words = [str(word) for a in agents for word in (a.kind, a.behavior)]
    return {str(word): words.count(word) for word in (*KINDS, *BEHAVIORS) if word in words}


def _checked(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The same frames, whose times must increase."""
    before = -np.inf
    for frame in frames:
        if frame.time_s <= before:
            raise InputError(f"frame.time_s: found {frame.time_s}, expected later than {before}")
        before = frame.time_s
        yield frame


def write_catalogue(
    place: Place,
    configuration: Mapping[str, JsonValue],
    entries: Sequence[EpisodeEntry],
    files: Mapping[str, FileEntry],
) -> None:
    """Write the catalogue of a dataset, which completes it.

    Args:
        place: the dataset.
        configuration: what it is made from.
        entries: its episodes, in any order.
        files: size and checksum of its other files, by name.
    """
    parts = [
        pa.Table.from_pylist([_row(entry) for entry in entries[at : at + 10_000]], schema=CATALOGUE)
        for at in range(0, len(entries), 10_000)
    ]
    table = pa.concat_tables([CATALOGUE.empty_table(), *parts])
    table = table.sort_by([(name, "ascending") for name in ("scenario", "engine", "index", "id")])
    header = Header(
        schema_version=SCHEMA_VERSION,
        configuration=dict(configuration),
        files=dict(sorted(files.items())),
    )
    options = {**parquet_options(CATALOGUE), "use_dictionary": WORDS}
    with (
        whole_file(place.path / EPISODES) as partial,
        pq.ParquetWriter(partial, CATALOGUE, **options) as writer,
    ):
        writer.write_table(table.combine_chunks(), row_group_size=2**17)  # a few MB
        writer.add_key_value_metadata({METADATA_KEY: as_json(header.model_dump())})


def _row(entry: EpisodeEntry) -> dict[str, Any]:
    """An entry as a row of the catalogue."""
    return {
        **{name: getattr(entry, name, None) for name in CATALOGUE.names},
        **{word: entry.drawn.get(word, 0) for word in DRAWN},
        "flow": words_of(entry.options.get("flow")),
        "mix": words_of(entry.options.get("mix")),
        "options": as_json(entry.options),
        "made_with": as_json(entry.made_with),
    }


@contextmanager
def new_dataset(out: str | Path, configuration: Mapping[str, JsonValue]) -> Iterator[EpisodeWriter]:
    """Write a dataset that appears as a whole, when the block ends without an error.

    Args:
        out: a new or empty folder, or a URL where nothing is.
        configuration: what the dataset is made from.

    Yields:
        Writer of its episodes.
    """
    place = place_of(out)
    if place.remote and place.files():
        raise InputError(f"{place.url}: found something there, expected nothing")
    with temporary_folder("dataset") if place.remote else new_folder(local_path(out)) as folder:
        made = Place(str(folder))
        with EpisodeWriter(made, configuration) as writer:
            yield writer
        write_catalogue(made, configuration, writer.entries, writer.files)
        if place.remote:
            for name in sorted(made.files(), key=lambda name: name == EPISODES):
                place.put(folder / name, name)
