"""Recordings that are read from, and exports that are written to, the URL of an object store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from behaviors.errors import InputError
from sim.files import Place, place_of, temporary_folder


@contextmanager
def fetched(source: Path) -> Iterator[Path]:
    """A copy, with the same name, of the file or folder at a URL.

    Raises:
        InputError: if there is nothing at the URL.
    """
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
    """A folder to fill, whose files go to a URL at the end of the block.

    Raises:
        InputError: if something is at the URL.
        OSError: if a file cannot be sent.
    """
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
