"""Makes datasets: many episodes, by many workers, each shard written as a whole or not at all.

Every episode has its own seed, derived from the configuration's seed, the scenario's name and the
episode's index. An episode's content does not depend on the number of workers, the order or the
number of episodes. Running the same command again makes the shards that are missing; the catalogue
is written last.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from behaviors.errors import InputError
from experiments.console.exit_codes import Interrupted
from experiments.console.progress import Progress
from experiments.data.data_card import CARD_HEAD, DATA_CARD, write_data_card
from experiments.data.parallel import checked_jobs
from experiments.generate import RANDOM_WORLD
from experiments.generate.configuration import GenerateConfig, scenario_name
from experiments.generate.episode import Task
from experiments.generate.lock import sole_writer
from experiments.generate.workers import in_workers
from scenarios.own.scenario_file import is_path
from sim.files import PARTIAL_PREFIX, Place, place_of
from sim.store.catalogue import EPISODES, catalogue_table, is_dataset, write_catalogue
from sim.store.dataset import open_dataset
from sim.store.schema import TABLES, EpisodeEntry, FileEntry, Manifest, block_of, split_of
from sim.store.shards import Shard, ShardName, metadata_of, opened
from sim.store.writing import EpisodeWriter, checksum, made_with

_OURS: Final = frozenset({EPISODES, DATA_CARD, "roads"})
"""Other content of a dataset's folder beside its tables."""


@dataclass(frozen=True, slots=True)
class ShardTask:
    """One shard to make, by one worker.

    Attributes:
        config: what the dataset is generated from.
        scenario: which of its scenarios.
        indices: of the shard's episodes.
    """

    config: GenerateConfig
    scenario: str
    indices: tuple[int, ...]

    @property
    def name(self) -> ShardName:
        """Name of the shard."""
        first, last = block_of(self.indices[0])
        split = split_of(self.indices[0])
        return ShardName(scenario_name(self.scenario), split, f"{first:06}-{last:06}")

    def __str__(self) -> str:
        """Name of the episodes, for messages."""
        return f"{self.name.scenario} episodes {', '.join(map(str, self.indices))}"


@dataclass(frozen=True, slots=True)
class Made:
    """A shard that is there.

    Attributes:
        entries: its episodes.
        files: size and checksum of its tables.
        failed: what could not be made, in words.
    """

    entries: tuple[EpisodeEntry, ...]
    files: dict[str, FileEntry]
    failed: tuple[str, ...] = ()


def planned(config: GenerateConfig) -> Iterator[ShardTask]:
    """The shards of a dataset, block by block."""
    first = 0
    while first < config.episodes:
        last = min(block_of(first)[1], config.episodes - 1)
        for scenario in config.scenarios:
            of_split: dict[str, list[int]] = {}
            for index in range(first, last + 1):
                of_split.setdefault(split_of(index), []).append(index)
            for indices in of_split.values():
                yield ShardTask(config, scenario, tuple(indices))
        first = last + 1


def _make_shard(out: str, configuration: Mapping[str, Any], task: ShardTask) -> Made:
    """Make a shard; episodes that cannot be made are left out of it, and named."""
    failed = []
    with EpisodeWriter(place_of(out), configuration) as writer:
        for index in task.indices:
            episode = Task(task.config, task.scenario, index)
            try:
                episode.write(writer)
            except InputError as error:
                failed.append(f"{episode}: {error}")
    return Made(tuple(writer.entries), writer.files, tuple(failed))


def _configuration_of(config: GenerateConfig) -> dict[str, Any]:
    """Configuration as the dataset stores it, without the number of episodes."""
    engines = ("sumo", "highway") if RANDOM_WORLD in config.scenarios else (config.engine,)
    dumped = config.model_dump(mode="json", exclude_none=True, exclude={"episodes"})
    own = {
        name: checksum(config.scenario(name).road.source.read_bytes())
        for name in config.scenarios
        if name != RANDOM_WORLD and is_path(name)
    }
    return {**dumped, **({"own_roads": own} if own else {}), "made_with": made_with(*engines)}


def generate(
    config: GenerateConfig,
    out: Path,
    jobs: int | None = None,
    quiet: bool = False,
    cluster: str | None = None,
) -> Manifest:
    """Make a dataset, or what is missing of it.

    Args:
        config: what to make.
        out: where; a new folder, or one that the same configuration was writing to; or a URL.
        jobs: worker processes; None for one per processor.
        quiet: whether to show no progress.
        cluster: address of a Dask scheduler whose workers make the episodes; None for processes
            of this machine.

    Returns:
        Header of its catalogue.

    Raises:
        InputError: if an option is wrong, the folder holds something else or is being written to,
            or an episode could not be made (all others are made first).
        OSError: if something cannot be written.
        Interrupted: if the user stopped it.
    """
    jobs = checked_jobs(jobs)
    config.check()
    place = place_of(out)
    configuration = _configuration_of(config)
    wanted = config.episodes * len(config.scenarios)
    with sole_writer(place), Progress("generating episodes", wanted, quiet) as shown:
        run = _Run(place, configuration, wanted, shown)
        missing = run.look(config)
        with run.stoppable():
            make = partial(_make_shard, place.url, configuration)
            for task, made in in_workers(make, missing, min(jobs, max(len(missing), 1)), cluster):
                run.add(made or Made((), {}, (f"{task}: killed their worker twice",)))
        run.finish({**configuration, "episodes": config.episodes}, out, bool(missing))
    return open_dataset(out).manifest


