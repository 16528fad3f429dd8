"""Files that other programs wrote: unpacked where gzipped, one line where broken; XML as trees."""

from __future__ import annotations

import functools
import gc
import gzip
import re
import xml.etree.ElementTree as ET
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
        raise InputError(f"{path}: {said}") from error
    except Exception as error:
        said = " ".join(str(error).split())
        if isinstance(error, KeyError):
            said = f"no {said}" if " " not in said else said
        elif isinstance(error, IndexError):
            said = "a number of a part that is not there"
        elif isinstance(error, TypeError | AttributeError) or not said:
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
    """A file's name without its ending, and without that of a packed file."""
    return Path(plain_name(path)).stem


def plain_name(path: Path) -> str:
    """A file's name as if it were not packed."""
    return path.name[: -len(PACKED)] if path.suffix.lower() == PACKED else path.name


def beside(path: Path, name: str) -> Path | None:
    """The file of this name, or of this name packed, in a file's folder; None without one."""
    files = (path.with_name(name), path.with_name(name + PACKED))
    return next((file for file in files if file.is_file() and file != path), None)


def read_once(read: Callable[Concatenate[Path, P], T]) -> Callable[Concatenate[Path, P], T]:
    """A reader of maps, with options that hash, that reads a file once while it stays as it is."""

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


DECLARED: Final = re.compile(rb"<!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
"""A declaration of a document type or an entity, which can stand for any text."""


def refuse_declarations(path: Path, data: bytes) -> None:
    """Refuse XML that declares a document type or an entity, in any encoding."""
    if DECLARED.search(data) or DECLARED.search(data.replace(b"\0", b"")):
        raise InputError(f"{path}: found a document type or entity declaration, expected none")


def read_tree(path: Path) -> ET.Element:
    """The root element of an XML file, gzipped where its name ends in ``.gz``."""
    data = read_bytes(path)
    refuse_declarations(path, data)
    try:
        with without_collection():
            return ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}, expected XML") from None


@contextmanager
def without_collection() -> Iterator[None]:
    """No garbage collection: a tree in use is all alive; searching it takes half the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
