"""Recordings that are read from, and exports that are written to, the URL of an object store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from behaviors.errors import InputError
from sim.files import Place, is_remote, local_path, place_of, temporary_folder


@contextmanager
def fetched(source: Path) -> Iterator[Path]:
    """Files to read: those of this machine as they are, those of an object store as copies.

    Args:
        source: a file or folder, or the URL of one.

    Yields:
        The file or folder, with the same name.

    Raises:
        InputError: if there is nothing at a URL.
    """
    if not is_remote(source):
        yield local_path(source)
        return
    home = place_of(source.parent)
    with temporary_folder("fetched") as scratch:
        copy = scratch / source.name
        if home.size(source.name) is not None:
            copy.write_bytes(home.read(source.name))
        else:
            place = place_of(source)
            for name in place.files():
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                (copy / name).write_bytes(place.read(name))
        if not copy.exists():
            raise InputError(f"{place_of(source).url}: found nothing there")
        yield copy


@contextmanager
def new_output(out: Path) -> Iterator[Path]:
    """A folder to fill: that of this machine, or one whose files go to an object store at the end.

    Args:
        out: a folder, or the URL of a new or empty one.

    Yields:
        The folder to write into.

    Raises:
        InputError: if something is at the URL.
        OSError: if a file cannot be sent.
    """
    if not is_remote(out):
        yield local_path(out)
        return
    target = place_of(out)
    found = next(iter(target.files()), None)
    if found is not None:
        raise InputError(f"{target.url}: found {found} there, expected a new or empty folder")
    with temporary_folder("out") as scratch:
        folder = scratch / out.name
        folder.mkdir()
        yield folder
        for name in Place(str(folder)).files():
            target.put(folder / name, name)
