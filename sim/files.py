"""Files and folders that appear as a whole or not at all, on this machine or at a URL.

Everything is written under a hidden name beside its destination and moved there with `os.replace`.
A reader never sees a partial file, even after a run was killed. A URL such as ``s3://bucket/data``
may be given instead of a path, if fsspec knows its protocol.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, cast

from behaviors.errors import InputError

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

PARTIAL_PREFIX: Final = ".partial-"
"""How the hidden name of everything unfinished begins."""

_URL: Final = re.compile(r"^([a-z][a-z0-9+.-]+):/{1,3}(?!/)(.*)$", re.DOTALL)
"""A URL, also after a path has taken one of its slashes away."""


def url_of(path: str | Path) -> str | None:
    """The URL that a path stands for, also with one slash less; None for a path of this machine.

    Examples:
        >>> url_of(Path("s3://bucket/data")), url_of("data"), url_of("file:///data")
        ('s3://bucket/data', None, None)
    """
    found = _URL.match(str(path))
    if found is None or found[1] in ("file", "local"):
        return None
    return f"{found[1]}://{found[2].rstrip('/')}"


def is_remote(path: str | Path) -> bool:
    """Whether a path is a URL of a folder on another machine."""
    return url_of(path) is not None


def local_path(path: str | Path) -> Path:
    """A path of this machine, also where it was given as a ``file://`` URL."""
    url = url_of(path)
    if url is not None:
        raise InputError(f"{url}: found a URL, expected a path of this machine here")
    found = _URL.match(str(path))
    return Path(path) if found is None else Path("/" + found[2])


def user_cache() -> Path:
    """The user's folder on this machine for what can be made again (``XDG_CACHE_HOME``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "graphrqi"


@contextmanager
def temporary_folder(purpose: str) -> Iterator[Path]:
    """A folder in that of temporary files (``TMPDIR``), removed at the end; the word names it."""
    prefix = f"graphrqi-{purpose}-"
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it appears as a whole or not at all; see `whole_file`."""
    with whole_file(path) as partial:
        partial.write_bytes(data)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A new file to write, moved to its path or URL when the block ends without an error.

    An older file there is replaced, a link is followed, and a pipe or device is written to. Its
    folder must exist. After an error nothing is left behind.
    """
    url = url_of(path)
    if url is not None or (path.exists() and not path.is_file() and not path.is_dir()):
        with temporary_folder("file") as scratch:
            partial = scratch / path.name
            yield partial
            if url is None:
                path.write_bytes(partial.read_bytes())
            else:
                home, _, name = url.rpartition("/")
                Place(home).put(partial, name)
        return
    target = Path(os.path.realpath(local_path(path)))
    if not target.parent.is_dir():
        raise FileNotFoundError(2, "No such folder", str(target.parent))
    partial = _partial_path(target)
    try:
        yield partial
        os.replace(partial, target)
    except BaseException as error:
        partial.unlink(missing_ok=True)
        _name(error, partial, path)
        raise


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A new folder to fill, moved to its path when the block ends without an error.

    A link is followed. In an older folder, files of the same names are replaced and all others are
    kept. Its parent is created. After an error nothing is left behind.
    """
    target = Path(os.path.realpath(local_path(path)))
    target.parent.mkdir(parents=True, exist_ok=True)
    partial, old = _partial_path(target), _partial_path(target)
    try:
        partial.mkdir()
        yield partial
        if target.is_dir():
            new = os.listdir(partial)
            shutil.copytree(
                target, partial, symlinks=True, dirs_exist_ok=True,
                ignore=lambda folder, names: new if folder == str(target) else (),
            )  # fmt: skip
            os.replace(target, old)
        os.replace(partial, target)
    except BaseException as error:
        _name(error, partial, path)
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """As `whole_folder`, where there is nothing yet."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: found a file, expected a new or empty folder")
    found = next(path.iterdir(), None) if path.is_dir() else None
    if found is not None:
        raise InputError(f"{path}: found {found.name} there, expected a new or empty folder")
    with whole_folder(path) as folder:
        yield folder


def _partial_path(path: Path) -> Path:
    """A new hidden name beside a path, for what is not finished."""
    return path.parent / f"{PARTIAL_PREFIX}{path.name}-{os.getpid()}-{uuid.uuid4().hex[:8]}"


def _name(error: BaseException, partial: Path, path: Path) -> None:
    """Let an error of the system name the path that the user knows, not the hidden one."""
    if not isinstance(error, OSError) or error.errno is None:
        return
    if error.filename is None or str(partial) in str(error.filename):
        error.filename, error.filename2 = str(path), None
    if str(partial) in str(error.strerror) or "Detail: [errno" in str(error.strerror):
        error.strerror = os.strerror(error.errno)


@cache
def _filesystem(protocol: str, process: int) -> AbstractFileSystem:
    """The client of a protocol, made once per process: a forked one cannot use its parent's."""
    import fsspec

    try:
        # no listings are kept: other machines write, too
        return fsspec.filesystem(protocol, use_listings_cache=False)
    except ImportError as error:
        raise InputError(f"{protocol}://: {error}; pip install 'graphrqi[store]'") from None
    except ValueError:
        known = "s3, gs, file, memory or another of fsspec's"
        raise InputError(f"{protocol}://: found an unknown protocol, expected {known}") from None


