"""Files that may be gzipped, and those that lie beside them."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, cast

from behaviors.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from _typeshed import WriteableBuffer

SUFFIX: Final = ".gz"
"""How the names of packed files end."""

MAX_RATIO: Final = 200
"""Most bytes that a packed file may unpack to for each of its own (recordings have up to 30, the
algorithm's limit is 1032)."""

FREE_BYTES: Final = 2**26
"""Bytes that any file may unpack to, however small it is (64 MiB)."""

BROKEN: Final = (EOFError, zlib.error, gzip.BadGzipFile)
"""What reading a file that is not packed as its name says raises."""


def lines_of(path: Path, file: IO[bytes], most: int) -> Iterator[tuple[int, bytes]]:
    """The lines of a file and their numbers, from 1.

    Args:
        path: for messages.
        file: open for reading.
        most: longest line, bytes.

    Raises:
        InputError: if a line is longer.
    """
    for number, line in enumerate(iter(lambda: file.readline(most), b""), 1):
        if len(line) == most and line[-1:] != b"\n":
            raise InputError(f"{path}: line {number}: found {most} bytes or more, expected fewer")
        yield number, line


def opened(path: Path) -> IO[bytes]:
    """A file to read, unpacked where its name ends in ``.gz``.

    Reading a packed file raises InputError once it has given more than `MAX_RATIO` times its own
    bytes, or what `BROKEN` names if it is damaged.
    """
    if path.suffix.lower() == SUFFIX:
        return cast("IO[bytes]", io.BufferedReader(_Unpacked(path), 2**16))
    return path.open("rb")


class _Unpacked(io.RawIOBase):
    """What a packed file holds, as long as that is in proportion to its size."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._most = max(FREE_BYTES, MAX_RATIO * path.stat().st_size)
        self._given = 0
        self._file = gzip.open(path)  # noqa: SIM115  closed by `close`

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        size = self._file.readinto(buffer)
        self._given += size
        if self._given > self._most:
            raise InputError(f"{self._path}: found more than {self._most} bytes inside")
        return size

    def close(self) -> None:
        self._file.close()
        super().close()


def stem(path: Path) -> str:
    """A file's name without its ending.

    Examples:
        >>> stem(Path("vehicle_tracks_000.csv.gz"))
        'vehicle_tracks_000'
    """
    return Path(plain_name(path)).stem


def plain_name(path: Path) -> str:
    """A file's name as if it were not packed."""
    return path.name[: -len(SUFFIX)] if path.suffix.lower() == SUFFIX else path.name


def beside(path: Path, name: str) -> Path | None:
    """The file of this name, or of this name packed, in a file's folder; None without one.

    Args:
        path: the file.
        name: what the other is called, not packed.
    """
    files = (path.with_name(name), path.with_name(name + SUFFIX))
    return next((file for file in files if file.is_file() and file != path), None)
