"""Calls a function on many arguments in worker processes; the answers come in order."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

from behaviors.errors import InputError
from experiments.console.progress import Progress

T = TypeVar("T")

PARENT_CHECK_S: Final = 0.25
"""How often a worker checks that its parent still runs, s (it costs nothing)."""


def start_worker(parent: int, folder: str) -> None:
    """Prepare a worker of the run with this process id and working folder.

    The parent handles Ctrl-C, and without a parent the worker ends.
    """
    os.chdir(folder)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent-watch").start()


def processors() -> int:
    """How many processors this process may use: a container's or a batch job's share of them."""
    from loky import cpu_count

    return int(cpu_count())


def checked_jobs(jobs: int | None) -> int:
    """Worker processes: as many as asked for, or one per processor; less than one are refused."""
    jobs = processors() if jobs is None else jobs
    if jobs < 1:
        raise InputError(f"jobs: found {jobs}, expected at least 1")
    return jobs


def in_parallel(
    function: Callable[..., T],
    arguments: Sequence[tuple[Any, ...]],
    jobs: int | None,
    what: str = "",
    quiet: bool = True,
) -> Iterator[T]:
    """Call a function on each tuple of arguments; the answers come in this order.

    One call or one job runs in this process. The progress that is shown says ``what`` is counted.
    """
    with Progress(what, len(arguments), quiet) as progress:
        if jobs == 1 or len(arguments) < 2:
            answers = (function(*one) for one in arguments)
        else:
            from loky import get_reusable_executor

            # a worker whose memory grows is replaced, of which users need not know
            warnings.filterwarnings("ignore", message="A worker was restarted while some jobs")
            executor = get_reusable_executor(
                max_workers=min(checked_jobs(jobs), len(arguments)), env={"OMP_NUM_THREADS": "1"},
                initializer=start_worker, initargs=(os.getpid(), os.getcwd()),
            )  # fmt: skip
            futures = [executor.submit(function, *one) for one in arguments]
            answers = (future.result() for future in futures)
        for answer in answers:
            yield answer
            progress.advance()
