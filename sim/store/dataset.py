"""A dataset of labelled episodes: opened by its catalogue, read back as arrays.

It is opened by the catalogue's last bytes alone. Its rows are read when they are asked for, and
become `EpisodeEntry` objects only where an episode is. A million episodes open in less than a
second. `sim.store.schema` says what the files hold; `sim.store.writing` writes them.
"""

from __future__ import annotations

import hashlib
import html
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, reduce
from pathlib import Path
from typing import Any, Final, get_args

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import ValidationError

from behaviors.errors import InputError, counted
from behaviors.labels import BEHAVIORS, Behavior, Style, read_behaviors
from behaviors.traits import ShownTrait
from sim.files import place_of, temporary_folder
from sim.frames import Tracks
from sim.invalid_fields import first_wrong_field
from sim.road import Road
from sim.road.road_files import read_road_file
from sim.safety import Conflicts
from sim.scenario import AgentSpec
from sim.store.reading import (
    check_columns,
    metadata_of,
    opened,
    read_conflicts,
    read_rows,
    read_tables,
)
from sim.store.schema import (
    CATALOGUE,
    DRAWN,
    EPISODES,
    TABLES,
    WORDS,
    EpisodeEntry,
    Header,
    Manifest,
    Split,
    TableName,
    shard_file,
    table_schema,
    words_of,
)

SHOWN_EPISODES: Final = 10
"""Most episodes that a notebook shows of a dataset."""


@dataclass(frozen=True)
class Episode:
    """One episode in memory.

    Attributes:
        entry: what it is and how it was made.
        tracks: every agent that was seen, with labels in ``tracks.behavior``.
        agents: every agent that was drawn, seen or not, in order of id.
        shown_traits: in order of time; their ``agent`` and ``other`` are ids (-1: none).
    """

    entry: EpisodeEntry
    tracks: Tracks
    agents: tuple[AgentSpec, ...]
    shown_traits: tuple[ShownTrait, ...] = ()

    def __repr__(self) -> str:
        """Where it comes from and what it holds."""
        entry = self.entry
        return (
            f"Episode({entry.id}: {entry.scenario:.60} {entry.index} by {entry.engine:.60}, seed "
            f"{entry.seed}, {entry.split}; {counted(len(self.agents), 'agent')} drawn, "
            f"{counted(len(self.shown_traits), 'shown trait')}; {self.tracks!r})"
        )


