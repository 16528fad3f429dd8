"""Files that other programs wrote: unpacked where they are gzipped, and one line where broken."""

from __future__ import annotations

import functools
import gzip
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Concatenate, Final, ParamSpec, TypeVar, cast

from behaviors.errors import InputError

P = ParamSpec("P")
T = TypeVar("T")

POINTERS: Final = {
    b"version https://git-lfs.github.com/spec": "a pointer of Git LFS (git lfs pull fetches it)",
    b"/annex/objects/": "a pointer of git-annex (git annex get fetches it)",
    b"../.git/annex/objects/": "a pointer of git-annex (git annex get fetches it)",
}
"""Beginnings of small files that stand for large ones."""

PACKED: Final = ".gz"
"""How the names of packed files end."""


@contextmanager
def broken_as_one_line(path: Path, expected: str) -> Iterator[None]:
    """Turn whatever a broken file raises in the block into an `InputError` that names the file.

    ``expected`` is what the file is expected to be: "a SUMO net". A `MemoryError` stays.
    """
    try:
        yield
    except MemoryError:
        raise
    except InputError as error:
        folder, said = str(path.parent), str(error)
        if path.name in said or (path.parent.name and folder in said):  # the file, or one beside
            raise
        raise InputError(f"{path}: {error}") from error
    except Exception as error:
        said = " ".join(str(error).split())
        if isinstance(error, KeyError):
            said = f"no {said}" if " " not in said else said
        elif isinstance(error, TypeError | AttributeError | IndexError) or not said:
            said = "a value of another kind than its field has"
        raise InputError(f"{path}: found a broken file ({said:.200}), expected {expected}") from (
            error
        )


def opened(path: Path) -> IO[bytes]:
    """A file to read, unpacked where its name ends in ``.gz``."""
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected one")
    with path.open("rb") as file:
        head = file.read(64)
    pointer = next((text for begin, text in POINTERS.items() if head.startswith(begin)), None)
    if pointer:
        raise InputError(f"{path}: found {pointer}, expected the file itself")
    if path.suffix.lower() == PACKED:
        return cast("IO[bytes]", gzip.open(path))
    return path.open("rb")


def read_bytes(path: Path, most: int | None = None) -> bytes:
    """A file's content, unpacked where its name ends in ``.gz``, of at most so many bytes."""
    try:
        with opened(path) as file:
            data = file.read() if most is None else file.read(most + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: {error}, expected a file that gzip unpacks") from None
    if most is not None and len(data) > most:
        raise InputError(f"{path}: found more than {most} bytes inside, expected at most that")
    return data


def stem(path: Path) -> str:
    """A file's name without its ending.

    Examples:
        >>> stem(Path("vehicle_tracks_000.csv.gz"))
        'vehicle_tracks_000'
    """
    return Path(plain_name(path)).stem


def plain_name(path: Path) -> str:
    """A file's name as if it were not packed."""
    return path.name[: -len(PACKED)] if path.suffix.lower() == PACKED else path.name


def beside(path: Path, name: str) -> Path | None:
    """The file of this name, or of this name packed, in a file's folder; None without one."""
    files = (path.with_name(name), path.with_name(name + PACKED))
    return next((file for file in files if file.is_file() and file != path), None)


def read_once(read: Callable[Concatenate[Path, P], T]) -> Callable[Concatenate[Path, P], T]:
    """A reader of maps that reads a file once, as long as the file stays as it is.

    Its options must be such that can be hashed.
    """

    @functools.lru_cache(maxsize=16)
    def kept(path: Path, changed_ns: int, size: int, args: Any, kwargs: Any) -> T:
        return read(path, *args, **dict(kwargs))

    @functools.wraps(read)
    def once(path: Path, *args: P.args, **kwargs: P.kwargs) -> T:
        path = Path(path)  # Python's users also give a text
        if not path.is_file():
            raise InputError(f"{path}: found no file, expected a map")
        stat = path.stat()
        return kept(path.absolute(), stat.st_mtime_ns, stat.st_size, args, tuple(kwargs.items()))

    return cast("Callable[Concatenate[Path, P], T]", once)
