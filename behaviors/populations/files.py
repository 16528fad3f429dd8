"""Files of populations: reading them, and those that ship."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError, lookup
from behaviors.populations.population import Population, population_of

SHIPPED_FOLDER: Final = Path(__file__).with_name("shipped")

MOST_BYTES: Final = 1_000_000
"""Larger files are refused (our choice: a population is some thousand bytes)."""

POPULATIONS: Final = {path.stem: path for path in sorted(SHIPPED_FOLDER.glob("*.toml"))}
"""The files that ship, by name."""


def read_population(source: str | Path | Mapping[str, Any] | Population) -> Population:
    """A population by the name of one that ships, from a file, or from a table.

    Args:
        source: a key of `POPULATIONS`; the path of a TOML file, which has a dot or a slash in it;
            or what such a file says.

    Raises:
        InputError: if the population or file is missing or broken; the message names the file and
            the key.

    Examples:
        >>> read_population("profiles").log_spread.tolist()
        [0.15, 0.15, 0.15, 0.15, 0.15]
    """
    if isinstance(source, Population):
        return source
    if isinstance(source, Mapping):
        try:
            return population_of(source)
        except InputError as error:
            raise InputError(f"population: {error}") from None
    if not isinstance(source, (str, Path)) or not str(source):
        raise InputError(f"population: found {source!r:.60}, expected a name or a file")
    text = str(source)
    path = Path(source)
    if isinstance(source, str) and not any(mark in text for mark in "./\\"):
        path = lookup(POPULATIONS, text, "population")
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise InputError(f"found more than {MOST_BYTES} bytes, expected a population")
        return population_of(tomllib.loads(data.decode("utf-8")))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}, expected a population's file") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ValueError, RecursionError) as error:  # of what no TOML says, too deep, too long
        raise InputError(f"{path}: {' '.join(str(error).split()):.200}") from None
