"""Makes episodes in worker processes of this machine; other episodes survive a dying worker."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Final

from behaviors.errors import InputError
from experiments.console.progress import Progress
from experiments.data.parallel import start_worker
from experiments.data.tasks import T
from sim.store.schema import EpisodeEntry

if TYPE_CHECKING:
    from loky.process_executor import ProcessPoolExecutor

ATTEMPTS: Final = 3
"""How often an episode that kills its worker is tried."""


class RestartingPool:
    """Worker processes that are started again when one of them dies."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._executor: ProcessPoolExecutor | None = None

    def submit(
        self, make: Callable[[Path, T], EpisodeEntry], folder: Path, task: T
    ) -> Future[EpisodeEntry]:
        """Start to make an episode; if a worker has died meanwhile, the future says so."""
        from loky.process_executor import BrokenProcessPool, ProcessPoolExecutor

        if self._executor is None:
            self._executor = ProcessPoolExecutor(
                max_workers=self._jobs, initializer=start_worker, initargs=(os.getpid(),)
            )
        future: Future[EpisodeEntry] = Future()
        try:
            future = self._executor.submit(make, folder, task)
        except BrokenProcessPool as error:
            future.set_exception(error)
        return future

    def stop(self) -> None:
        """End all workers now."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=True)
            self._executor = None


def make_in_processes(
    make: Callable[[Path, T], EpisodeEntry],
    folder: Path,
    tasks: Sequence[T],
    jobs: int,
    shown: Progress,
) -> tuple[list[EpisodeEntry], list[str]]:
    """Make every episode; those that fail are reported in words, all others are made.

    When a worker dies, every episode that ran at the time is suspect and runs alone from then on.

    Args:
        make: makes one episode.
        folder: the dataset.
        tasks: the episodes.
        jobs: worker processes.
        shown: advances with each episode made.

    Returns:
        Entries of the episodes made, and what failed.

    Raises:
        OSError: if something cannot be written.
    """
    from loky.process_executor import BrokenProcessPool

    waiting, suspects = deque(tasks), deque[T]()
    deaths: dict[str, int] = {}
    made: list[EpisodeEntry] = []
    failed: list[str] = []
    running: dict[Future[EpisodeEntry], T] = {}
    pool = RestartingPool(min(jobs, len(tasks)))
    try:
        while waiting or suspects or running:
            if suspects and not running:
                task = suspects.popleft()
                running[pool.submit(make, folder, task)] = task
            while waiting and not suspects and len(running) < jobs:
                task = waiting.popleft()
                running[pool.submit(make, folder, task)] = task
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
