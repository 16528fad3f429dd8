"""A dataset of labelled episodes: opened by its catalogue, read back as arrays.

What the files hold is said in `sim.store.schema`; `sim.store.writing` and `sim.store.sealing` write
them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from behaviors.detector_inputs import ShownTrait
from behaviors.display import counted, html_table, import_pandas
from behaviors.errors import InputError
from sim.frames import Tracks
from sim.road import Road
from sim.road.files import read_road_file
from sim.scenario import AgentSpec
from sim.store.atomic import temporary_folder
from sim.store.catalogue import checksum, is_dataset, read_manifest, road_name, tables_of
from sim.store.decode import read_tables
from sim.store.entries import (
    Catalogue,
    catalogue_table,
    open_catalogue,
    rows_where,
    totals_of,
)
from sim.store.lock import LOCK
from sim.store.places import Folder, is_remote, local_path, place_of
from sim.store.scans import scanned
from sim.store.schema import (
    CATALOGUE,
    EpisodeEntry,
    Header,
    Manifest,
    Split,
)
from sim.store.sealing import with_counts

SHOWN_EPISODES: Final = 10
"""Most episodes that a notebook shows of a dataset."""

_COLUMNS: Final = (
    "id", "scenario", "engine", "seed", "index", "split", "frames", "agents", "agent_steps",
)  # fmt: skip


@dataclass(frozen=True)
class Episode:
    """One episode in memory.

    Attributes:
        entry: what it is and how it was made.
        tracks: every agent that was seen, with labels in ``tracks.behavior``.
        agents: every agent that was drawn, seen or not, in order of id.
        shown_traits: in order of time; their ``agent`` and ``other`` are ids (-1: nobody).
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

    def to_pandas(self) -> Any:
        """Its steps as a pandas table: a row for each agent and time, as `Tracks.to_pandas` has it.

        Raises:
            InputError: if pandas is not installed.
        """
        return self.tracks.to_pandas()


