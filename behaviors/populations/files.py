"""Files of populations: reading them, and those that ship."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError, lookup
from behaviors.populations.population import Population, population_of
from behaviors.toml_files import read_toml

SHIPPED_FOLDER: Final = Path(__file__).with_name("shipped")

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
    said = read_toml(path)
    try:
        return population_of(said)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
