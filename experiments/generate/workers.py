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
from functools import partial
from typing import Final, TypeVar

from behaviors.errors import InputError
from experiments.data.parallel import start_worker
from sim.store.writing import made_with

A = TypeVar("A")
B = TypeVar("B")

CONNECT_S, TASKS_AT_ONCE = 20.0, 10_000
"""Longest wait for a scheduler and its first worker, s, and most tasks that it is given at once."""

SAFE: Final = re.compile(r"(tls|inproc)://.+|tcp://(127\.0\.0\.1|localhost|\[::1\]):\d+")
"""Addresses at which no other user can listen, or run code as this user."""

_DEATHS: Final = ("BrokenProcessPool", "TerminatedWorkerError", "KilledWorker")
"""Names of the errors that say that a worker died: loky's and Dask's."""


def in_workers(
    function: Callable[[A], B], tasks: Iterable[A], jobs: int, cluster: str | None = None
) -> Iterator[tuple[A, B | None]]:
    """Each task with the function's answer, as they come; None where it killed its worker twice.

    A single job runs in this process. The workers of the Dask scheduler at the address ``cluster``
    take the place of processes.
    """
    waiting, suspects = deque(tasks), deque[A]()
    if cluster is None and jobs == 1:
        yield from ((task, function(task)) for task in waiting)
        return
    at_once = jobs if cluster is None else TASKS_AT_ONCE
    workers = partial(_processes, jobs) if cluster is None else partial(_cluster, cluster)
    while waiting or suspects:
        alone = not waiting
        tried = deque([suspects.popleft()]) if alone else waiting
        running: dict[Future[B], A] = {}
        died: list[A] = []
        with workers() as executor:
            while running or (tried and not died):
                while tried and not died and len(running) < at_once:
                    task = tried.popleft()
                    running[executor.submit(function, task)] = task
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    task, error = running.pop(future), future.exception()
                    if error is None:
                        yield task, future.result()
                    elif type(error).__name__ in _DEATHS:
                        died.append(task)
                    else:
                        raise error
        if alone:
            yield from ((task, None) for task in died)
        else:
            suspects += died


@contextmanager
def _processes(jobs: int) -> Iterator[Executor]:
    """Worker processes of this machine, which end with the block."""
    from loky.process_executor import ProcessPoolExecutor

    executor = ProcessPoolExecutor(
        max_workers=jobs, initializer=start_worker, initargs=(os.getpid(), os.getcwd())
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
        if any(threads != 1 for threads in client.nthreads().values()):
            raise InputError(f"{wrong}workers with several threads, expected --nthreads 1")
        engines = ("sumo", "highway")
        here = made_with(*engines)
        for worker, there in client.run(made_with, *engines, on_error="return").items():
            if there != here and not isinstance(there, OSError):  # it has just died
                raise InputError(f"{wrong}{there} on {worker}, expected {here}")
        yield client.get_executor(pure=False)
