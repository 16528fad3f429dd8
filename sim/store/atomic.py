"""Files and folders that appear whole or not at all.

Everything is written under a hidden name beside its place and moved there with `os.replace`, so a
reader, or a run that was killed, never sees half of anything.
"""

from __future__ import annotations

import errno
import os
import platform
import re
import shutil
import tempfile
import threading
import time
import uuid
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NoReturn

from behaviors.errors import InputError

URL: Final = re.compile(r"^([a-z][a-z0-9+.-]+):/{1,3}(?!/)(.*)$", re.DOTALL)
"""A URL, also after a path has taken one of its slashes away."""

PARTIAL_PREFIX: Final = ".partial-"
"""How the hidden name of everything unfinished begins."""


_HERE: Final = f"{zlib.crc32(platform.node().encode()):08x}"
"""This machine, in hidden names: only here is it known whether a process is alive."""

_ORPHAN: Final = re.compile(
    rf"{re.escape(PARTIAL_PREFIX)}.*-{_HERE}-(\d+)-[0-9a-f]{{8}}", re.DOTALL
)

_SCRATCH: Final = re.compile(rf"graphrqi-[a-z]+-{_HERE}-(\d+)-[0-9a-f]{{8}}")
"""Names of temporary folders; see `temporary_folder`."""

LONGEST_REMOVAL_S: Final = 2.0
"""Within which time a process that ends removes its temporary folders, s (it takes
milliseconds)."""

_looked_after: set[Path] = set()
_temporary: set[Path] = set()
_making = threading.Lock()


def _begin_fork() -> None:
    """Another thread may have held the lock, and is not here to give it back."""
    global _making
    _making = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_fork)


def refuse_url(path: Path) -> None:
    """Refuse a URL where only a path of this machine can be written.

    Raises:
        InputError: naming it.
    """
    found = URL.match(str(path))
    if found is not None:
        raise InputError(
            f"{found[1]}://{found[2]}: found a URL, expected a path of this machine here"
        )


def _partial(path: Path) -> Path:
    """A hidden name beside a path; once for each folder, what killed processes left there goes."""
    if path.parent not in _looked_after:
        _looked_after.add(path.parent)
        _remove_orphans(path.parent)
    own = f"{_HERE}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    return path.parent / f"{PARTIAL_PREFIX}{path.name}-{own}"


def _remove_orphans(folder: Path, names: re.Pattern[str] = _ORPHAN) -> None:
    """Remove what processes of this machine left unfinished in a folder when they were killed."""
    with suppress(OSError):  # a folder that may be written and not listed, or files of others
        for name in os.listdir(folder):
            match = names.fullmatch(name)
            if match is not None and not _alive(int(match[1])):
                _remove(folder / name)