class Dataset:
    """A dataset whose catalogue has been opened; nothing else of it has been read.

    Attributes:
        path: its folder, or its URL as a path.
        header: what concerns it as a whole.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the dataset of a folder or URL; see `open_dataset`."""
        self._place = place = place_of(path)
        self.path = place.path
        self._catalogue = place.path / EPISODES
        if place.size(EPISODES) is None:
            if not place.remote and not place.path.is_dir():
                what = "a file" if place.path.exists() else "nothing there"
                raise InputError(
                    f"{place.url}: found {what}, expected a dataset (import makes one)"
                )
            again = "if the dataset is unfinished, run the same generate again"
            raise InputError(f"{self._catalogue}: found no file; {again}")
        with opened(place, EPISODES) as parquet:
            self.header = metadata_of(self._catalogue, parquet.metadata, Header)
            self._count = int(parquet.metadata.num_rows)

    @cached_property
    def catalogue(self) -> pa.Table:
        """The catalogue as an Arrow table of the columns ``sim.store.schema.CATALOGUE``."""
        with opened(self._place, EPISODES, read_dictionary=WORDS) as parquet:
            found = parquet.metadata.schema.to_arrow_schema()  # of which no column is a dictionary
            check_columns(self._catalogue, found, CATALOGUE)
            return parquet.read(use_threads=False).unify_dictionaries().combine_chunks()

    @cached_property
    def manifest(self) -> Manifest:
        """Everything that is known of the dataset, an object for each episode."""
        return Manifest(**dict(self.header), episodes=self._entries(self.catalogue))

    @property
    def behaviors(self) -> tuple[Behavior, ...]:
        """The behaviours that its drivers may have: the six, then those of one's own."""
        said = self.header.configuration.get("behaviors")
        return (*BEHAVIORS, *read_behaviors(said if isinstance(said, dict) else None))

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios that have episodes, sorted."""
        return tuple(sorted(pc.unique(self.catalogue["scenario"]).to_pylist()))

    def __len__(self) -> int:
        """How many episodes there are."""
        return self._count

    def __iter__(self) -> Iterator[Episode]:
        """Every episode, read one after another in the catalogue's order."""
        for entry in self.manifest.episodes:
            yield self.read(entry)

    def episodes(
        self,
        split: Split | None = None,
        scenario: str | None = None,
        behavior: str | None = None,
        mix: str | Mapping[str, float] | None = None,
        flow: str | float | None = None,
    ) -> tuple[EpisodeEntry, ...]:
        """The episodes that fit, in the catalogue's order.

        Args:
            split: only this part of the data; None for all.
            scenario: only this scenario; None for all.
            behavior: only episodes for which a driver of this behaviour was drawn.
            mix: only episodes made with this mix, as a mapping or as ``timid=.5,careful=.5``.
            flow: only episodes made with this flow, as a word or in vehicles per hour.

        Returns:
            Their entries. Only those that fit become objects.
        """
        return self._entries(self._fitting(split, scenario, behavior, mix, flow))

    def _entries(self, rows: pa.Table) -> tuple[EpisodeEntry, ...]:
        """Rows of the catalogue as entries, whose JSON is parsed once where it is the same."""
        names = [name for name in EpisodeEntry.model_fields if name in CATALOGUE.names]
        parsed = cache(json.loads)
        found: list[EpisodeEntry] = []
        try:
            for row in rows.to_pylist():
                fields = {name: row[name] for name in names}
                fields |= {name: parsed(row[name]) for name in ("options", "made_with")}
                fields["drawn"] = {word: row[word] for word in DRAWN if row[word]}
                found.append(EpisodeEntry(**fields))
        except (ValueError, RecursionError) as error:
            reason = "found options that are not JSON"
            if isinstance(error, ValidationError):
                reason = first_wrong_field(error)
            raise InputError(f"{self._catalogue}: row {len(found)}: {reason}") from None
        return tuple(found)

    def _fitting(
        self,
        split: str | None = None,
        scenario: str | None = None,
        behavior: str | None = None,
        mix: str | Mapping[str, float] | None = None,
        flow: str | float | None = None,
    ) -> pa.Table:
        """The rows of the catalogue that fit; arguments are as of `episodes`."""
        for name, value, known in (
            ("split", split, get_args(Split)),
            ("behavior", behavior, self.behaviors),
        ):
            if value is not None and value not in known:
                raise InputError(f"{name}: found {value!r}, expected one of {', '.join(known)}")
        table = self.catalogue
        wanted = {
            "split": split,
            "scenario": scenario,
            "mix": None if mix is None else _mix_words(mix),
            "flow": flow if flow is None or isinstance(flow, str) else words_of(float(flow)),
        }
        fits = [pc.equal(table[name], value) for name, value in wanted.items() if value is not None]
        if behavior in BEHAVIORS:
            fits.append(pc.greater(table[str(behavior)], 0))
        elif behavior is not None:  # one's own is drawn if the mix has it
            fits.append(pc.match_substring(pc.cast(table["mix"], pa.string()), f'"{behavior}": '))
        return table.filter(reduce(pc.and_, fits)) if fits else table

    def scan(self, table: str = "steps", **filters: Any) -> Any:
        """One table of all episodes that fit, to be read in pieces.

        Args:
            table: steps, agents, frames, signals, events, traits or conflicts.
            filters: as of `episodes`; each chooses episodes, not agents.

        Returns:
            A `pyarrow.dataset.Dataset` with the columns of that table, ``scenario`` and ``split``.
        """
        from pyarrow import dataset as arrow_dataset

        if table not in TABLES:
            raise InputError(f"table: found {table!r}, expected one of {', '.join(TABLES)}")
        fitting = self._fitting(**filters)
        keys = ["scenario", "split", "shard"]
        shards = fitting.group_by(keys).aggregate([("index", "min")]).to_pylist()
        files = sorted(
            shard_file(table, one["scenario"], one["split"], one["index_min"]) for one in shards
        )
        schema = table_schema(table, bool(pc.any(fitting.column("exact")).as_py()))
        parts = pa.schema([("scenario", pa.string()), ("split", pa.string())])
        found = arrow_dataset.dataset(
            [self._place.full(file) for file in files],
            schema=pa.schema([*schema, *parts]),
            format="parquet",
            filesystem=self._place.arrow_filesystem,
            partitioning=arrow_dataset.partitioning(parts, flavor="hive"),
            partition_base_dir=self._place.full(table),
        )
        if filters.keys() <= {"split", "scenario"}:
            return found
        ids = pa.array(fitting.column("id").to_pylist(), pa.string())
        return found.filter(pc.field("episode").isin(ids))

    def __repr__(self) -> str:
        """Counts of episodes by split, of scenarios, agents and agent-steps, and the size."""
        splits = Counter(self.catalogue["split"].to_pylist())
        agents, steps = (
            pc.sum(self.catalogue[name]).as_py() or 0 for name in ("agents", "agent_steps")
        )
        by_split = ", ".join(f"{splits[name]} {name}" for name in sorted(splits))
        size = sum(file.size for file in self.header.files.values()) / 1e6
        return (
            f"Dataset({self._place.url:.120}: {counted(len(self), 'episode')}"
            + (f" ({by_split})" if by_split else "")
            + f" of {counted(len(self.scenarios), 'scenario')}, "
            f"{counted(agents, 'agent')}, {counted(steps, 'agent-step')}, {size:.1f} MB)"
        )

    def _repr_html_(self) -> str:
        """A table of the first episodes, for notebooks."""
        columns = ["id", "scenario", "engine", "seed", "split", "frames", "agents", "agent_steps"]
        table = self.catalogue.slice(0, SHOWN_EPISODES).select(columns).to_pandas()
        more = len(self) - SHOWN_EPISODES
        last = f"<p>and {more} more</p>" if more > 0 else ""
        return f"<p>{html.escape(repr(self))}</p>{table.to_html(index=False)}{last}"

    def to_pandas(self) -> Any:
        """A pandas table with a row per episode: the catalogue, as ``sim.store.schema`` says."""
        return self.catalogue.cast(CATALOGUE).to_pandas()

    def read(self, entry: EpisodeEntry) -> Episode:
        """Read an episode, one of `episodes`, comparing the checksums of its pages.

        Raises:
            InputError: if a file is missing, altered, or does not fit the schema; names the file.
        """
        return Episode(entry, *read_tables(self._place, entry))

    def rows(
        self, entry: EpisodeEntry, table: TableName, columns: list[str] | None = None
    ) -> pa.Table:
        """An episode's rows of one table, with some ``columns`` or all; errors are as of `read`."""
        return read_rows(self._place, table, entry, columns)

    def conflicts(self, entry: EpisodeEntry) -> Conflicts:
        """The conflicts of an episode, as `sim.safety.conflicts` finds them in its tracks."""
        return read_conflicts(self._place, entry)

    def road(self, entry: EpisodeEntry) -> Road | None:
        """The road an episode happened on; None where it is not known."""
        if entry.road is None:
            return None
        kept = f"roads/{entry.road}"
        name = next((name for name in self.header.files if name.startswith(kept)), kept)
        path = self.path / name
        if self._place.size(name) is None:
            raise InputError(f"{path}: found no file, expected the road of {entry.id}")
        data = self._place.read(name)
        if hashlib.sha256(data).hexdigest() != entry.road:
            raise InputError(f"{path}: found another checksum than its name, expected its own")
        if not self._place.remote:
            return read_road_file(path, entry.scenario)
        with temporary_folder("road") as scratch:
            copy = scratch / path.name
            copy.write_bytes(data)
            return read_road_file(copy, entry.scenario)


