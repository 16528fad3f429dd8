"""Files that may be gzipped, and those that lie beside them."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import IO, Final, cast

SUFFIX: Final = ".gz"
"""How the names of packed files end."""

BROKEN: Final = (EOFError, zlib.error, gzip.BadGzipFile)
"""What reading a file that is not packed as its name says raises."""


def opened(path: Path) -> IO[bytes]:
    """A file to read, unpacked where its name ends in ``.gz``."""
    if path.suffix.lower() == SUFFIX:
        return cast("IO[bytes]", gzip.open(path))
    return path.open("rb")


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
