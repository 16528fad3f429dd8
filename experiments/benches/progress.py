"""Reads the file in which a long bench keeps what it has found, so that it can go on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from behaviors.errors import InputError

T = TypeVar("T")


def read_progress(path: Path | None, work: str, parse: Callable[[Any], T]) -> T | None:
    """What earlier runs of the same work have found.

    Args:
        path: the file, a JSON object whose ``work`` says of what; None for none.
        work: what is to be done, in words.
        parse: takes the object apart; its errors mean that the file is another one.

    Returns:
        What ``parse`` gives; None where there is no file yet.

    Raises:
        InputError: if the file is no progress, or that of other work.
    """
    if path is None or not path.exists():
        return None
    try:
        told = json.loads(path.read_text())
        found, kept = parse(told), told["work"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: found no progress of a run ({error})") from None
    if kept != work:
        raise InputError(f"{path}: found progress of {kept!r:.200}, expected of {work!r}")
    return found
