"""Small TOML files: populations, behaviours and configurations."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from behaviors.errors import InputError, lookup


def read_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file; an `InputError` names one that is missing or no TOML."""
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}, expected a TOML file") from None
    except (ValueError, RecursionError) as error:  # of what no TOML says, or too deep
        raise InputError(f"{path}: {' '.join(str(error).split()):.200}, expected TOML") from None


def shipped_or_path(source: str | Path, shipped: Mapping[str, Path], what: str) -> Path:
    """The file that ships under a name; a path has a dot or a slash in it."""
    if isinstance(source, Path) or any(mark in source for mark in "./\\"):
        return Path(source)
    return lookup(shipped, source.strip(), what)
