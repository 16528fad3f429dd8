"""Calls a function on many tasks in worker processes, here or on the machines of a Dask cluster.

A worker that dies takes no other task with it: all that ran at the time are tried once more, each
alone.

References:
    Rocklin (2015), Dask: parallel computation with blocked algorithms and task scheduling, SciPy.
"""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from typing import Final, TypeVar

from behaviors.errors import InputError
from experiments.data.parallel import start_worker
from sim.store.writing import made_with

A = TypeVar("A")
B = TypeVar("B")

CONNECT_S: Final = 20.0
"""Longest wait for the scheduler and its first worker, s."""

TASKS_AT_ONCE: Final = 10_000
"""Most tasks that a cluster is given at once."""

SAFE: Final = re.compile(r"(tls|inproc)://.+|tcp://(127\.0\.0\.1|localhost|\[::1\]):\d+")
"""Addresses at which no other user can listen, or run code as this user."""

_DEATHS: Final = ("BrokenProcessPool", "TerminatedWorkerError", "KilledWorker")
"""Names of the errors that say that a worker died: loky's and Dask's."""


def in_workers(
    function: Callable[[A], B], tasks: Iterable[A], jobs: int, cluster: str | None = None
) -> Iterator[tuple[A, B | None]]:
    """Call a function on every task.

    Args:
        function: importable by workers.
        tasks: its arguments.
        jobs: worker processes; one runs in this process.
        cluster: address of a Dask scheduler, whose workers take the place of processes.

    Yields:
        Each task with its answer, as they come; with None where it killed its worker twice.

    Raises:
        InputError: if the cluster cannot do the work.
    """
    if cluster is None and jobs == 1:
        for task in tasks:
            yield task, function(task)
        return
    at_once = jobs if cluster is None else TASKS_AT_ONCE
    suspects, waiting = deque[A](), deque(tasks)
    while waiting:
        yield from _until_one_dies(function, waiting, suspects, jobs, cluster, at_once)
    while suspects:
        alone, killers = deque([suspects.popleft()]), deque[A]()
        yield from _until_one_dies(function, alone, killers, jobs, cluster, 1)
        for task in killers:
            yield task, None


def _until_one_dies(
    function: Callable[[A], B], waiting: deque[A], suspects: deque[A], jobs: int,
    cluster: str | None, at_once: int,
) -> Iterator[tuple[A, B]]:  # fmt: skip
    """Take tasks from those that wait until all are done or a worker dies with some suspects."""
    running: dict[Future[B], A] = {}
    broken = False
    with _processes(jobs) if cluster is None else _cluster(cluster) as executor:
        while running or (waiting and not broken):
            while waiting and not broken and len(running) < at_once:
                task = waiting.popleft()
                running[executor.submit(function, task)] = task
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                task, error = running.pop(future), future.exception()
                if error is None:
                    yield task, future.result()
                elif type(error).__name__ in _DEATHS:
                    suspects.append(task)
                    broken = True
                else:
                    raise error


@contextmanager
def _processes(jobs: int) -> Iterator[Executor]:
    """Worker processes of this machine, which end with the block."""
    from loky.process_executor import ProcessPoolExecutor

    executor = ProcessPoolExecutor(
        max_workers=jobs, initializer=start_worker, initargs=(os.getpid(),)
    )
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, kill_workers=True)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask scheduler; they make the same bytes, one simulation per process."""
    wrong = f"cluster {address}: found "
    if not SAFE.fullmatch(address):
        raise InputError(
            f"{wrong}an unencrypted address of another machine or none, expected "
            "tls://HOST:PORT or tcp://127.0.0.1:PORT: its clients run code as you"
        )
    try:
        from distributed import Client
        from distributed.security import Security
    except ImportError:
        raise InputError(
            "cluster: found no distributed, expected it: pip install 'graphrqi[cluster]'"
        ) from None
    try:
        # certificates are those of Dask's own configuration
        encrypted = Security(require_encryption=True) if address.startswith("tls://") else None
        client = Client(address, timeout=CONNECT_S, security=encrypted)
    except (OSError, ValueError, RuntimeError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{wrong}no scheduler there, or no certificates for it, as docs/cluster.md says "
            f"({reason:.100})"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise InputError(f"{wrong}no worker, expected one or more") from None
        for worker, threads in client.nthreads().items():
            if threads != 1:
                raise InputError(
                    f"{wrong}worker {worker} with {threads} threads, expected 1: start it with "
                    "--nthreads 1"
                )
        engines = ("sumo", "highway")
        here = made_with(*engines)
        for worker, there in client.run(made_with, *engines, on_error="return").items():
            if there != here and not isinstance(there, OSError):  # it has just died
                raise InputError(f"{wrong}{there} on {worker}, expected {here}")
        yield client.get_executor(pure=False)
