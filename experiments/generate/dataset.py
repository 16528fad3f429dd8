"""Makes datasets: many episodes, by many workers, each shard written as a whole or not at all.

Every episode has its own seed, derived from the configuration's seed, the scenario's name and the
episode's index. An episode's content does not depend on the number of workers, the order or the
number of episodes. Running the same command again makes the shards that are missing; the catalogue
is written last.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain, groupby, product
from pathlib import Path
from typing import Any, Final, NamedTuple

from behaviors.errors import InputError
from experiments.console.notices import Interrupted
from experiments.console.progress import Progress
from experiments.data.data_card import CARD_HEAD, DATA_CARD, write_data_card
from experiments.data.parallel import checked_jobs
from experiments.generate import RANDOM_WORLD
from experiments.generate.configuration import GenerateConfig, scenario_name
from experiments.generate.episode import Task
from experiments.generate.workers import in_workers
from scenarios.own.scenario_file import is_path
from sim.files import PARTIAL_PREFIX, Place, place_of, user_cache
from sim.store.dataset import is_dataset, open_dataset
from sim.store.reading import metadata_of, opened
from sim.store.schema import (
    EPISODES,
    TABLES,
    EpisodeEntry,
    FileEntry,
    Manifest,
    Shard,
    TableName,
    block_of,
    shard_file,
    split_of,
)
from sim.store.writing import EpisodeWriter, checksum, made_with, write_catalogue

_OURS: Final = frozenset({EPISODES, DATA_CARD, "roads"})
"""Other content of a dataset's folder beside its tables."""

_UNFINISHED: Final = "unfinished episodes of another configuration"


class _ShardTask(NamedTuple):
    """One shard to make, by one worker: episodes of one of the configuration's scenarios."""

    config: GenerateConfig
    scenario: str
    indices: tuple[int, ...]

    def file(self, table: TableName) -> str:
        """The file of a table."""
        index = self.indices[0]
        return shard_file(table, scenario_name(self.scenario), split_of(index), index)

    def __str__(self) -> str:
        """Name of the episodes, for messages."""
        return f"{scenario_name(self.scenario)} episodes {', '.join(map(str, self.indices))}"


class _Made(NamedTuple):
    """A shard that is there: its episodes, its tables, and what could not be made, in words."""

    entries: tuple[EpisodeEntry, ...] = ()
    files: Mapping[str, FileEntry] = {}
    failed: tuple[str, ...] = ()


def _planned(config: GenerateConfig) -> Iterator[_ShardTask]:
    """The shards of a dataset, block by block."""
    for _, block in groupby(range(config.episodes), block_of):
        of_split: dict[str, list[int]] = {}
        for index in block:
            of_split.setdefault(split_of(index), []).append(index)
        for scenario, indices in product(config.scenarios, of_split.values()):
            yield _ShardTask(config, scenario, tuple(indices))


def _make_shard(out: str, configuration: Mapping[str, Any], task: _ShardTask) -> _Made:
    """Make a shard; episodes that cannot be made are left out of it, and named."""
    failed = []
    with EpisodeWriter(place_of(out), configuration) as writer:
        for index in task.indices:
            episode = Task(task.config, task.scenario, index)
            try:
                episode.write(writer)
            except InputError as error:
                failed.append(f"{episode}: {error}")
    return _Made(tuple(writer.entries), writer.files, tuple(failed))


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
    config: GenerateConfig, out: Path, jobs: int | None = None, quiet: bool = False,
    cluster: str | None = None,
) -> Manifest:  # fmt: skip
    """Make a dataset, or what is missing of it.

    Args:
        config: what to make.
        out: where; a new folder, or one that the same configuration was writing to; or a URL.
        jobs: worker processes; None for one per processor.
        quiet: whether to show no progress.
        cluster: address of a Dask scheduler whose workers take the place of processes.

    Returns:
        Header of its catalogue.

    Raises:
        InputError: if an option is wrong, the folder holds something else or is being written to,
            or an episode could not be made (all others are made first).
    """
    jobs = checked_jobs(jobs)
    config.check()
    place = place_of(out)
    if not place.remote and place.path.is_file():
        raise InputError(f"{out}: found a file, expected a folder")
    configuration = _configuration_of(config)
    wanted = config.episodes * len(config.scenarios)
    with sole_writer(place), Progress("generating episodes", wanted, quiet) as shown:
        there, missing = _there_and_missing(config, place, configuration)
        shards: list[_Made] = []
        make = partial(_make_shard, place.url, configuration)
        made = in_workers(make, missing, min(jobs, max(len(missing), 1)), cluster)
        try:
            for task, shard in chain(((None, one) for one in there), made):
                shards.append(shard or _Made(failed=(f"{task}: killed their worker twice",)))
                for entry in shards[-1].entries:
                    shown.advance(entry.agents, entry.agent_steps)
        except KeyboardInterrupt:
            _remove_partial(place)
            count = sum(len(made.entries) for made in shards)
            raise Interrupted(
                f"stopped: {count} of {wanted} episodes are in {place.url}; run the same "
                "command again to go on"
            ) from None
        entries = [entry for made in shards for entry in made.entries]
        asked = {**configuration, "episodes": config.episodes}
        complete = is_dataset(out) and open_dataset(out).header.configuration == asked
        if entries and (missing or not complete):
            files = {name: file for made in shards for name, file in made.files.items()}
            write_catalogue(place, asked, entries, files)
            write_data_card(out)
        elif not entries and not place.remote:
            for name in (*TABLES, "roads"):
                shutil.rmtree(place.path / name, ignore_errors=True)
        failed = [line for made in shards for line in made.failed]
        if failed:
            raise InputError(
                f"{wanted - len(entries)} of {wanted} episodes could not be made: "
                f"{'; '.join(failed)}"
            )
    return open_dataset(out).manifest


