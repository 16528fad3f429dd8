"""Files of unknown origin are read in a child process with limits of memory and time.

A broken file may crash the library that reads it, unpack to more than fits into memory, or keep it
busy for ever. The command line therefore reads what it did not write with `guarded`: whatever
happens to the child is one line that names the file. Python programs call readers directly.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final, TypeVar

T = TypeVar("T")

MEMORY_BYTES, MEMORY_PER_BYTE, TIME_S, TIME_S_PER_BYTE = 2**31 - 2**28, 16, 50.0, 5e-6
"""Memory that a child may use, and time for each answer, s: each also by byte of its files."""

THREADS: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Settings of the child: each thread of a library would reserve memory of its own."""

_GUARDING: ContextVar[bool] = ContextVar("guarding", default=False)


@contextmanager
def guarding() -> Iterator[None]:
    """In the block, `guarded` uses a child process; the command line is such a block."""
    token = _GUARDING.set(True)
    try:
        yield
    finally:
        _GUARDING.reset(token)


def guarded(source: Path, function: Callable[..., Iterator[Any]], *arguments: Any) -> Iterator[Any]:
    """Yields of a module's function that runs in a child process, inside a block of `guarding`.

    The size of the file or folder ``source`` decides the limits. A path that the function yields
    names the file that it reads next, and is not handed on. An `InputError` is the function's own,
    or names the file and says what happened.
    """
    from multiprocessing import Pipe

    from behaviors.errors import InputError  # which imports numpy

    if not _GUARDING.get():
        yield from (one for one in function(*arguments) if not isinstance(one, Path))
        return
    files = source.rglob("*") if source.is_dir() else [source]
    size = sum(file.stat().st_size for file in files if file.is_file())
    time_s, file = TIME_S + TIME_S_PER_BYTE * size, source
    wanted = "expected a file that can be read"
    answers, far_end = Pipe()
    command = f"from experiments.guard import child; child({far_end.fileno()})"
    path = os.pathsep.join(filter(None, sys.path))
    process = subprocess.Popen(
        [sys.executable, "-c", command], pass_fds=[far_end.fileno()], stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=os.environ | THREADS | {"PYTHONPATH": path},
    )  # fmt: skip
    far_end.close()
    try:
        answers.send(MEMORY_BYTES + MEMORY_PER_BYTE * size)
        answers.send((function, arguments))
        while True:
            if not answers.poll(time_s):
                raise InputError(f"{file}: reading took more than {time_s:.0f} s, {wanted}")
            what, found = answers.recv()
            if what == "end":
                return
            if what == "file":
                file = found
            elif what == "answer":
                yield found
            else:
                raise InputError(found if what == "error" else f"{file}: found a broken {found}")
    except (EOFError, OSError):  # the child is gone, maybe in the middle of an answer
        number = -process.wait()
        ended = signal.Signals(number).name if number > 0 else f"exit code {-number}"
        raise InputError(f"{file}: reading broke off ({ended}), {wanted}") from None
    finally:
        process.kill()
        process.wait()
        answers.close()


def guarded_call(source: Path, function: Callable[..., T], *arguments: Any) -> T:
    """Result of a function that reads a file, run as in `guarded`."""
    found: list[T] = list(guarded(source, _once, function, *arguments))
    return found[0]


def _once(function: Callable[..., T], *arguments: Any) -> Iterator[T]:
    yield function(*arguments)


def child(descriptor: int) -> None:
    """Answer the one request that comes through a pipe; the main function of a child process."""
    from multiprocessing.connection import Connection

    from behaviors.errors import InputError

    request = Connection(descriptor)
    memory = request.recv()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    try:
        function, arguments = request.recv()
        for one in function(*arguments):
            request.send(("file" if isinstance(one, Path) else "answer", one))
        request.send(("end", None))
    except InputError as error:
        request.send(("error", str(error)))
    except MemoryError:
        request.send(("broken", f"file (it needs more than {memory / 2**30:.2g} GB of memory)"))
    except Exception as error:  # of a broken file, anything may come
        said = " ".join(f"{type(error).__name__}: {error}".split())
        request.send(("broken", f"file ({said:.200})"))
