"""Formats of recordings that other tools write and read, by name.

A reader yields `Recording`s from one file; a writer puts an episode into a folder. Each lives in
its own file, is loaded when first asked for, and refuses what is broken with one
`behaviors.errors.InputError` that names the file and the line, row or column.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

from behaviors.errors import InputError, lookup

if TYPE_CHECKING:
    from sim.formats.recording import Recording
    from sim.frames import Tracks
    from sim.road import Road

    Reader = Callable[[Path], Iterator[Recording]]
    Writer = Callable[[Path, str, Tracks, Road | None], list[Path]]

HEAD_BYTES: Final = 4096
"""How much of a file is looked at to tell its format."""


@dataclass(frozen=True, slots=True)
class Format:
    """One format.

    Attributes:
        files: patterns of the names of its files.
        head: what the beginning of a file looks like (lower case).
        reader: "module:function", or None where it is only written.
        writer: "module:function", or None where it is only read.
        unit: what its lengths are in: "m", or "px" where there is no scale.
    """

    files: tuple[str, ...]
    head: re.Pattern[bytes]
    reader: str | None = None
    writer: str | None = None
    unit: str = "m"


def _columns(*names: str) -> re.Pattern[bytes]:
    """A first line that has all these columns."""
    every = "".join(rf'(?=[^\n]*(?:^|[,"\s\ufeff]){name}(?:[,"\s]|$))' for name in names)
    return re.compile(rb"^(?:\xef\xbb\xbf)?" + every.replace("\\ufeff", "").encode())


FORMATS: Final[dict[str, Format]] = {
    "argoverse2": Format(
        ("scenario_*.parquet",),
        re.compile(rb"^par1"),
        "sim.formats.argoverse2:read",
        "sim.formats.argoverse2:write",
    ),
    "argoverse1": Format(
        ("*.csv",),
        _columns("timestamp", "track_id", "object_type", "x", "y"),
        "sim.formats.argoverse1:read",
        "sim.formats.argoverse1:write",
    ),
    "ngsim": Format(
        ("*.csv", "*.txt"),
        re.compile(
            _columns("vehicle_id", "local_x", "local_y").pattern
            + rb"|^\s*(?:-?[\d.e+]+[ \t]+){17}-?[\d.e+]+[ \t]*\r?\n"
        ),
        "sim.formats.ngsim:read",
    ),
    "ind": Format(
        ("*_tracks.csv",),
        _columns("trackid", "xcenter", "ycenter", "heading"),
        "sim.formats.levelx:read_ind",
    ),
    "round": Format(
        ("*_tracks.csv",),
        _columns("trackid", "xcenter", "ycenter", "heading"),
        "sim.formats.levelx:read_ind",
    ),
    "highd": Format(
        ("*_tracks.csv",),
        _columns("frame", "id", "width", "height", "xvelocity"),
        "sim.formats.levelx:read_highd",
    ),
    "interaction": Format(
        ("vehicle_tracks_*.csv",),
        _columns("track_id", "timestamp_ms", "agent_type"),
        "sim.formats.interaction:read",
    ),
    "sumo-fcd": Format(
        ("*.xml", "*.xml.gz"),
        re.compile(rb"<fcd-export"),
        "sim.formats.sumo_fcd:read",
        "sim.formats.sumo_fcd:write",
    ),
    "traf": Format(
        ("*.txt",),
        re.compile(rb"^\d+,\d+(?:,-?\d+)*\r?\n"),
        "sim.formats.traf:read",
        unit="px",
    ),
    "argo": Format(
        ("*.csv",),
        re.compile(rb'^(?:\xef\xbb\xbf)?"?frame"?,"?id"?,"?x"?,"?y"?\s*\n'),
        "sim.formats.argo:read",
    ),
    "scenarionet": Format(("*.pkl",), re.compile(rb"(?!)"), writer="sim.formats.scenarionet:write"),
}
"""Every format by name."""


def _loaded(name: str) -> object:
    module, function = name.split(":")
    return getattr(importlib.import_module(module), function)


def get_reader(name: str) -> Reader:
    """The reader of a format.

    Raises:
        InputError: if there is none.
    """
    source = lookup(FORMATS, name, "format").reader
    if source is None:
        raise InputError(f"format {name}: found no reader, expected one that can be read")
    return cast("Reader", _loaded(source))


def get_writer(name: str) -> Writer:
    """The writer of a format.

    Raises:
        InputError: if there is none.
    """
    source = lookup(FORMATS, name, "format").writer
    if source is None:
        able = ", ".join(key for key, entry in FORMATS.items() if entry.writer)
        raise InputError(f"format {name}: found no writer, expected one of {able}")
    return cast("Writer", _loaded(source))


def _head(path: Path) -> bytes:
    if path.suffix == ".gz":
        import gzip

        try:
            with gzip.open(path) as packed:
                return packed.read(HEAD_BYTES).lower()
        except (OSError, EOFError):
            return b""
    with path.open("rb") as file:
        return file.read(HEAD_BYTES).lower()


def _files(path: Path, patterns: tuple[str, ...]) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = {file for pattern in patterns for file in path.rglob(pattern) if file.is_file()}
    return sorted(found)


def recognise(path: Path) -> str:
    """The format of a file, or of the files in a folder, told from their beginnings.

    Args:
        path: a file or a folder.

    Returns:
        A key of ``FORMATS``; ``ind`` for rounD too, which looks the same.

    Raises:
        InputError: if it is none of them.
    """
    if not path.exists():
        raise InputError(f"{path}: found nothing, expected a recording or a folder of recordings")
    for name, entry in FORMATS.items():
        if any(entry.head.search(_head(file)) for file in _files(path, entry.files)[:20]):
            return name
    raise InputError(f"{path}: found no known format, expected one of {', '.join(FORMATS)}")


def read_recordings(
    path: Path, name: str | None = None, types: Path | None = None
) -> Iterator[Recording]:
    """Read a recording, or all recordings of one format in a folder.

    Args:
        path: a file or a folder.
        name: a key of ``FORMATS``; None to tell it from the content.
        types: a SUMO file with the vTypes of ``sumo-fcd`` recordings, for kinds and sizes.

    Yields:
        The recordings, one at a time, in order of the files' names.

    Raises:
        InputError: if a file is broken, or there is none.
    """
    name = name or recognise(path)
    reader = get_reader(name)
    if types is not None:
        if name != "sumo-fcd":
            raise InputError(f"types: found format {name}, expected sumo-fcd: only it needs them")
        reader = partial(cast("Callable[..., Iterator[Recording]]", reader), types=types)
    entry = FORMATS[name]
    if not path.exists():
        raise InputError(f"{path}: found nothing, expected a recording or a folder of recordings")
    files = _files(path, entry.files)
    if path.is_dir():
        files = [file for file in files if entry.head.search(_head(file))]
    if not files:
        raise InputError(f"{path}: found no {name} file ({', '.join(entry.files)})")
    for file in files:
        yield from reader(file)


__all__ = ["FORMATS", "Format", "get_reader", "get_writer", "read_recordings", "recognise"]