def _there_and_missing(
    config: GenerateConfig, place: Place, configuration: Mapping[str, Any]
) -> tuple[list[_Made], list[_ShardTask]]:
    """The shards that are there, and those that are to be made."""
    if is_dataset(place.path):
        _check_same(config, place, configuration)
    _remove_partial(place)
    listed = place.files()
    if DATA_CARD in listed and not place.read(DATA_CARD).decode().startswith(CARD_HEAD):
        raise InputError(f"{place.url}: found {DATA_CARD} in it, expected a new folder")
    tasks = list(_planned(config))
    ours = {task.file(table) for task in tasks for table in TABLES}
    for name in listed:
        top = name.partition("/")[0]
        if top not in _OURS and name not in ours:
            what = _UNFINISHED if top in TABLES else name
            raise InputError(f"{place.url}: found {what} in it, expected a new folder")
    there, missing = [], []
    for task in tasks:
        shard = _read_shard(place, task.file("agents"), listed)
        if shard is not None and shard.configuration != configuration:
            raise InputError(f"{place.url}: found {_UNFINISHED} in it, expected a new folder")
        if shard is None or tuple(entry.index for entry in shard.entries) != task.indices:
            missing.append(task)
        else:
            there.append(_Made(shard.entries, shard.files))
    return there, missing


def _check_same(config: GenerateConfig, place: Place, configuration: Mapping[str, Any]) -> None:
    """Refuse to mix two different datasets in one folder."""
    there = dict(open_dataset(place.path).header.configuration)
    old = there.pop("episodes", 0)
    for name in sorted({*there, *configuration}):
        if there.get(name) != configuration.get(name):
            before, now = (
                value.get("name") if name == "population" and isinstance(value, Mapping) else value
                for value in (each.get(name, "not given") for each in (there, configuration))
            )
            raise InputError(
                f"{place.url}: was made with {name} {before!r}, now {now!r}; choose another folder"
            )
    if not isinstance(old, int) or old > config.episodes:
        raise InputError(
            f"{place.url}: holds {old} episodes per scenario, found {config.episodes} "
            "asked for, expected at least as many; choose another folder"
        )


@contextmanager
def sole_writer(place: Place) -> Iterator[None]:
    """Hold a dataset for writing; the lock ends with the process.

    The folder is created, and removed again if it stays empty. The lock of a URL lies in the user's
    cache: there it holds off this user's runs only.
    """
    from filelock import FileLock, Timeout

    folder = user_cache() / "locks" if place.remote else place.path
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    lock = folder / (checksum(place.url.encode()) if place.remote else ".lock")
    try:
        with FileLock(lock, timeout=0):
            try:
                yield
            finally:
                lock.unlink(missing_ok=True)
    except Timeout:
        raise InputError(
            f"{place.url}: another run is writing to it; wait for its end or choose another folder"
        ) from None
    finally:
        for path in new:
            with suppress(OSError):  # it is not empty
                path.rmdir()


def _read_shard(place: Place, own: str, listed: Mapping[str, int]) -> Shard | None:
    """A shard of an earlier run, by its file of agents; None if a file is missing or broken."""
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


def _remove_partial(place: Place) -> None:
    """Remove what earlier, killed runs left unfinished."""
    if place.remote:
        return
    for folder in (place.path, place.path / "roads"):
        for leftover in folder.glob(f"{PARTIAL_PREFIX}*"):
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)
