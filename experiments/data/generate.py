"""Makes labelled datasets: many episodes, in separate processes, each written whole or not at all.

Every episode has its own seed, derived from the configuration's seed, the scenario's name and the
episode's index, so what an episode holds depends neither on the number of processes nor on the
order nor on how many episodes there are. Running the same command again makes only what is missing.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections import deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from behaviors.errors import InputError
from experiments.console.exit_codes import Interrupted
from experiments.console.progress import Progress
from experiments.data.parallel import start_worker
from scenarios import get_scenario
from sim.engines import get_engine
from sim.scenario import Scenario, sample_agents
from sim.store.atomic import PARTIAL_PREFIX, remove_partial, write_whole
from sim.store.catalogue import (
    MANIFEST,
    finished_episode,
    keep_road,
    unlisted_episodes,
    write_manifest,
)
from sim.store.dataset import open_dataset
from sim.store.lock import LOCK, sole_writer
from sim.store.schema import EpisodeEntry, EpisodeMeta, Manifest, split_of
from sim.store.writing import episode_id, made_with, write_episode

if TYPE_CHECKING:
    from loky.process_executor import ProcessPoolExecutor

ATTEMPTS: Final = 3
"""How often an episode that kills its worker is tried (our choice)."""


_OURS: Final = frozenset({"episodes", "roads", "README.md", LOCK})
"""What an unfinished dataset's folder may hold."""


