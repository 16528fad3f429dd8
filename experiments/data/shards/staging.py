"""Where episodes are made that end up in another place.

A dataset on this machine is made in its own folder. One in an object store is made in a folder of
this machine, named after its URL, from which whole shards are moved. That folder stays if the run
is killed, so the same command goes on with what is there.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sim.store.places import is_remote, local_path, place_of


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


def staging_folder(out: Path, name: str = "") -> Path:
    """The folder of this machine in which a dataset of an object store is made."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = hashlib.sha256(place_of(out).url.encode()).hexdigest()[:16]
    return home / "graphrqi" / "unfinished" / f"{digest}{name and '-'}{name}"