class Dataset:
    """A dataset whose catalogue has been opened; nothing else of it has been read.

    Attributes:
        path: its folder, or its URL as a path.
        header: what concerns it as a whole.
    """

    def __init__(self, path: Path, catalogue: Catalogue | Manifest) -> None:
        """A dataset that has a catalogue, or the manifest of schema version 1."""
        self.path = path
        self._place = place_of(path)
        self._catalogue = catalogue

    @property
    def header(self) -> Header:
        """What concerns the dataset as a whole."""
        return self._catalogue if isinstance(self._catalogue, Header) else self._catalogue.header

    @property
    def manifest(self) -> Manifest:
        """Everything that is known of the dataset, an object for each episode."""
        catalogue = self._catalogue
        return catalogue if isinstance(catalogue, Manifest) else catalogue.manifest

    @cached_property
    def catalogue(self) -> pa.Table:
        """The catalogue as an Arrow table of the columns ``sim.store.schema.CATALOGUE``.

        Raises:
            InputError: if it is broken; of schema version 1, if an episode's agents are.
        """
        if isinstance(self._catalogue, Catalogue):
            return self._catalogue.table
        return catalogue_table(with_counts(self._place, e) for e in self._catalogue.episodes)

    @cached_property
    def totals(self) -> pa.Table:
        """Sums by scenario and split, as `sim.store.entries.Catalogue.totals` has them."""
        if isinstance(self._catalogue, Catalogue):
            return self._catalogue.totals
        return totals_of(self.catalogue)

    def __len__(self) -> int:
        """How many episodes there are."""
        catalogue = self._catalogue
        return len(catalogue.episodes) if isinstance(catalogue, Manifest) else catalogue.count

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

        Raises:
            InputError: if a filter is no behaviour, or no mix.
        """
        if isinstance(self._catalogue, Manifest) and (behavior, mix, flow) == (None, None, None):
            return tuple(
                e
                for e in self._catalogue.episodes
                if split in (None, e.split) and scenario in (None, e.scenario)
            )
        if (split, scenario, behavior, mix, flow) == (None,) * 5:
            return self.manifest.episodes
        return self.entries(rows_where(self.catalogue, split, scenario, behavior, mix, flow))

    def entries(self, rows: pa.Table) -> tuple[EpisodeEntry, ...]:
        """Rows of the `catalogue` as entries, in their order."""
        if isinstance(self._catalogue, Catalogue):
            return self._catalogue.entries(rows)
        by_id = {entry.id: entry for entry in self._catalogue.episodes}
        return tuple(by_id[identity] for identity in rows.column("id").to_pylist())

    def scan(
        self,
        table: str = "steps",
        split: Split | None = None,
        scenario: str | None = None,
        behavior: str | None = None,
        mix: str | Mapping[str, float] | None = None,
        flow: str | float | None = None,
    ) -> Any:
        """One table of all episodes that fit, to be read in pieces.

        Args:
            table: steps, agents, frames, signals, events or traits.
            split: as in `episodes`, like all that follow.
            scenario: as in `episodes`.
            behavior: as in `episodes`: it chooses episodes, not agents.
            mix: as in `episodes`.
            flow: as in `episodes`.

        Returns:
            A `pyarrow.dataset.Dataset` with the columns of that table, and ``episode``,
            ``scenario`` and ``split``. Only the shards that hold a fitting episode are opened.

        Raises:
            InputError: if there is no such table, a filter is wrong, or the dataset is of schema
                version 1 (``graphrqi upgrade`` rewrites it).
        """
        if isinstance(self._catalogue, Manifest):
            raise InputError(
                f"{self.path}: found a dataset of schema version 1, expected shards; "
                "graphrqi upgrade makes them"
            )
        fitting = rows_where(self.catalogue, split, scenario, behavior, mix, flow)
        alone = None if (behavior, mix, flow) == (None,) * 3 else fitting.column("id")
        return scanned(self._place, table, fitting, alone)

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios that have episodes, sorted."""
        if isinstance(self._catalogue, Manifest):
            return tuple(sorted({e.scenario for e in self._catalogue.episodes}))
        return tuple(sorted(set(self.totals.column("scenario").to_pylist())))

    def _counts(self) -> tuple[dict[str, int], int, int]:
        """Episodes by split, agents, and agent-steps."""
        if isinstance(self._catalogue, Manifest):
            entries = self._catalogue.episodes
            splits = Counter(str(e.split) for e in entries)
            return splits, sum(e.agents for e in entries), sum(e.agent_steps for e in entries)
        splits = Counter[str]()
        for row in self.totals.to_pylist():
            splits[row["split"]] += row["episodes"]
        agents, steps = (sum(self.totals.column(n).to_pylist()) for n in ("agents", "agent_steps"))
        return splits, agents, steps

    def __repr__(self) -> str:
        """Counts of episodes by split, of scenarios, agents and agent-steps, and the size."""
        splits, agents, steps = self._counts()
        files = list(self.header.files.values())
        if isinstance(self._catalogue, Manifest):
            files += [file for e in self._catalogue.episodes for file in e.files.values()]
        by_split = ", ".join(f"{splits[name]} {name}" for name in sorted(splits))
        return (
            f"Dataset({self._place.url:.120}: {counted(len(self), 'episode')}"
            + (f" ({by_split})" if by_split else "")
            + f" of {counted(len(self.scenarios), 'scenario')}, "
            f"{counted(agents, 'agent')}, {counted(steps, 'agent-step')}, "
            f"{sum(file.size for file in files) / 1e6:.1f} MB)"
        )

    def _repr_html_(self) -> str:
        """A table of the first episodes, for notebooks."""
        if isinstance(self._catalogue, Manifest):
            first = self._catalogue.episodes[:SHOWN_EPISODES]
        else:
            first = self._catalogue.entries(self.catalogue.slice(0, SHOWN_EPISODES))
        rows: list[tuple[object, ...]] = [
            tuple(getattr(e, name) for name in _COLUMNS) for e in first
        ]
        if len(self) > SHOWN_EPISODES:
            rest = f"and {len(self) - SHOWN_EPISODES} more"
            rows.append((rest, *[""] * (len(_COLUMNS) - 1)))
        return html_table(repr(self), _COLUMNS, rows)

    def to_pandas(self) -> Any:
        """A pandas table with a row per episode: the catalogue.

        Returns:
            A data frame with the columns of ``sim.store.schema.CATALOGUE``, in its order.

        Raises:
            InputError: if pandas is not installed.
        """
        import_pandas()
        table = self.catalogue
        return table.cast(pa.schema([CATALOGUE.field(n) for n in table.column_names])).to_pandas()

    def read(self, entry: EpisodeEntry) -> Episode:
        """Read an episode, comparing checksums.

        Args:
            entry: one of `episodes`.

        Returns:
            Its tracks and agents.

        Raises:
            InputError: if a file is missing, altered, or does not fit the schema; names the file.
        """
        if entry.shard is None and isinstance(self._catalogue, Catalogue):
            return self.load_episode(entry.id)  # as it was before it came into a shard
        return Episode(entry, *read_tables(entry, tables_of(self._place, entry)))

    def load_episode(self, identity: str) -> Episode:
        """Read the episode of an id, as `read` does.

        Args:
            identity: the id of one of `episodes`.

        Raises:
            InputError: if there is no such episode, or it cannot be read.
        """
        return self.read(self.entry(identity))

    def entry(self, identity: str) -> EpisodeEntry:
        """The entry of an id.

        Args:
            identity: the id of one of `episodes`.

        Raises:
            InputError: if there is no such episode.
        """
        if isinstance(self._catalogue, Manifest):
            found = tuple(e for e in self._catalogue.episodes if e.id == identity)
        else:
            mask = pc.equal(self.catalogue.column("id"), identity)
            found = self._catalogue.entries(self.catalogue.filter(mask))
        if not found:
            raise InputError(f"{self.path}: found no episode {identity!r}, expected one of its ids")
        return found[0]

    def road(self, entry: EpisodeEntry) -> Road | None:
        """The road an episode happened on.

        Args:
            entry: one of `episodes`.

        Returns:
            The road; None where it is not known.

        Raises:
            InputError: if the net is missing or altered.
        """
        if entry.road is None:
            return None
        name = road_name(self._place, entry.road)
        path = self.path / name
        try:
            data = self._place.read(name)
        except FileNotFoundError:
            raise InputError(
                f"{path}: found no file, expected the road of episode {entry.id}"
            ) from None
        if checksum(data) != entry.road:
            raise InputError(f"{path}: found another checksum than its name, expected it unaltered")
        if isinstance(self._place, Folder):
            return read_road_file(path, entry.scenario)
        with temporary_folder("road") as scratch:
            copy = scratch / path.name
            copy.write_bytes(data)
            return read_road_file(copy, entry.scenario)


def finished_dataset(path: Path) -> Dataset | None:
    """The dataset at a place; None if there is none, a run is writing there, or it is broken."""
    if not is_dataset(path) or (not is_remote(path) and (local_path(path) / LOCK).exists()):
        return None
    try:
        return open_dataset(path)
    except InputError:
        return None


def open_dataset(path: str | Path) -> Dataset:
    """Open a dataset by its catalogue alone.

    Args:
        path: the folder that holds ``episodes.parquet`` (or ``manifest.json``, of schema version
            1), or its URL: ``s3://bucket/data``, ``gs://``, ``file://``, ``memory://``.

    Returns:
        The dataset; the catalogue's rows and the episodes are read when asked for.

    Raises:
        InputError: if there is no catalogue, or it is broken or of another version.
    """
    place = place_of(path)
    catalogue = open_catalogue(place)
    return Dataset(place.path, read_manifest(place) if catalogue is None else catalogue)
