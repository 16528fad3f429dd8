"""Files of unknown origin are read in a child process with limits of memory and time.

A broken file may crash the library that reads it, unpack to more than fits into memory, or keep it
busy for ever. The command line therefore reads what it did not write with `guarded`: whatever
happens to the child is one line that names the file. Python programs call readers directly.
"""

from __future__ import annotations

import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final, TypeVar

from experiments.console.notices import LOGGER

T = TypeVar("T")

MEMORY_BYTES, MEMORY_PER_BYTE = 2**31 - 2**28, 16
"""Memory that a child may use: bytes, and bytes for each byte of the files it reads."""

TIME_S, TIME_S_PER_BYTE = 50.0, 5e-6
"""Time that a child may take for each answer, s, and the time for each byte it reads, s."""

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


def is_guarding() -> bool:
    """Whether `guarded` uses a child process here."""
    return _GUARDING.get()


def guarded(source: Path, function: Callable[..., Iterator[Any]], *arguments: Any) -> Iterator[Any]:
    """Yields of a function that runs in a child process with limits, inside a block of `guarding`.

    Args:
        source: the file or folder that the function reads; its size decides the limits.
        function: of a module; a path that it yields names the file that it reads next and is not
            handed on.
        arguments: of the function; they are pickled, as is each answer.

    Raises:
        InputError: the function's own, or one line that names the file and says what happened.
    """
    from behaviors.errors import InputError  # which imports numpy

    if not is_guarding():
        yield from (one for one in function(*arguments) if not isinstance(one, Path))
        return
    files = source.rglob("*") if source.is_dir() else [source]
    size = sum(file.stat().st_size for file in files if file.is_file())
    time_s, file, late = TIME_S + TIME_S_PER_BYTE * size, source, threading.Event()
    child = subprocess.Popen(
        [sys.executable, "-c", "from experiments.guard import child; child()"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        env=os.environ | THREADS | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    assert child.stdin is not None
    assert child.stdout is not None

    def stop() -> None:
        late.set()
        child.kill()

    try:
        with child.stdin as request:
            pickle.dump(MEMORY_BYTES + MEMORY_PER_BYTE * size, request)
            pickle.dump((function, arguments), request)
        while True:
            timer = threading.Timer(time_s, stop)
            timer.start()
            try:
                what, found = pickle.load(child.stdout)
            except (EOFError, pickle.UnpicklingError):
                number = -child.wait()
                ended = signal.Signals(number).name if number > 0 else f"exit code {-number}"
                why = f"took more than {time_s:.0f} s" if late.is_set() else f"broke off ({ended})"
                raise InputError(
                    f"{file}: reading {why}, expected a file that can be read"
                ) from None
            finally:
                timer.cancel()
            if what == "end":
                return
            if what == "file":
                file = found
            elif what == "error":
                raise InputError(found)
            elif what == "broken":
                LOGGER.debug("%s: %s", file, found)
                last = found.strip().splitlines()[-1]
                raise InputError(f"{file}: found a broken file ({last:.200})")
            else:
                yield found
    finally:
        child.kill()
        child.wait()
        child.stdout.close()


def guarded_call(source: Path, function: Callable[..., T], *arguments: Any) -> T:
    """Result of a function that reads a file, run as in `guarded`."""
    found: list[T] = list(guarded(source, _once, function, *arguments))
    return found[0]


def _once(function: Callable[..., T], *arguments: Any) -> Iterator[T]:
    yield function(*arguments)


def child() -> None:
    """Answer the one request on stdin; the main function of a child process."""
    from behaviors.errors import InputError

    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # text printed by libraries is not part of the answer

    def send(what: str, found: Any = None) -> None:
        pickle.dump((what, found), answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()

    memory = pickle.load(sys.stdin.buffer)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    try:
        function, arguments = pickle.load(sys.stdin.buffer)
        for one in function(*arguments):
            send("file" if isinstance(one, Path) else "answer", one)
    except InputError as error:
        send("error", str(error))
    except MemoryError:
        send("broken", f"it needs more than {memory / 2**30:.2g} GB of memory")
    except Exception:  # of a broken file, anything may come
        import traceback

        send("broken", traceback.format_exc())
    else:
        send("end")