@contextmanager
def _errors_named(name: str) -> Iterator[None]:
    """In the block, errors of stores' clients, which have no common class, become `OSError`."""
    try:
        yield
    except FileNotFoundError:
        raise FileNotFoundError(2, "No such file", name) from None
    except PermissionError as error:
        raise PermissionError(13, f"{error!s:.200}", name) from None
    except (InputError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise OSError(5, f"{error!s:.200}".replace("\n", " "), name) from error


@dataclass(frozen=True, slots=True)
class Place:
    """A folder of files, on a disk or in an object store. Names are relative, with slashes.

    Attributes:
        url: what people call it: a path, or a URL.
    """

    url: str

    @property
    def path(self) -> Path:
        """The same as a path; of a URL, one that `place_of` understands."""
        return Path(self.url)

    @property
    def remote(self) -> bool:
        """Whether it lies on another machine."""
        return "://" in self.url

    @property
    def filesystem(self) -> AbstractFileSystem:
        """File system that reads and writes it."""
        return _filesystem(self.url.partition("://")[0] if self.remote else "file", os.getpid())

    def full(self, name: str = "") -> str:
        """A file's name as the filesystem has it."""
        root = self.url.partition("://")[2] if self.remote else os.path.abspath(self.url)
        return f"{root}/{name}" if name else root

    def _call(self, method: str, name: str, *arguments: Any, **options: Any) -> Any:
        """A method of the file system for a file, whose errors name it as people do."""
        with _errors_named(f"{self.url}/{name}" if name else self.url):
            return getattr(self.filesystem, method)(self.full(name), *arguments, **options)

    def size(self, name: str) -> int | None:
        """Bytes of a file; None where there is none."""
        try:
            found = self._call("info", name)
        except (FileNotFoundError, NotADirectoryError):
            return None
        return int(found["size"]) if found["type"] == "file" else None

    def stamp(self, name: str) -> str:
        """Stamp that changes when a file does."""
        return str(self._call("ukey", name))

    def open(self, name: str) -> IO[bytes]:
        """A file, opened for reading."""
        return cast("IO[bytes]", self._call("open", name, "rb"))

    def for_arrow(self, name: str) -> Any:
        """A file for Arrow to read; its own of this machine, whose threads need no Python."""
        import pyarrow as pa

        return self.open(name) if self.remote else pa.OSFile(self.full(name))

    @property
    def arrow_filesystem(self) -> Any:
        """File system for Arrow's scans; local folders use Arrow's own."""
        from pyarrow.fs import LocalFileSystem

        return self.filesystem if self.remote else LocalFileSystem()

    def read(self, name: str) -> bytes:
        """A file's bytes."""
        return cast(bytes, self._call("cat_file", name))

    def files(self) -> dict[str, int]:
        """Sizes of the files in it, by name, sorted; hidden ones are left out."""
        if not self._call("exists", ""):
            return {}
        found: dict[str, Any] = self._call("find", "", detail=True)
        begin = len(self.full().strip("/")) + 1
        named = {path.strip("/")[begin:]: int(one["size"] or 0) for path, one in found.items()}
        return {
            name: size
            for name, size in sorted(named.items())
            if name and not any(part.startswith(".") for part in name.split("/"))
        }

    def write(self, name: str, data: bytes) -> None:
        """Write a small file, which appears as a whole or not at all."""
        if not self.remote:
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(self.path / name, data)

    def put(self, file: Path, name: str) -> None:
        """Move a finished file of this machine here, where it appears as a whole or not at all."""
        if self.remote:
            with _errors_named(f"{self.url}/{name}"):
                self.filesystem.put_file(str(file), self.full(name))
            file.unlink()
            return
        target = self.path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, target)

    def checksum(self, name: str) -> str:
        """SHA-256 of a file, which is never in memory as a whole."""
        with _errors_named(f"{self.url}/{name}"), self.open(name) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]


def place_of(path: str | Path) -> Place:
    """The place that the path or URL of a folder names."""
    return Place(url_of(path) or str(local_path(path)))
