"""XML files as trees: what is read whole is bounded in size, and declares nothing of its own.

Document type declarations are refused: an entity can stand for any amount of text. The recordings
that stream (`sim.formats.sumo_fcd`) are parsed element by element instead.
"""

from __future__ import annotations

import gc
import gzip
import re
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from sim.written_numbers import whole

MAX_TREE_BYTES: Final = 2**26
"""Largest XML file that is read as a tree, uncompressed (64 MiB; a scene of 10 s has some 2, a city
district's map some 20)."""

MAX_MARKS: Final = 6_000_000
"""Most ``<`` and ``=`` in such a file: each makes an object of some 100 bytes."""

DECLARED: Final = re.compile(rb"<!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
"""A declaration that XML files of ours never have: an entity can stand for any amount of text."""
_ENCODING: Final = re.compile(rb"""<\?xml[^>]{0,200}?encoding\s*=\s*["']([^"']{1,40})["']""")
_ENCODINGS: Final = (b"utf-8", b"us-ascii", b"ascii", b"iso-8859-1")


def read_tree(path: Path, cut: Callable[[bytes], bytes] | None = None) -> ET.Element:
    """The root element of an XML file.

    Args:
        path: the file, gzipped where its name ends in ``.gz``.
        cut: takes out of the file's bytes what it reads itself, whole elements only.

    Returns:
        The root; elements, attributes and texts as they are in the file.

    Raises:
        InputError: if the file is missing, too large, no XML, or declares a document type.
    """
    data = read_bytes(path)
    if data.count(b"<") + data.count(b"=") > MAX_MARKS:
        raise InputError(f"{path}: found more than {MAX_MARKS} elements and attributes")
    if DECLARED.search(data):
        raise InputError(f"{path}: found a document type or entity declaration, expected none")
    encoding = _ENCODING.match(data.removeprefix(b"\xef\xbb\xbf").lstrip()[:300])
    if b"\0" in data or (encoding and encoding.group(1).lower() not in _ENCODINGS):
        raise InputError(f"{path}: found another encoding, expected UTF-8")
    try:
        with without_collection():
            if cut is not None:
                try:
                    return ET.fromstring(cut(data))
                except ET.ParseError:
                    pass  # the whole file is parsed, so that the message names the place in it
            return ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from None


def whole_number(path: Path, element: ET.Element, name: str) -> int:
    """A whole number in an element's attribute.

    Args:
        path: the file, for messages.
        element: which element.
        name: of the attribute.

    Returns:
        The number, of at most 63 bits.

    Raises:
        InputError: naming the file, the element and the attribute.

    Examples:
        >>> whole_number(Path("a.xml"), ET.fromstring('<node id="7"/>'), "id")
        7
    """
    text = element.get(name)
    where = f"{path}: {element.tag[:40]} {name}"
    try:
        value = whole(text or "")
    except ValueError:
        raise InputError(f"{where}: found {str(text)[:40]!r}, expected a whole number") from None
    if abs(value) >= 2**63:
        raise InputError(f"{where}: found {str(text)[:40]!r}, out of range")
    return value


def read_bytes(path: Path, most: int = MAX_TREE_BYTES) -> bytes:
    """A file's content, unpacked where its name ends in ``.gz``.

    Args:
        path: the file.
        most: bytes that it may have, unpacked.

    Returns:
        What is in it.

    Raises:
        InputError: if the file is missing, larger, or not packed as its name says.
    """
    if not path.is_file():
        raise InputError(f"{path}: found no file, expected one")
    try:
        with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as file:
            data = file.read(most + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: {error}") from None
    if len(data) > most:
        raise InputError(f"{path}: found more than {most} bytes inside, expected at most that")
    return bytes(data)


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
