"""Makes labelled datasets: many episodes, in separate processes, each written whole or not at all.

Every episode has its own seed, derived from the configuration's seed, the scenario's name and the
episode's index. So what an episode holds depends neither on the number of processes nor on the
order nor on how many episodes there are. Running the same command again makes only what is missing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeAlias

from behaviors.errors import InputError
from experiments.console.exit_codes import Interrupted
from experiments.console.progress import Progress
from experiments.data.cluster import make_on_cluster
from experiments.data.configuration import GenerateConfig
from experiments.data.data_card import DATA_CARD, card_was_edited, is_data_card, write_data_card
from experiments.data.episode import Task, make_episode
from experiments.data.processes import make_in_processes
from experiments.data.tasks import T
from experiments.data.worlds.episode import WorldsConfig, WorldTask, make_world
from scenarios import get_scenario
from sim.store.atomic import PARTIAL_PREFIX, remove_partial
from sim.store.catalogue import MANIFEST, unlisted_episodes, write_manifest
from sim.store.dataset import open_dataset
from sim.store.lock import LOCK, sole_writer
from sim.store.schema import EpisodeEntry, EpisodeMeta, Manifest
from sim.store.writing import made_with

AnyConfig: TypeAlias = GenerateConfig | WorldsConfig

_OURS: Final = frozenset({"episodes", "roads", LOCK})
"""What an unfinished dataset's folder may hold."""


def _check_same(folder: Path, config: AnyConfig) -> None:
    """Refuse to mix two different datasets in one folder."""
    if (folder / MANIFEST).exists():
        _check_same_manifest(folder, config)
        return
    check_unfinished(folder, lambda made: made == _wanted(config, made))


def check_unfinished(folder: Path, planned: Callable[[EpisodeMeta], bool]) -> None:
    """Refuse a folder without a manifest that holds anything but episodes of the same plan.

    Args:
        folder: of the dataset; it need not exist.
        planned: whether an episode that is there belongs to the plan.

    Raises:
        InputError: if something else is in the folder.
    """
    if not folder.is_dir():
        return
    # Where only the manifest is gone there is a card, which is written anew.
    ours = _OURS | {DATA_CARD} if is_data_card(folder / DATA_CARD) else _OURS
    for path in folder.iterdir():
        if path.name not in ours and not path.name.startswith(PARTIAL_PREFIX):
            raise InputError(f"{folder}: found {path.name} in it, expected an empty folder")
    for entry in unlisted_episodes(folder):
        if not planned(EpisodeMeta(**entry.model_dump(include=set(EpisodeMeta.model_fields)))):
            raise InputError(
                f"{folder}: holds unfinished episodes of another configuration; "
                "choose another folder"
            )


def _wanted(config: AnyConfig, entry: EpisodeMeta) -> EpisodeMeta | None:
    """What the configuration's episode of that scenario and index is made from; None if none."""
    if isinstance(config, WorldsConfig):
        return WorldTask(config, entry.index).meta() if entry.index < config.worlds else None
    by_name = {get_scenario(given).name: given for given in config.scenarios}
    if entry.scenario not in by_name or entry.index >= config.episodes:
        return None
    given = by_name[entry.scenario]
    return Task(config, given, entry.index).meta(config.scenario(given, entry.index))


def _check_same_manifest(folder: Path, config: AnyConfig) -> None:
    there = open_dataset(folder).manifest.configuration
    wanted = _configuration(config)
    for name in sorted({*there, *wanted}):
        if name in ("episodes", "worlds") and name in wanted:
            old, asked = there.get(name), wanted[name]
            if not isinstance(old, int) or old > asked:
                each = "episodes per scenario" if name == "episodes" else name
                raise InputError(
                    f"{folder}: holds {old} {each}, found {asked} asked "
                    "for, expected at least as many; choose another folder"
                )
        elif there.get(name) != wanted.get(name):
            raise InputError(
                f"{folder}: was made with {name} {there.get(name, 'not given')!r}, now "
                f"{wanted.get(name, 'not given')!r}; "
                "choose another folder"
            )


def _configuration(config: AnyConfig) -> dict[str, Any]:
    dumped = config.model_dump(mode="json", exclude_none=True)
    return {**dumped, "made_with": dict(made_with(config.engine))}


@contextmanager
def stoppable(folder: Path, wanted: int) -> Iterator[None]:
    """Turn Ctrl-C into one line that says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        remove_partial(folder / "episodes")
        there = sum(1 for _ in (folder / "episodes").glob("*/episode.json"))
        raise Interrupted(
            f"stopped: {there} of {wanted} episodes are in {folder}; "
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
    if cluster is None:
        return make_in_processes(make, folder, tasks, jobs, shown)
    return make_on_cluster(make, folder, tasks, cluster, shown)


def generate(
    config: AnyConfig,
    folder: Path,
    jobs: int | None = None,
    quiet: bool = False,
    cluster: str | None = None,
) -> Manifest:
    """Make a dataset, or what is missing of it.

    Args:
        config: what to make.
        folder: where; a new folder, or one that the same configuration was writing to.
        jobs: worker processes; None for one per processor.
        quiet: whether to show no progress.
        cluster: address of a Dask scheduler whose workers make the episodes; None for processes
            of this machine.

    Returns:
        The manifest.

    Raises:
        InputError: if an option is wrong, the folder holds something else or is being written to,
            or an episode could not be made (all others are made first).
        OSError: if something cannot be written.
        Interrupted: if the user stopped it.
    """
    if jobs is None:
        jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    if jobs < 1:
        raise InputError(f"jobs: found {jobs}, expected at least 1")
    config.check()
    wanted = (
        config.worlds
        if isinstance(config, WorldsConfig)
        else config.episodes * len(config.scenarios)
    )
    with sole_writer(folder), stoppable(folder, wanted):
        _check_same(folder, config)
        edited = card_was_edited(folder)
        remove_partial(folder)
        remove_partial(folder / "episodes")
        remove_partial(folder / "roads")
        with Progress("generating episodes", wanted, quiet) as shown:
            if isinstance(config, WorldsConfig):
                worlds = [WorldTask(config, i) for i in range(config.worlds)]
                made, failed = _made(make_world, folder, worlds, jobs, cluster, shown)
            else:
                tasks = [
                    Task(config, name, i)
                    for i in range(config.episodes)
                    for name in config.scenarios
                ]
                made, failed = _made(make_episode, folder, tasks, jobs, cluster, shown)
        manifest = write_manifest(folder, _configuration(config), made)
        write_data_card(folder, edited)
    if failed:
        raise InputError(
            f"{len(failed)} of {wanted} episodes could not be made: {'; '.join(failed)}"
        )
    return manifest
