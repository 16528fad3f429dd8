"""One writer per dataset at a time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from behaviors.errors import InputError
from sim.files import Place, user_cache

LOCK: Final = ".lock"
"""Name of the lock file in a dataset's folder; it exists only while a run writes."""


@contextmanager
def sole_writer(place: Place) -> Iterator[None]:
    """Hold a dataset for writing; the operating system releases it when the process ends.

    The lock file of a URL lies in the user's cache: there it holds off this machine's runs only.

    Args:
        place: what to hold; a folder is created if need be, and removed if it stays empty.

    Raises:
        InputError: if another process holds it, or the path is not a folder.
        OSError: if the folder cannot be written.
    """
    from filelock import FileLock, Timeout

    folder = user_cache() / "locks" if place.remote else place.path
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: found a file, expected a folder")
    there = [path for path in (folder, *folder.parents) if path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    name = hashlib.sha256(place.url.encode()).hexdigest()[:16] if place.remote else ""
    file = folder / f"{LOCK}{name}"
    try:
        with FileLock(file, timeout=0):
            try:
                yield
            finally:
                file.unlink(missing_ok=True)
    except Timeout:
        raise InputError(
            f"{place.url}: another run is writing to it; wait for its end or choose another folder"
        ) from None
    finally:
        for path in (folder, *folder.parents):
            if path in there:
                break
            with suppress(OSError):  # it is not empty
                path.rmdir()
