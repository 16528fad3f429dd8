"""One writer per dataset folder at a time."""

from __future__ import annotations

import fcntl
import logging
import os
import shutil
import socket
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from sim.store.atomic import PARTIAL_PREFIX, refuse_url, temporary_folder
from sim.store.places import Folder, place_of
from sim.store.schema import TABLES

LOGGER: Final = logging.getLogger("graphrqi")
"""Says at level INFO that nothing had to be written."""

LOCK: Final = ".lock"
"""Name of the lock file. It exists only while a run writes, and names that run."""

SAID_BYTES: Final = 200
"""So much of what a lock file says is read."""

FILLING: Final = "filling a new folder"
"""The purpose of runs that begin anew when they are killed."""

OWN: Final = frozenset(
    {"episodes", "roads", "manifest.json", "episodes.parquet", "README.md", "croissant.json"}
    | set(TABLES)
)
"""What a run writes into a dataset's folder."""


@contextmanager
def sole_writer(folder: Path, purpose: str = "writing") -> Iterator[str]:
    """Hold a folder for writing; the operating system releases it when the process ends.

    Args:
        folder: what to hold; created if need be, and removed if an error leaves it empty.
        purpose: what the run does, for its lock file.

    Yields:
        What the lock file of a run that was killed here says; "" where none was. The folder is
        held inside the block.

    Raises:
        InputError: if another process holds it, or the path is not a folder.
        OSError: if the folder cannot be written.
    """
    with _made(folder), _locked(folder, LOCK, fcntl.LOCK_EX) as descriptor:
        left = os.pread(descriptor, SAID_BYTES, 0).decode(errors="replace")
        os.ftruncate(descriptor, 0)
        holder = f"process {os.getpid()} on {socket.gethostname()}, {purpose}"
        os.pwrite(descriptor, holder.encode(), 0)
        yield left


@contextmanager
def one_of_several_writers(folder: Path, name: str) -> Iterator[None]:
    """Hold a folder for writing together with others that hold it in this way.

    Args:
        folder: what to hold; created if need be.
        name: this writer's own; no other may hold the folder under it.

    Yields:
        Nothing; the folder is held inside the block.

    Raises:
        InputError: if a sole writer holds it, or another one of that name.
        OSError: if the folder cannot be written.
    """
    with (
        _made(folder),
        _locked(folder, LOCK, fcntl.LOCK_SH, f"one of several writers, {name}"),
        _locked(folder, f"{LOCK}-{name}", fcntl.LOCK_EX, name),
    ):
        yield


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make a folder where there is none; an error in the block removes it again if it is empty."""
    refuse_url(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: found a file, expected a folder")
    existing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for path in (folder, *folder.parents):
            if path == existing:
                break
            with suppress(OSError):
                path.rmdir()
        raise


@contextmanager
def _locked(folder: Path, name: str, kind: int, purpose: str | None = None) -> Iterator[int]:
    """Hold a lock file of a folder; the last one that holds it removes it.

    Who is refused is told its own purpose, or else what the file says and to go elsewhere.
    """
    path = folder / name
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = purpose or os.pread(descriptor, SAID_BYTES, 0).decode(errors="replace").strip()
            os.close(descriptor)
            raise InputError(
                f"{folder}: another run is writing to it{f' ({holder})' if holder else ''}; "
                f"wait for its end{'' if purpose else ' or choose another folder'}"
            ) from None
        if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
            break
        os.close(descriptor)  # the holder before us removed the file that we opened
    try:
        yield descriptor
    finally:
        with suppress(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink(missing_ok=True)
        os.close(descriptor)


def _remove_own(folder: Path, own: Collection[str]) -> None:
    """Remove what a run writes into a folder; others' files stay."""
    for child in folder.iterdir():
        if child.name in own or child.name.startswith(PARTIAL_PREFIX):
            shutil.rmtree(child) if child.is_dir() else child.unlink()


@contextmanager
def new_folder(folder: Path, own: Collection[str] = OWN) -> Iterator[Path]:
    """Hold a new or empty folder for writing; an error in the block leaves it as it was.

    What a run that was killed while it filled the folder left there is removed first.

    Args:
        folder: what to hold; created if need be.
        own: names of what the run writes into it.

    Yields:
        The folder, which is held inside the block.

    Raises:
        InputError: if there is something in it, another process holds it, or the path is not a
            folder.
        OSError: if the folder cannot be written.
    """
    with sole_writer(folder, FILLING) as left:
        if left.endswith(FILLING):
            _remove_own(folder, own)
        if any(child.name != LOCK for child in folder.iterdir()):
            raise InputError(f"{folder}: found something there, expected a new or empty folder")
        try:
            yield folder
        except BaseException:
            for child in folder.iterdir():
                if child.name != LOCK:
                    shutil.rmtree(child) if child.is_dir() else child.unlink()
            raise


@contextmanager
def same_again(out: Path, kind: str) -> Iterator[Path]:
    """A folder to fill anew with what is there: a command that was stopped at its end runs again.

    Args:
        out: what a command wrote, a folder or a URL; it is only read.
        kind: what that is, in a word.

    Yields:
        An empty temporary folder of the same name.

    Raises:
        InputError: if a file that the block wrote there is missing in ``out``, or another.
    """
    place = place_of(out)
    with temporary_folder("again") as scratch:
        folder = scratch / (place.path.name or "data")
        folder.mkdir()
        yield folder
        made = Folder(folder)
        for file in made.files():
            if place.size(file) != made.size(file) or place.read(file) != made.read(file):
                raise InputError(
                    f"{place.url}: found another {kind} there ({file} differs), expected a new or "
                    "empty folder"
                )
    LOGGER.info("%s: this %s is there already; nothing was written", place.url, kind)
