"""Small TOML files: populations, behaviours and configurations."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError

MOST_BYTES: Final = 1_000_000
"""Larger files are refused (our choice: they are some thousand bytes)."""


def read_toml(path: Path) -> dict[str, Any]:
    """What a TOML file says.

    Raises:
        InputError: if it is missing, too large or no TOML; the message names it.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise InputError(f"{path}: found more than {MOST_BYTES} bytes, expected fewer")
        return tomllib.loads(data.decode("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}, expected a TOML file") from None
    except InputError:
        raise
    except (ValueError, RecursionError) as error:  # of what no TOML says, too deep, too long
        raise InputError(f"{path}: {' '.join(str(error).split()):.200}") from None
