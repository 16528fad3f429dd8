"""Where a dataset lies: a folder, or a URL of an object store as fsspec has it.

A URL such as ``s3://bucket/data`` may be given wherever the folder of a dataset is. Paths keep it
with one slash less (``s3:/bucket/data``), which is understood too. Credentials are those of the
store's usual environment variables and files.

References:
    fsspec (2024), Filesystem interfaces for Python: https://filesystem-spec.readthedocs.io.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, TypeVar, cast

from behaviors.errors import InputError
from sim.store.atomic import URL, temporary_folder, whole_file, write_whole

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

T = TypeVar("T")

CHUNK_BYTES: Final = 2**20
"""How much of a file is hashed or copied at once."""


def user_cache() -> Path:
    """The user's folder on this machine for what can be made again (``XDG_CACHE_HOME``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "graphrqi"


class Place(Protocol):
    """A folder of files, on a disk or in an object store. Names are relative, with slashes."""

    @property
    def url(self) -> str:
        """What people call it."""

    @property
    def path(self) -> Path:
        """The same as a path; of a URL, one that `place_of` understands."""

    def exists(self) -> bool:
        """Whether there is anything."""

    def size(self, name: str) -> int | None:
        """Bytes of a file; None where there is none."""

    def read(self, name: str, begin: int = 0, end: int | None = None) -> bytes:
        """A file's bytes from ``begin`` to ``end``.

        Raises:
            FileNotFoundError: if there is no such file.
        """

    def pieces(self, name: str) -> Iterator[bytes]:
        """A file's bytes, `CHUNK_BYTES` at a time.

        Raises:
            FileNotFoundError: if there is no such file.
            OSError: if it cannot be read.
        """

    def files(self, prefix: str = "") -> Iterator[str]:
        """Names of the files below a folder, sorted; unfinished and hidden ones are left out."""

    def write(self, name: str, data: bytes) -> None:
        """Write a file, which appears whole or not at all."""

    def put(self, file: Path, name: str) -> None:
        """Move a finished file of this machine here, where it appears whole or not at all."""

    def remove(self, name: str) -> None:
        """Remove a file, and the folders that it leaves empty."""


