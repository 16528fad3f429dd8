"""Makes labelled datasets: many episodes, in separate processes, each written whole or not at all.

Every episode has its own seed, derived from the configuration's seed, the scenario's name and the
episode's index. So what an episode holds depends neither on the number of processes nor on the
order nor on how many episodes there are. Running the same command again makes only what is missing.

Finished episodes wait in folders of their own until all of their block are there; then they are put
into shards (`sim.store.sealing`). Several commands can share the work, each making one part
(`experiments.data.array_job.parts`).
"""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError
from experiments.console.exit_codes import Interrupted
from experiments.console.progress import Progress
from experiments.data.cards.croissant import CROISSANT
from experiments.data.cluster import make_on_cluster
from experiments.data.data_card import DATA_CARD, cards_in, edited_cards, write_data_card
from experiments.data.episode import make_episode
from experiments.data.parallel import checked_jobs
from experiments.data.processes import make_in_processes
from experiments.data.shards.plan import (
    AnyConfig,
    AnyTask,
    Share,
    belongs_to,
    configuration_of,
    key_of,
    planned_count,
    shares,
)
from experiments.data.shards.staging import staged
from experiments.data.tasks import T
from experiments.data.worlds.episode import WorldsConfig, make_world
from sim.store.atomic import PARTIAL_PREFIX, remove_partial, remove_temporary
from sim.store.catalogue import is_dataset, road_is_sound, unlisted_episodes
from sim.store.dataset import open_dataset
from sim.store.entries import EPISODES
from sim.store.lock import LOCK, sole_writer
from sim.store.places import Folder, Place, is_remote, place_of
from sim.store.schema import TABLES, EpisodeEntry, EpisodeMeta, FileEntry, Manifest
from sim.store.sealing import Sealer, manifest_of, shards_in, whole_shards
from sim.store.shards import Shard

PLAN: Final = "plan.json"
"""What the parts of a dataset have in common, for `merge`; removed by it."""

_OURS: Final = frozenset({"episodes", "roads", LOCK, PLAN, *TABLES})
"""What an unfinished dataset's folder may hold."""


def check_same(place: Place, folder: Path, config: AnyConfig) -> None:
    """Refuse to mix two different datasets in one folder."""
    if is_dataset(place.path):
        _check_same_manifest(place, config)
        return
    check_unfinished(folder, belongs_to(config), place)


def check_unfinished(
    folder: Path,
    planned: Callable[[EpisodeMeta], bool],
    place: Place | None = None,
) -> None:
    """Refuse a folder without a catalogue that holds anything but episodes of the same plan.

    Args:
        folder: where episodes are made; it need not exist.
        planned: whether an episode that is there belongs to the plan.
        place: the dataset; None if it is the folder.

    Raises:
        InputError: if something else is there.
    """
    place = place or Folder(folder)
    if folder.is_dir():
        # Where only the catalogue is gone there is a card, which is written anew.
        ours = _OURS | cards_in(folder)
        for path in folder.iterdir():
            if path.name not in ours and not path.name.startswith((PARTIAL_PREFIX, LOCK)):
                raise InputError(f"{folder}: found {path.name} in it, expected an empty folder")
    elif not isinstance(place, Folder):
        for name in place.files():
            if name.partition("/")[0] not in (_OURS | {DATA_CARD, CROISSANT}):
                raise InputError(f"{place.url}: found {name} in it, expected an empty folder")
    sealed = (entry for shard in shards_in(place) for entry in shard.read())
    for entry in itertools.chain(unlisted_episodes(folder), sealed):
        if not planned(entry):
            raise InputError(
                f"{place.url}: holds unfinished episodes of another configuration; "
                "choose another folder"
            )


def _check_same_manifest(place: Place, config: AnyConfig) -> None:
    there = open_dataset(place.path).header.configuration
    wanted = configuration_of(config)
    for name in sorted({*there, *wanted}):
        if name in ("episodes", "worlds") and name in wanted:
            old, asked = there.get(name), wanted[name]
            if not isinstance(old, int) or old > asked:
                each = "episodes per scenario" if name == "episodes" else name
                raise InputError(
                    f"{place.url}: holds {old} {each}, found {asked} asked "
                    "for, expected at least as many; choose another folder"
                )
        elif there.get(name) != wanted.get(name):
            raise InputError(
                f"{place.url}: was made with {name} {_shown(there, name)}, now "
                f"{_shown(wanted, name)}; "
                "choose another folder"
            )


