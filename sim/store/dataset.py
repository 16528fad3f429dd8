"""A dataset of labelled episodes: opened by its manifest, read back as arrays.

What the files hold is said in `sim.store.schema`; `sim.store.writing` writes them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from behaviors.detector_inputs import ShownTrait
from behaviors.display import counted, html_table, import_pandas
from behaviors.errors import InputError
from sim.frames import Tracks
from sim.road import Road
from sim.road.files import read_road_file
from sim.scenario import AgentSpec
from sim.store.catalogue import checked_bytes, checksum, read_manifest, road_path
from sim.store.decode import read_tables
from sim.store.schema import EPISODE_FILES, EpisodeEntry, Manifest, Split

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


@dataclass(frozen=True)
class Dataset:
    """A dataset whose manifest has been read and found valid.

    Attributes:
        path: its folder.
        manifest: what is inside.
    """

    path: Path
    manifest: Manifest

    def episodes(
        self, split: Split | None = None, scenario: str | None = None
    ) -> tuple[EpisodeEntry, ...]:
        """The episodes of a split and a scenario, in the manifest's order.

        Args:
            split: only this part of the data; None for all.
            scenario: only this scenario; None for all.

        Returns:
            Their entries.
        """
        return tuple(
            e
            for e in self.manifest.episodes
            if split in (None, e.split) and scenario in (None, e.scenario)
        )

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios that have episodes, sorted."""
        return tuple(sorted({e.scenario for e in self.manifest.episodes}))

    def __repr__(self) -> str:
        """Counts of episodes by split, of scenarios, agents and agent-steps, and the size."""
        entries = self.manifest.episodes
        splits = Counter(e.split for e in entries)
        size = sum(file.size for e in entries for file in e.files.values())
        by_split = ", ".join(f"{splits[name]} {name}" for name in sorted(splits))
        return (
            f"Dataset({self.path!s:.120}: {counted(len(entries), 'episode')}"
            + (f" ({by_split})" if by_split else "")
            + f" of {counted(len(self.scenarios), 'scenario')}, "
            f"{counted(sum(e.agents for e in entries), 'agent')}, "
            f"{counted(sum(e.agent_steps for e in entries), 'agent-step')}, {size / 1e6:.1f} MB)"
        )

    def _repr_html_(self) -> str:
        """A table of the first episodes, for notebooks."""
        entries = self.manifest.episodes
        rows: list[tuple[object, ...]] = [
            tuple(getattr(e, name) for name in _COLUMNS) for e in entries[:SHOWN_EPISODES]
        ]
        if len(entries) > SHOWN_EPISODES:
            rest = f"and {len(entries) - SHOWN_EPISODES} more"
            rows.append((rest, *[""] * (len(_COLUMNS) - 1)))
        return html_table(repr(self), _COLUMNS, rows)

    def to_pandas(self) -> Any:
        """A pandas table with a row per episode.

        Returns:
            A data frame with the columns id, scenario, engine, seed, index, split, frames, agents,
            agent_steps, road (checksum; missing where unknown) and bytes, in the manifest's order.

        Raises:
            InputError: if pandas is not installed.
        """
        pandas = import_pandas()
        entries = self.manifest.episodes
        table = {name: [getattr(e, name) for e in entries] for name in (*_COLUMNS, "road")}
        table["bytes"] = [sum(file.size for file in e.files.values()) for e in entries]
        return pandas.DataFrame(table)

    def read(self, entry: EpisodeEntry) -> Episode:
        """Read an episode, checking every file against its checksum.

        Args:
            entry: one of `episodes`.

        Returns:
            Its tracks and agents.

        Raises:
            InputError: if a file is missing, altered, or does not fit the schema; names the file.
        """
        home = self.path / "episodes" / entry.id
        tables = {name: checked_bytes(home / name, entry) for name in EPISODE_FILES}
        return Episode(entry, *read_tables(home, entry, tables))

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

        path = road_path(self.path, entry.road)
        if not path.is_file():
            raise InputError(f"{path}: found no file, expected the road of episode {entry.id}")
        if checksum(path.read_bytes()) != entry.road:
            raise InputError(f"{path}: found another checksum than its name, expected it unaltered")
        return read_road_file(path, entry.scenario)


def open_dataset(path: str | Path) -> Dataset:
    """Open a dataset folder.

    Args:
        path: the folder that holds ``manifest.json``.

    Returns:
        The dataset; episodes are read when asked for.

    Raises:
        InputError: if there is no manifest, or it is broken or of another version.
    """
    folder = Path(path)
    return Dataset(folder, read_manifest(folder))
