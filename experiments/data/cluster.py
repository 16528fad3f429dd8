"""Makes episodes on a Dask cluster: the same episodes, the same bytes, on many machines.

Scheduler and workers are started with Dask's own commands; every worker needs this package, one
thread (SUMO runs one simulation per process) and the dataset's folder on a shared disk.

References:
    Rocklin (2015), Dask: parallel computation with blocked algorithms and task scheduling, SciPy.
"""

from __future__ import annotations

import hashlib
import ipaddress
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import behaviors
import experiments
import graphrqi
import scenarios
import sim
from behaviors.errors import InputError
from sim.store.writing import made_with

if TYPE_CHECKING:
    from distributed import Client

    from experiments.console.progress import Progress
    from experiments.data.tasks import T
    from sim.store.schema import EpisodeEntry

CONNECT_S: Final = 20.0
"""Longest wait for the scheduler and its first worker, s."""


def _sees(folder: str) -> bool:
    return Path(folder).is_dir()


def code() -> str:
    """Hash of this machine's code, because an edited copy of the same version makes other data."""
    digest = hashlib.sha256()
    for package in (behaviors, sim, scenarios, graphrqi, experiments):
        folder = Path(package.__path__[0])
        for file in sorted(folder.rglob("*.py")):
            digest.update(f"{package.__name__}/{file.relative_to(folder).as_posix()}".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def _answers(client: Client, ask: Callable[..., Any], *arguments: object) -> dict[str, Any]:
    """Every worker's answer; workers that die while they are asked are left out."""
    found = client.run(ask, *arguments, on_error="return")
    return {worker: one for worker, one in found.items() if not isinstance(one, OSError)}


def _check_address(address: str) -> None:
    """Refuse an address at which others could listen, or run code as this user."""
    protocol, separator, rest = address.partition("://")
    try:
        host = urlsplit(f"//{rest}").hostname or ""
    except ValueError:
        separator = host = ""
    if not separator or protocol not in ("tcp", "tls", "inproc"):
        raise InputError(f"cluster {address}: expected tls://HOST:PORT, or tcp://127.0.0.1:PORT")
    if protocol == "tcp" and not _is_loopback(host):
        raise InputError(
            f"cluster {address}: found an unencrypted address of another machine, expected "
            "tls://HOST:PORT: who reaches such a scheduler runs code as you"
        )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@contextmanager
def _connected(address: str, folder: Path, engine: str) -> Iterator[Client]:
    """A client of a cluster whose workers can do the work."""
    _check_address(address)
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
    except TypeError as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"cluster {address}: found no certificates, expected those of Dask's configuration, "
            f"distributed.comm.tls, as docs/cluster.md says ({reason:.100})"
        ) from None
    except (OSError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"cluster {address}: found no scheduler there ({reason})") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise InputError(f"cluster {address}: found no worker, expected one or more") from None
        for worker, threads in client.nthreads().items():
            if threads != 1:
                raise InputError(
                    f"cluster {address}: found worker {worker} with {threads} threads, expected "
                    "1: start it with --nthreads 1"
                )
        here = made_with(engine)
        for worker, there in _answers(client, made_with, engine).items():
            if there != here:
                raise InputError(f"cluster {address}: found {there} on {worker}, expected {here}")
        ours = code()
        for worker, theirs in _answers(client, code).items():
            if theirs != ours:
                raise InputError(
                    f"cluster {address}: found other code of the same version on {worker}, "
                    "expected the same: install the same copy there"
                )
        for worker, seen in _answers(client, _sees, str(folder)).items():
            if not seen:
                raise InputError(
                    f"{folder}: found no such folder on {worker}, expected a shared disk"
                )
        yield client


def make_on_cluster(
    make: Callable[[Path, T], EpisodeEntry],
    folder: Path,
    tasks: Sequence[T],
    address: str,
    shown: Progress,
) -> tuple[list[EpisodeEntry], list[str]]:
    """Make every episode; those that fail are reported in words, all others are made.

    Args:
        make: makes one episode.
        folder: the dataset.
        tasks: the episodes.
        address: of the scheduler, ``tls://host:port``; without encryption on this machine only.
        shown: advances with each episode made.

    Returns:
        Entries of those made, and what failed.

    Raises:
        InputError: if the cluster cannot do the work.
        OSError: if something cannot be written.
    """
    from distributed import as_completed

    folder = folder.resolve()
    made: list[EpisodeEntry] = []
    failed: list[str] = []

    def gather(futures: dict[Any, T], last: bool) -> list[T]:
        """Take finished episodes; return tasks whose worker died, unless it was their last try."""
        from distributed import KilledWorker

        suspects: list[T] = []
        for future in as_completed(list(futures)):
            task, error = futures[future], future.exception()
            if error is None:
                entry = future.result()
                made.append(entry)
                shown.advance(entry.agents, entry.agent_steps)
            elif isinstance(error, KilledWorker):
                if last:
                    failed.append(f"{task}: killed its workers")
                else:
                    suspects.append(task)
            elif isinstance(error, InputError):
                failed.append(f"{task}: {error}")
            else:
                raise error
            future.release()
        return suspects

    with _connected(address, folder, tasks[0].config.engine) as client:
        # Dask tries an episode again when its worker dies. An episode that only waited on a worker
        # that others killed is tried once more, alone.
        suspects = gather({client.submit(make, folder, t, pure=False): t for t in tasks}, False)
        for task in suspects:
            gather({client.submit(make, folder, task, pure=False): task}, True)
    return made, failed