class Folder:
    """A folder of this machine."""

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def url(self) -> str:
        """What people call it."""
        return str(self._path)

    @property
    def path(self) -> Path:
        """The same as a path."""
        return self._path

    def exists(self) -> bool:
        """Whether there is anything."""
        return self._path.exists()

    def size(self, name: str) -> int | None:
        """Bytes of a file; None where there is none."""
        path = self._path / name
        return path.stat().st_size if path.is_file() else None

    def read(self, name: str, begin: int = 0, end: int | None = None) -> bytes:
        """A part of a file's bytes."""
        with (self._path / name).open("rb") as file:
            file.seek(begin)
            return file.read() if end is None else file.read(max(0, end - begin))

    def pieces(self, name: str) -> Iterator[bytes]:
        """A file's bytes, `CHUNK_BYTES` at a time."""
        with (self._path / name).open("rb") as file:
            while piece := file.read(CHUNK_BYTES):
                yield piece

    def files(self, prefix: str = "") -> Iterator[str]:
        """Names of the files below a folder, sorted."""
        for folder, folders, names in os.walk(self._path / prefix):
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            for name in sorted(names):
                if not name.startswith("."):
                    yield (Path(folder) / name).relative_to(self._path).as_posix()

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole or not at all."""
        path = self._path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data)

    def put(self, file: Path, name: str) -> None:
        """Move a finished file of this machine here."""
        path = self._path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.replace(file, path)
        except OSError:  # another disk
            with whole_file(path) as partial:
                shutil.copyfile(file, partial)
            file.unlink()

    def remove(self, name: str) -> None:
        """Remove a file, and the folders that it leaves empty."""
        path = self._path / name
        path.unlink(missing_ok=True)
        for folder in path.relative_to(self._path).parents[:-1]:
            try:
                (self._path / folder).rmdir()
            except OSError:  # not empty, or gone
                return


class Store:
    """A folder of an object store, by its URL."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._root = _without_protocol(url)

    @property
    def url(self) -> str:
        """What people call it."""
        return self._url

    @property
    def path(self) -> Path:
        """The same as a path."""
        return Path(self._url)

    @property
    def filesystem(self) -> AbstractFileSystem:
        """fsspec's, made once per process."""
        return _filesystem(self._url.partition("://")[0], os.getpid())

    def _full(self, name: str) -> str:
        return f"{self._root}/{name}" if name else self._root

    def _tried(self, call: Callable[[], T], name: str = "") -> T:
        try:
            return call()
        except FileNotFoundError:
            raise FileNotFoundError(2, "No such file", self._called(name)) from None
        except PermissionError as error:
            raise PermissionError(13, f"{error!s:.200}", self._called(name)) from None
        except InputError:
            raise
        except Exception as error:  # stores' clients have their own errors, of no common class
            raise OSError(5, f"{error!s:.200}".replace("\n", " "), self._called(name)) from error

    def _called(self, name: str) -> str:
        return f"{self._url}/{name}" if name else self._url

    def exists(self) -> bool:
        """Whether there is anything."""
        return next(self.files(), None) is not None

    def size(self, name: str) -> int | None:
        """Bytes of a file; None where there is none."""
        try:
            found = self._tried(lambda: self.filesystem.info(self._full(name)), name)
        except FileNotFoundError:
            return None
        return int(found["size"]) if found["type"] == "file" else None

    def read(self, name: str, begin: int = 0, end: int | None = None) -> bytes:
        """A part of a file's bytes."""
        if end is not None and end <= begin:
            return b""
        return cast(
            bytes,
            self._tried(
                lambda: self.filesystem.cat_file(self._full(name), start=begin or None, end=end),
                name,
            ),
        )

    def pieces(self, name: str) -> Iterator[bytes]:
        """A file's bytes, `CHUNK_BYTES` at a time."""
        with self._tried(lambda: self.filesystem.open(self._full(name)), name) as file:
            while piece := self._tried(lambda: file.read(CHUNK_BYTES), name):
                yield piece

    def files(self, prefix: str = "") -> Iterator[str]:
        """Names of the files below a folder, sorted."""
        self.filesystem.invalidate_cache()
        try:
            found = self._tried(lambda: self.filesystem.find(self._full(prefix)), prefix)
        except FileNotFoundError:
            return
        begin = len(self._root.strip("/")) + 1
        for name in sorted(str(full).strip("/")[begin:] for full in found):
            if name and not any(part.startswith(".") for part in name.split("/")):
                yield name

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole or not at all."""
        self._tried(lambda: self.filesystem.pipe_file(self._full(name), data), name)

    def put(self, file: Path, name: str) -> None:
        """Move a finished file of this machine here."""
        self._tried(lambda: self.filesystem.put_file(str(file), self._full(name)), name)
        file.unlink()

    def remove(self, name: str) -> None:
        """Remove a file, and the folders that it leaves empty."""
        try:
            self._tried(lambda: self.filesystem.rm_file(self._full(name)), name)
        except FileNotFoundError:
            return


def _without_protocol(url: str) -> str:
    return url.partition("://")[2].rstrip("/")


@cache
def _filesystem(protocol: str, process: int) -> AbstractFileSystem:
    """The client of a protocol in a process: a forked one cannot use that of its parent."""
    try:
        import fsspec
    except ImportError:
        raise InputError(
            f"{protocol}://: found no fsspec, expected it: pip install 'graphrqi[store]'"
        ) from None
    try:
        # no listings are kept: other machines write, too
        return fsspec.filesystem(protocol, use_listings_cache=False)
    except ImportError as error:
        raise InputError(f"{protocol}://: {error}") from None
    except ValueError:
        known = "s3, gs, file, memory or another of fsspec's"
        raise InputError(f"{protocol}://: found an unknown protocol, expected {known}") from None


def url_of(path: str | Path) -> str | None:
    """The URL that a path stands for; None for one of this machine.

    Args:
        path: as a user gave it, or as `pathlib` made of it.

    Examples:
        >>> from pathlib import Path
        >>> url_of(Path("s3://bucket/data")), url_of("data"), url_of("file:///data")
        ('s3://bucket/data', None, None)
    """
    found = URL.match(str(path))
    if found is None or found[1] in ("file", "local"):
        return None
    return f"{found[1]}://{found[2]}"


def local_path(path: str | Path) -> Path:
    """A path of this machine, also where it was given as a ``file://`` URL.

    Raises:
        InputError: if it is the URL of something else.

    Examples:
        >>> from pathlib import Path
        >>> str(local_path(Path("file:///data/one")))
        '/data/one'
    """
    url = url_of(path)
    if url is not None:
        raise InputError(f"{url}: found a URL, expected a path of this machine")
    found = URL.match(str(path))
    return Path(path) if found is None else Path("/" + found[2])


def place_of(path: str | Path) -> Place:
    """The place that a path or URL names.

    Args:
        path: of a folder; or a URL that fsspec knows, ``file://`` among them.

    Examples:
        >>> place_of("memory://datasets/one").url
        'memory://datasets/one'
    """
    url = url_of(path)
    return Folder(local_path(path)) if url is None else Store(url.rstrip("/"))


def is_remote(path: str | Path) -> bool:
    """Whether a path is a URL of something that is no folder of this machine."""
    return url_of(path) is not None


def file_checksum(place: Place, name: str) -> str:
    """SHA-256 of a file, which is never in memory as a whole.

    Raises:
        FileNotFoundError: if there is none.
    """
    digest = hashlib.sha256()
    for piece in place.pieces(name):
        digest.update(piece)
    return digest.hexdigest()


@contextmanager
def whole_file_at(path: Path) -> Iterator[Path]:
    """As `sim.store.atomic.whole_file`, but the file may be in an object store."""
    url = url_of(path)
    if url is None:
        with whole_file(local_path(path)) as partial:
            yield partial
        return
    with temporary_folder("file") as scratch:
        file = scratch / path.name
        yield file
        home, _, name = url.rpartition("/")
        Store(home).put(file, name)


def full_name(place: Place, name: str) -> str:
    """A file's name as the place's Arrow filesystem has it."""
    if isinstance(place, Store):
        return f"{_without_protocol(place.url)}/{name}"
    return str(place.path / name)
