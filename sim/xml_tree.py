"""XML files as trees; document types and entities, which can stand for any text, are refused."""

from __future__ import annotations

import gc
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from sim.input_files import read_bytes

DECLARED: Final = re.compile(rb"<!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
"""A declaration of a document type or an entity."""


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