def _alive(process: int) -> bool:
    if os.name != "posix":
        return True  # there os.kill ends it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # somebody else's, or no process number at all
        return True
    return True


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _name(error: BaseException, partial: Path, path: Path) -> None:
    """Let an error of the system name the path that the user knows, and say no more than why.

    That of a full disk names none, others name the hidden file, and pyarrow's say both in words.
    """
    if not isinstance(error, OSError) or error.errno is None:
        return
    if error.filename is None or Path(error.filename).is_relative_to(partial):
        error.filename = str(path)
        error.filename2 = None
    if str(partial) in str(error.strerror) or "Detail: [errno" in str(error.strerror):
        error.strerror = os.strerror(error.errno)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it appears whole or not at all.

    Args:
        path: where; its folder must exist. An older file there is replaced.
        data: the content.

    Raises:
        OSError: if it cannot be written; nothing is left behind.
    """
    with whole_file(path) as partial:
        partial.write_bytes(data)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A new file to write, moved to its place when the block ends without an error.

    Args:
        path: where it will appear; an older file there is replaced, a link is followed, and a pipe
            or device is written to. Its folder must exist.

    Yields:
        The path to write to.

    Raises:
        OSError: if it cannot be written; nothing is left behind.
    """
    refuse_url(path)
    if path.exists() and not path.is_file() and not path.is_dir():
        with temporary_folder("file") as scratch:
            partial = scratch / path.name
            yield partial
            path.write_bytes(partial.read_bytes())
        return
    given, path = path, Path(os.path.realpath(path))
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "No such folder", str(path.parent))
    partial = _partial(path)
    try:
        yield partial
        os.replace(partial, path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        _name(error, partial, given)
        raise


@contextmanager
def whole_folder(path: Path, outdated: Collection[str] = ()) -> Iterator[Path]:
    """A new folder to fill, moved to its place when the block ends without an error.

    Args:
        path: where it will appear; a link is followed. Of an older folder there, files of the same
            names are replaced and all others are kept. Its parent is created.
        outdated: names of files and folders of the older folder that are not kept.

    Yields:
        The folder to write into.

    Raises:
        OSError: if it cannot be written; nothing is left behind.
    """
    refuse_url(path)
    given, path = path, Path(os.path.realpath(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = _partial(path)
    try:
        partial.mkdir()
        yield partial
        _move_folder(partial, path, outdated)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        _name(error, partial, given)
        raise


@contextmanager
def temporary_folder(purpose: str) -> Iterator[Path]:
    """A folder for files of this process alone, removed when the block ends.

    What processes that were killed left of theirs goes when the next one asks for its first.

    Args:
        purpose: a word for its name.

    Yields:
        The folder, below that for temporary files (``TMPDIR``).

    Raises:
        OSError: if it cannot be made.
    """
    home = Path(tempfile.gettempdir())
    if home / "graphrqi" not in _looked_after:
        _looked_after.add(home / "graphrqi")
        remove_temporary()
    own = f"{_HERE}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    folder = home / f"graphrqi-{purpose}-{own}"
    with _making:
        folder.mkdir(mode=0o700)
        _temporary.add(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _temporary.discard(folder)


def remove_temporary() -> None:
    """Remove the temporary folders of processes that were killed."""
    _remove_orphans(Path(tempfile.gettempdir()), _SCRATCH)


def end_without_temporary(code: int) -> NoReturn:
    """End this process at once, from any thread, and leave none of its temporary folders.

    Other threads may be writing into them; whatever a folder still gets goes with it.

    Args:
        code: exit code.
    """
    try:
        _making.acquire()  # for good: no other thread makes a folder any more
        remove_temporary()
        end = time.monotonic() + LONGEST_REMOVAL_S
        for folder in list(_temporary):
            match = _SCRATCH.fullmatch(folder.name)
            # A fork's list begins with the folders of the process that it was forked from.
            own = match is not None and int(match[1]) == os.getpid()
            while own and folder.exists() and time.monotonic() < end:
                shutil.rmtree(folder, ignore_errors=True)
    finally:
        os._exit(code)


def _move_folder(partial: Path, path: Path, outdated: Collection[str]) -> None:
    """Put a folder in its place, also while other processes write the same place."""
    while True:
        try:
            os.replace(partial, path)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            _keep_others(path, partial, outdated)
            old = _partial(path)
            with suppress(FileNotFoundError):
                os.replace(path, old)
                shutil.rmtree(old)
        else:
            return


def _keep_others(old: Path, new: Path, outdated: Collection[str]) -> None:
    """Link into a new folder what only the old one has, so that it stays when the old one goes."""
    with suppress(FileNotFoundError):  # another process has just replaced the old folder
        for child in old.iterdir():
            target = new / child.name
            if child.name in outdated or os.path.lexists(target):
                continue
            if child.is_dir() and not child.is_symlink():
                shutil.copytree(child, target, symlinks=True, copy_function=_link)
            else:
                _link(child, target)


def _link(source: str | Path, target: str | Path) -> None:
    """A second name of a file, or a copy where the file system has no second names."""
    try:
        os.link(source, target, follow_symlinks=False)
    except FileNotFoundError:
        raise
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


def remove_partial(folder: Path) -> int:
    """Remove what earlier, killed writers left unfinished directly in a folder.

    Args:
        folder: where to look; it may be missing.

    Returns:
        How many leftovers were removed.
    """
    if not folder.is_dir():
        return 0
    leftovers = sorted(folder.glob(f"{PARTIAL_PREFIX}*"))
    for leftover in leftovers:
        _remove(leftover)
    return len(leftovers)
