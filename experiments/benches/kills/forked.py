"""Runs commands in forked processes, which have everything imported and so begin at once."""

from __future__ import annotations

import contextlib
import hashlib
import multiprocessing
import os
import runpy
import signal
import sys
import tempfile
import warnings
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Final

from loky.backend.context import set_start_method

STOPPING: Final = (signal.SIGINT, signal.SIGTERM)
"""Signals that a command is stopped with."""

LONGEST_S: Final = 600.0
"""Longest time for a command (they take seconds, minutes while kernels compile)."""


def run(
    words: list[str], temporary: Path, disturbed: tuple[signal.Signals, float] | None = None
) -> tuple[int, str]:
    """Run a command in a forked process.

    Args:
        words: the command, without the program's name.
        temporary: its folder for temporary files.
        disturbed: a signal, and after which time it comes, s; None for none.

    Returns:
        Its exit code (below 0 for a signal) and the end of its messages.
    """
    process = start(words, temporary)
    if disturbed is not None:
        sent, after_s = disturbed
        process.join(after_s)
        with contextlib.suppress(ProcessLookupError):
            if process.exitcode is None and process.pid is not None:
                os.kill(process.pid, sent)
    return ended(process, temporary)


def start(words: list[str], temporary: Path) -> ForkProcess:
    """Start a command in a forked process, which leads a session of its own."""
    temporary.mkdir(parents=True, exist_ok=True)
    told = temporary.with_name("told")
    process = multiprocessing.get_context("fork").Process(
        target=_command, args=(words, temporary, told)
    )
    signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)  # until the child has handlers of its own
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)
    return process


def ended(process: ForkProcess, temporary: Path) -> tuple[int, str]:
    """Wait for a command; its exit code and the end of its messages."""
    process.join(LONGEST_S)
    if process.exitcode is None:
        process.kill()
        process.join()
        return 1, f"not ended after {LONGEST_S:g} s"
    told = temporary.with_name("told")
    return process.exitcode, told.read_text(errors="replace")[-500:] if told.exists() else ""


def content(folder: Path) -> dict[str, str]:
    """The hash of every file below a folder, by its path."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def _command(words: list[str], temporary: Path, told: Path) -> None:
    os.setsid()
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)
    warnings.filterwarnings("ignore", message="`fork` start method")
    set_start_method("fork", force=True)  # workers have everything imported, too
    with told.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.environ["TMPDIR"], tempfile.tempdir = str(temporary), None
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["graphrqi", *words]
    try:
        runpy.run_module("experiments.cli", run_name="__main__")
    except SystemExit as exited:
        os._exit(exited.code if isinstance(exited.code, int) else 1)
    except KeyboardInterrupt:  # before the command looks after it: Python ends itself like this
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    finally:
        sys.stdout.flush()