def _shown(configuration: Mapping[str, Any], name: str) -> str:
    """What a configuration gives; of a population, its name."""
    value = configuration.get(name, "not given")
    if name == "population" and isinstance(value, Mapping):
        value = value.get("name")
    return repr(value)


@contextmanager
def stoppable(folder: Path, wanted: int, out: Path | None = None) -> Iterator[None]:
    """Turn Ctrl-C into one line that says how to go on.

    Args:
        folder: where episodes are made.
        wanted: how many.
        out: the dataset; None if it is the folder.
    """
    try:
        yield
    except KeyboardInterrupt:
        remove_temporary()  # of workers that were ended in the middle of an episode
        remove_partial(folder)
        remove_partial(folder / "episodes")
        place = place_of(out or folder)
        there = sum(1 for _ in (folder / "episodes").glob("*/episode.json"))
        there += sum(shard.count for shard in shards_in(place))
        raise Interrupted(
            f"stopped: {there} of {wanted} episodes are in {place.url}; "
            "run the same command again to go on"
        ) from None


def _made(
    make: Callable[[Path, T], EpisodeEntry],
    folder: Path,
    tasks: Sequence[T],
    jobs: int,
    cluster: str | None,
    shown: Progress,
) -> tuple[list[EpisodeEntry], list[str]]:
    if not tasks:
        return [], []
    if cluster is None:
        return make_in_processes(make, folder, tasks, jobs, shown)
    return make_on_cluster(make, folder, tasks, cluster, shown)


@dataclass
class Generation:
    """One run that makes episodes and puts them into shards.

    Attributes:
        config: what to make.
        out: the dataset.
        folder: where episodes are made.
        jobs: worker processes.
        cluster: address of a Dask scheduler; None for processes of this machine.
        quiet: whether to show no progress.
        failed: what could not be made, in words.
        waiting: finished episodes that wait in an object store.
        sound: whether the roads that were looked at are unaltered, by checksum.
    """

    config: AnyConfig
    out: Path
    folder: Path
    jobs: int
    cluster: str | None = None
    quiet: bool = True
    failed: list[str] = field(default_factory=list)
    waiting: dict[tuple[str, int], EpisodeEntry] = field(default_factory=dict)
    sound: dict[str, bool] = field(default_factory=dict)

    @property
    def worlds(self) -> bool:
        """Whether the episodes are random worlds."""
        return isinstance(self.config, WorldsConfig)

    @property
    def sealer(self) -> Sealer:
        """What puts episodes into shards."""
        return Sealer(place_of(self.out), self.folder)

    def known(self, shards: Iterable[Shard]) -> dict[tuple[str, int], EpisodeEntry]:
        """The planned episodes that are in whole shards, but one of each damaged road's."""
        place, found = place_of(self.out), {}
        belongs = belongs_to(self.config)
        for entry in (entry for shard in shards for entry in shard.read() if belongs(entry)):
            if entry.road is not None and entry.road not in self.sound:
                self.sound[entry.road] = road_is_sound(place, entry.road)
                if not self.sound[entry.road]:
                    continue  # made again, with its road
            found[key_of(entry, self.worlds)] = entry
        return found

    def run(self, todo: Iterable[Share], wanted: int, shards: Sequence[Shard]) -> list[Shard]:
        """Make what is missing of some blocks, and seal those that are made as a whole.

        Args:
            todo: what to make. Only the episodes of one block are in memory at a time.
            wanted: how many episodes that is.
            shards: those that are there, whole.

        Returns:
            The shards of the blocks that were made as a whole.
        """
        sealed = list[Shard]()
        with Progress("generating episodes", wanted, self.quiet) as shown:
            for share in todo:
                of_block = [shard for shard in shards if shard.block == share.block]
                known = self.known(of_block)
                keys = {key_of(task, self.worlds) for task in share.tasks}
                there = [entry for key, entry in known.items() if key in keys]
                for entry in there:
                    shown.advance(entry.agents, entry.agent_steps)
                done = known if share.whole else {**self.waiting, **known}
                missing = [t for t in share.tasks if key_of(t, self.worlds) not in done]
                made = self._make(missing, shown)
                if share.whole:
                    sealed += self.sealer.seal([*there, *made], of_block)
                    self.sealer.remove_waiting([entry.id for entry in made])
        return sealed

    def failure(self, wanted: int) -> InputError:
        """What could not be made, as an error."""
        return InputError(
            f"{len(self.failed)} of {wanted} episodes could not be made: {'; '.join(self.failed)}"
        )

    def _make(self, tasks: Sequence[AnyTask], shown: Progress) -> list[EpisodeEntry]:
        make = make_world if self.worlds else make_episode
        made, failed = _made(make, self.folder, tasks, self.jobs, self.cluster, shown)  # type: ignore[arg-type,type-var]
        self.failed += failed
        return made


