"""Reads TOML: configurations, scenarios and populations that people write."""

from __future__ import annotations

import tomllib
from typing import Any, Final

from behaviors.errors import InputError

MOST: Final = 2**63
"""Whole numbers of TOML have 64 bits; Python's may have so many digits that it spells none."""


def read_toml(text: str) -> dict[str, Any]:
    """What a TOML text says.

    Raises:
        ValueError: if it is none, or has a whole number of more than 64 bits.
        RecursionError: if it is nested too deep.

    Examples:
        >>> read_toml("lanes = 0x10")
        {'lanes': 16}
        >>> read_toml("lanes = [0x10000000000000000]")
        Traceback (most recent call last):
        ...
        behaviors.errors.InputError: lanes: found a whole number of more than 64 bits
    """
    found = tomllib.loads(text)
    for key, value in found.items():
        _check(key, value)
    return found


def _check(key: str, value: Any) -> None:
    if isinstance(value, int) and not -MOST <= value < MOST:
        raise InputError(f"{key:.60}: found a whole number of more than 64 bits")
    if isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            _check(key, inner)
