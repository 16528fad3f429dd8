"""Where episodes are made that end up in another place.

A dataset on this machine is made in its own folder. One in an object store is made in a folder of
this machine, named after its URL, from which whole shards are moved. That folder stays if the run
is killed, so the same command goes on with what is there.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pydantic import JsonValue

from behaviors.errors import InputError
from sim.store.atomic import temporary_folder
from sim.store.dataset import finished_dataset
from sim.store.places import Folder, Place, is_remote, local_path, place_of, user_cache


@contextmanager
def staged(out: Path, name: str = "") -> Iterator[Path]:
    """The folder in which the episodes of a dataset are made.

    Args:
        out: the dataset, a folder or a URL.
        name: which of several commands that write it this is.

    Yields:
        Its own folder; of a URL, a folder in the cache of this machine (``XDG_CACHE_HOME``, by
        default ``~/.cache``), which is removed when the block ends without an error.
    """
    if not is_remote(out):
        yield local_path(out)
        return
    folder = staging_folder(out, name)
    folder.mkdir(parents=True, exist_ok=True)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


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
    check_empty(target)
    with temporary_folder("out") as scratch:
        folder = scratch / out.name
        folder.mkdir()
        yield folder
        made = Folder(folder)
        for name in list(made.files()):
            target.put(folder / name, name)


def holds(out: Path, configuration: Mapping[str, JsonValue]) -> bool:
    """Whether a place holds a whole dataset of this configuration, whatever its content."""
    found = finished_dataset(out)
    return found is not None and found.header.configuration == configuration


def check_empty(place: Place) -> None:
    """Refuse a place of an object store that holds something.

    Raises:
        InputError: naming the first file.
    """
    if isinstance(place, Folder):
        return
    found = next(place.files(), None)
    if found is not None:
        raise InputError(f"{place.url}: found {found} there, expected a new or empty folder")


def staging_folder(out: Path, name: str = "") -> Path:
    """The folder of this machine in which a dataset of an object store is made."""
    digest = hashlib.sha256(place_of(out).url.encode()).hexdigest()[:16]
    return user_cache() / "unfinished" / f"{digest}{name and '-'}{name}"