def generate(
    config: AnyConfig,
    out: Path,
    jobs: int | None = None,
    quiet: bool = False,
    cluster: str | None = None,
    whole_or_not: bool = False,
) -> Manifest:
    """Make a dataset, or what is missing of it.

    Args:
        config: what to make.
        out: where; a new folder, or one that the same configuration was writing to; or a URL.
        jobs: worker processes; None for one per processor.
        quiet: whether to show no progress.
        cluster: address of a Dask scheduler whose workers make the episodes; None for processes
            of this machine.
        whole_or_not: whether to leave the dataset as it is if an episode cannot be made.

    Returns:
        What its catalogue says.

    Raises:
        InputError: if an option is wrong, the folder holds something else or is being written to,
            or an episode could not be made (all others are made first).
        OSError: if something cannot be written.
        Interrupted: if the user stopped it.
    """
    generate_shards(config, out, jobs, quiet, cluster, whole_or_not)
    return manifest_of(place_of(out))


def generate_shards(
    config: AnyConfig,
    out: Path,
    jobs: int | None = None,
    quiet: bool = False,
    cluster: str | None = None,
    whole_or_not: bool = False,
) -> None:
    """As `generate`, for any number of episodes: those of one block are in memory at a time."""
    jobs = checked_jobs(jobs)
    config.check()
    if cluster is not None and is_remote(out):
        raise InputError(
            f"out: found {place_of(out).url} beside --cluster, expected a folder on a disk that "
            "every worker sees; --part makes parts of it anywhere"
        )
    wanted = planned_count(config)
    with staged(out) as folder, sole_writer(folder), stoppable(folder, wanted, out):
        place = place_of(out)
        check_same(place, folder, config)
        edited = edited_cards(out)
        clear_partial(folder)
        run = Generation(config, out, folder, jobs, cluster, quiet)
        there = whole_shards(place, listed_files(place))
        sealed = run.run(shares(config, None), wanted, there)
        if run.failed and not sealed and not is_dataset(place.path):
            remove_unused(folder)
            raise run.failure(wanted)
        if run.failed and whole_or_not:
            raise run.failure(wanted)
        complete(run, sealed)
        write_data_card(out, edited)
        remove_temporary()
    if run.failed:
        raise run.failure(wanted)


def complete(run: Generation, sealed: Sequence[Shard], sealer: Sealer | None = None) -> None:
    """Write the catalogue of a dataset whose blocks are all sealed."""
    (sealer or run.sealer).complete(configuration_of(run.config), sealed)
    run.sealer.place.remove(PLAN)


def remove_unused(folder: Path) -> None:
    """Remove what was kept for episodes of which none could be made."""
    for name in ("episodes", "roads"):
        shutil.rmtree(folder / name, ignore_errors=True)


def clear_partial(folder: Path) -> None:
    """Remove what earlier, killed runs left unfinished."""
    remove_temporary()
    for home in (folder, folder / "episodes", folder / "roads"):
        remove_partial(home)


def listed_files(place: Place) -> dict[str, FileEntry] | None:
    """Checksums of a dataset's shards by its catalogue; None where there is no catalogue."""
    if place.size(EPISODES) is None:
        return None
    return open_dataset(place.path).header.files