def is_dataset(path: str | Path) -> bool:
    """Whether a folder or URL is that of a complete dataset."""
    return place_of(path).size(EPISODES) is not None


def _mix_words(mix: str | Mapping[str, float]) -> str | None:
    """A mix as the catalogue has it."""
    if isinstance(mix, str):
        parts = [part.partition("=") for part in mix.split(",")]
        try:
            mix = {name.strip(): float(share) for name, _, share in parts}
        except ValueError:
            raise InputError(f"mix: found {mix!r}, expected behavior=share,...") from None
    styles = {str(style): [b for b in BEHAVIORS if b.style is style] for style in Style}
    shares: dict[str, Any] = {}
    for name, share in mix.items():
        members = styles.get(str(name), [str(name)])
        shares |= {str(member): float(share) / len(members) for member in members}
    return words_of(shares)


def open_dataset(path: str | Path) -> Dataset:
    """Open a dataset by its catalogue alone; rows and episodes are read when asked for.

    Args:
        path: the folder that holds ``episodes.parquet``, or its URL: ``s3://bucket/data``,
            ``gs://``, ``file://``, ``memory://``.

    Raises:
        InputError: if the catalogue is missing, broken or of another version.
    """
    place = place_of(path)
    try:
        stamp = place.stamp(EPISODES)
    except OSError:
        return Dataset(path)  # which says what is missing
    return _opened(place.url, stamp)


@lru_cache(maxsize=4)
def _opened(url: str, stamp: str) -> Dataset:
    """A dataset, opened once in a process while its catalogue stays the same."""
    return Dataset(url)