class GenerateConfig(BaseModel):
    """What a dataset is generated from.

    Attributes:
        scenarios: registered names.
        episodes: episodes per scenario.
        seed: any non-negative integer.
        engine: registered name of the engine.
        flow: light, medium, dense or vehicles per hour; None for the scenario's own.
        mix: share of each behaviour, as text or mapping; None for the scenario's own.
        spread: how much drivers of one behaviour differ; None for the scenario's own.
        duration_s: length of an episode, s; None for the scenario's own.
        step_s: time between frames, s; None for the scenario's own.
        limits_mps: speed limits that a scenario's episodes take in turn, m/s; None for its own.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    episodes: Annotated[int, Field(ge=1, le=10**6)]
    seed: Annotated[int, Field(ge=0)] = 0
    engine: str = "sumo"
    flow: str | float | None = None
    mix: str | dict[str, float] | None = None
    spread: float | None = None
    duration_s: float | None = None
    step_s: float | None = None
    limits_mps: Annotated[tuple[float, ...], Field(min_length=1)] | None = None

    def options(self, index: int) -> dict[str, Any]:
        """What a scenario of the episode with this index is called with."""
        given: dict[str, Any] = self.model_dump(
            include={"flow", "mix", "spread", "duration_s", "step_s"}, exclude_none=True
        )
        if self.limits_mps is not None:
            given["limit_mps"] = self.limits_mps[index % len(self.limits_mps)]
        return given

    def scenario(self, name: str, index: int = 0) -> Scenario:
        """The scenario of that name with this configuration's options, for one of its episodes.

        Raises:
            InputError: if there is no such scenario or an option is out of range.
        """
        return get_scenario(name)(**self.options(index))

    def check(self) -> None:
        """Refuse what no episode can be made from.

        Raises:
            InputError: if the engine or a scenario is not known or named twice, or an option is
                out of range.
        """
        get_engine(self.engine)
        for name in self.scenarios:
            for index in range(len(self.limits_mps or (None,))):
                self.scenario(name, index)
        if len(set(self.scenarios)) != len(self.scenarios):
            raise InputError(f"scenarios: found {', '.join(self.scenarios)}, expected each once")


def _read_toml(path: Path | None) -> dict[str, object]:
    if path is None:
        return {}
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {error}") from None


def read_cluster(path: Path | None, given: str | None = None) -> str | None:
    """The address of the cluster to generate on.

    Args:
        path: TOML file whose section ``[cluster]`` may have an ``address``; None for none.
        given: address given on the command line; it wins.

    Returns:
        The address; None to generate on this machine.

    Raises:
        InputError: if the section has anything else in it.
    """
    section = _read_toml(path).get("cluster", {})
    if not isinstance(section, dict) or set(section) - {"address"}:
        raise InputError(f"{path}: cluster: found {section!r}, expected an address and no more")
    address = given or section.get("address")
    if address is not None and not isinstance(address, str):
        raise InputError(f"{path}: cluster.address: found {address!r}, expected text")
    return address


def read_config(path: Path | None, **given: object) -> GenerateConfig:
    """A configuration from a TOML file, from options, or both; options win.

    Args:
        path: TOML file with the fields of `GenerateConfig`; None for none.
        **given: fields given on the command line; None where not given.

    Returns:
        The configuration.

    Raises:
        InputError: if the file is broken, a field unknown or a value wrong.
    """
    fields = _read_toml(path)
    fields.pop("cluster", None)
    fields.update({name: value for name, value in given.items() if value is not None})
    try:
        return GenerateConfig.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        if first["type"] == "missing":
            option = {"scenarios": "--scenario"}.get(where, f"--{where}")
            raise InputError(f"{option}: found none, expected one (or {where} in a file)") from None
        raise InputError(f"{path or 'options'}: {where}: {first['msg']}") from None


# --- one episode --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Task:
    """One episode to make.

    Attributes:
        config: what the dataset is generated from.
        scenario: which of its scenarios.
        index: 0 for the scenario's first episode.
    """

    config: GenerateConfig
    scenario: str
    index: int

    @property
    def seed(self) -> int:
        """The episode's own seed, independent of every other episode's."""
        name = int.from_bytes(hashlib.sha256(self.scenario.encode()).digest()[:4], "big")
        sequence = np.random.SeedSequence(self.config.seed, spawn_key=(name, self.index))
        return int(sequence.generate_state(1)[0] >> 1)  # SUMO takes 31 bits

    def meta(self, scenario: Scenario) -> EpisodeMeta:
        """What the episode is made from, given its scenario."""
        given = self.config.options(self.index)
        return EpisodeMeta(
            scenario=self.scenario,
            engine=self.config.engine,
            seed=self.seed,
            index=self.index,
            split=split_of(self.index),
            options={
                **{name: given[name] for name in ("flow", "limit_mps") if name in given},
                "mix": {behavior.value: share for behavior, share in scenario.mix.items()},
                "spread": scenario.spread,
                "duration_s": scenario.duration_s,
                "step_s": scenario.step_s,
            },
            made_with=made_with(self.config.engine),
        )

    def __str__(self) -> str:
        """Which episode it is, for messages."""
        return f"{self.scenario} episode {self.index} (seed {self.seed})"


def make_episode(folder: Path, task: Task) -> EpisodeEntry:
    """Make one episode, unless it is there already, whole and unaltered.

    Args:
        folder: the dataset.
        task: which episode.

    Returns:
        Its manifest entry.

    Raises:
        InputError: if the engine cannot run it.
        OSError: if it cannot be written.
    """
    scenario = task.config.scenario(task.scenario, task.index)
    agents = sample_agents(scenario, task.seed)
    meta = task.meta(scenario)
    road = scenario.road.source
    keep_road(folder, road)
    entry = finished_episode(folder, episode_id(meta, agents, road))
    if entry is not None:
        return entry
    frames = get_engine(task.config.engine)(scenario, agents, task.seed)
    return write_episode(folder, meta, frames, agents, road)


# --- all episodes -------------------------------------------------------------------------------


class _Pool:
    """Worker processes that are started again when one of them dies."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._executor: ProcessPoolExecutor | None = None

    def submit(self, folder: Path, task: Task) -> Future[EpisodeEntry]:
        """Have an episode made."""
        from loky.process_executor import ProcessPoolExecutor

        if self._executor is None:
            self._executor = ProcessPoolExecutor(
                max_workers=self._jobs, initializer=start_worker, initargs=(os.getpid(),)
            )
        future: Future[EpisodeEntry] = self._executor.submit(make_episode, folder, task)
        return future

    def stop(self) -> None:
        """End all workers now."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=True)
            self._executor = None


def _make_all(
    folder: Path, tasks: list[Task], jobs: int, shown: Progress
) -> tuple[list[EpisodeEntry], list[str]]:
    """Make every episode; those that fail are reported in words, all others are made."""
    from loky.process_executor import BrokenProcessPool

    waiting, suspects = deque(tasks), deque[Task]()
    deaths: dict[str, int] = {}
    made: list[EpisodeEntry] = []
    failed: list[str] = []
    running: dict[Future[EpisodeEntry], Task] = {}
    pool = _Pool(min(jobs, len(tasks)))
    try:
        while waiting or suspects or running:
            # When a worker dies, all that ran with it are suspect and run alone from then on.
            if suspects and not running:
                task = suspects.popleft()
                running[pool.submit(folder, task)] = task
            while waiting and not suspects and len(running) < jobs:
                task = waiting.popleft()
                running[pool.submit(folder, task)] = task
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            broken = False
            alone = len(running) == 1
            for future in done:
                task = running.pop(future)
                error = future.exception()
                if error is None:
                    entry = future.result()
                    made.append(entry)
                    shown.advance(entry.agents, entry.agent_steps)
                elif isinstance(error, BrokenProcessPool):
                    broken = True
                    if alone:
                        deaths[str(task)] = deaths.get(str(task), 0) + 1
                    if deaths.get(str(task), 0) < ATTEMPTS:
                        suspects.append(task)
                    else:
                        failed.append(f"{task}: killed its worker {ATTEMPTS} times")
                elif isinstance(error, InputError):
                    failed.append(f"{task}: {error}")
                else:
                    raise error
            if broken:
                suspects.extend(running.values())
                running.clear()
                pool.stop()
    finally:
        pool.stop()
    return made, failed


def _check_same(folder: Path, config: GenerateConfig) -> None:
    """Refuse to mix two different datasets in one folder."""
    if (folder / MANIFEST).exists():
        _check_same_manifest(folder, config)
        return
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        if path.name not in _OURS and not path.name.startswith(PARTIAL_PREFIX):
            raise InputError(f"{folder}: found {path.name} in it, expected an empty folder")
    scenarios = {name: config.scenario(name) for name in config.scenarios}
    for entry in unlisted_episodes(folder):
        scenario = scenarios.get(entry.scenario)
        task = Task(config, entry.scenario, entry.index)
        if (
            scenario is None
            or entry.index >= config.episodes
            or EpisodeMeta(**entry.model_dump(include=set(EpisodeMeta.model_fields)))
            != task.meta(scenario)
        ):
            raise InputError(
                f"{folder}: holds unfinished episodes of another configuration; "
                "choose another folder"
            )


def _check_same_manifest(folder: Path, config: GenerateConfig) -> None:
    there = open_dataset(folder).manifest.configuration
    wanted = _configuration(config)
    for name in sorted({*there, *wanted}):
        if name == "episodes":
            old = there.get(name)
            if not isinstance(old, int) or old > config.episodes:
                raise InputError(
                    f"{folder}: holds {old} episodes per scenario, found {config.episodes} asked "
                    "for, expected at least as many; choose another folder"
                )
        elif there.get(name) != wanted.get(name):
            raise InputError(
                f"{folder}: was made with {name} {there.get(name, 'not given')!r}, now "
                f"{wanted.get(name, 'not given')!r}; "
                "choose another folder"
            )


def _configuration(config: GenerateConfig) -> dict[str, Any]:
    dumped = config.model_dump(mode="json", exclude_none=True)
    return {**dumped, "made_with": dict(made_with(config.engine))}


@contextmanager
def _stoppable(folder: Path, wanted: int) -> Iterator[None]:
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


def generate(
    config: GenerateConfig,
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
    from experiments.data.cluster import make_on_cluster
    from experiments.data.data_card import data_card

    if jobs is None:
        jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    if jobs < 1:
        raise InputError(f"jobs: found {jobs}, expected at least 1")
    config.check()
    tasks = [Task(config, name, i) for i in range(config.episodes) for name in config.scenarios]
    with sole_writer(folder), _stoppable(folder, len(tasks)):
        _check_same(folder, config)
        remove_partial(folder)
        remove_partial(folder / "episodes")
        remove_partial(folder / "roads")
        with Progress("generating episodes", len(tasks), quiet) as shown:
            if cluster is None:
                made, failed = _make_all(folder, tasks, jobs, shown)
            else:
                made, failed = make_on_cluster(make_episode, folder, tasks, cluster, shown)
        manifest = write_manifest(folder, _configuration(config), made)
        write_whole(folder / "README.md", data_card(open_dataset(folder)).encode())
    if failed:
        raise InputError(
            f"{len(failed)} of {len(tasks)} episodes could not be made: {'; '.join(failed)}"
        )
    return manifest