class _Run:
    """One run of `generate`: what there is of its dataset."""

    def __init__(
        self, place: Place, configuration: Mapping[str, Any], wanted: int, shown: Progress
    ) -> None:
        self._place, self._configuration, self._wanted = place, configuration, wanted
        self._shown = shown
        self._rows: list[pa.Table] = []
        self._files: dict[str, FileEntry] = {}
        self._failed: list[str] = []
        self._there = 0

    def look(self, config: GenerateConfig) -> list[ShardTask]:
        """The shards that are missing."""
        if is_dataset(self._place.path):
            self._check_same(config)
        _remove_partial(self._place)
        listed = self._place.files()
        if DATA_CARD in listed and not self._place.read(DATA_CARD).decode().startswith(CARD_HEAD):
            raise InputError(f"{self._place.url}: found {DATA_CARD} in it, expected a new folder")
        tasks = list(planned(config))
        ours = {task.name.file(table) for task in tasks for table in TABLES}
        for name in listed:
            top = name.partition("/")[0]
            if top not in _OURS and name not in ours:
                what = "unfinished episodes of another configuration" if top in TABLES else name
                raise InputError(f"{self._place.url}: found {what} in it, expected a new folder")
        missing = []
        for task in tasks:
            shard = _read_shard(self._place, task.name, listed)
            if shard is not None and shard.configuration != self._configuration:
                raise InputError(
                    f"{self._place.url}: found unfinished episodes of another configuration in "
                    "it, expected a new folder"
                )
            if shard is None or tuple(entry.index for entry in shard.entries) != task.indices:
                missing.append(task)
            else:
                self.add(Made(shard.entries, shard.files))
        return missing

    def add(self, made: Made) -> None:
        """Take a shard into the catalogue."""
        for entry in made.entries:
            self._shown.advance(entry.agents, entry.agent_steps)
        self._rows.append(catalogue_table(made.entries))
        self._files |= made.files
        self._failed += made.failed
        self._there += len(made.entries)

    def finish(self, configuration: Mapping[str, Any], out: Path, new: bool) -> None:
        """Write the catalogue, if there is something new."""
        complete = is_dataset(out) and open_dataset(out).header.configuration == configuration
        if self._there and (new or not complete):
            write_catalogue(self._place, configuration, self._rows, self._files)
            write_data_card(out)
        if not self._there and not self._place.remote:
            for name in (*TABLES, "roads"):
                shutil.rmtree(self._place.path / name, ignore_errors=True)
        if self._failed:
            raise InputError(
                f"{self._wanted - self._there} of {self._wanted} episodes could not be made: "
                f"{'; '.join(self._failed)}"
            )

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """Turn Ctrl-C into one line that says how to go on."""
        try:
            yield
        except KeyboardInterrupt:
            _remove_partial(self._place)
            raise Interrupted(
                f"stopped: {self._there} of {self._wanted} episodes are in {self._place.url}; "
                "run the same command again to go on"
            ) from None

    def _check_same(self, config: GenerateConfig) -> None:
        """Refuse to mix two different datasets in one folder."""
        there = dict(open_dataset(self._place.path).header.configuration)
        old = there.pop("episodes", 0)
        for name in sorted({*there, *self._configuration}):
            if there.get(name) != self._configuration.get(name):
                raise InputError(
                    f"{self._place.url}: was made with {name} {_shown(there, name)}, now "
                    f"{_shown(self._configuration, name)}; choose another folder"
                )
        if not isinstance(old, int) or old > config.episodes:
            raise InputError(
                f"{self._place.url}: holds {old} episodes per scenario, found {config.episodes} "
                "asked for, expected at least as many; choose another folder"
            )


def _read_shard(place: Place, name: ShardName, listed: Mapping[str, int]) -> Shard | None:
    """A shard of an earlier run; None if a file of it is missing, broken, or of another size."""
    own = name.file("agents")
    if own not in listed:
        return None
    try:
        with opened(place, own) as parquet:
            shard = metadata_of(place.path / own, parquet.metadata, Shard)
            rows = parquet.metadata.num_rows
        agents = FileEntry(sha256=place.checksum(own), size=listed[own], rows=rows)
    except (InputError, FileNotFoundError):
        return None
    if any(listed.get(file) != entry.size for file, entry in shard.files.items()):
        return None
    return shard.model_copy(update={"files": {**shard.files, own: agents}})


def _shown(configuration: Mapping[str, Any], name: str) -> str:
    """Value of a configuration; of a population, its name."""
    value = configuration.get(name, "not given")
    if name == "population" and isinstance(value, Mapping):
        value = value.get("name")
    return repr(value)


def _remove_partial(place: Place) -> None:
    """Remove what earlier, killed runs left unfinished."""
    if not place.remote:
        for folder in (place.path, place.path / "roads"):
            for leftover in folder.glob(f"{PARTIAL_PREFIX}*"):
                if leftover.is_dir():
                    shutil.rmtree(leftover, ignore_errors=True)
                else:
                    leftover.unlink(missing_ok=True)
