"""Errors in a file's or a command's fields, in plain words: where, found, expected."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Final

from pydantic import ValidationError

from behaviors.errors import InputError

_ALTERNATIVE: Final = re.compile(r"str|float|int|bool|(dict|list|tuple)\[.*\]")
"""pydantic's location of a field that may be of several types."""

_BOUNDS: Final = {
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "greater than": "more than",
}
"""How pydantic says bounds, and how we do."""


def first_wrong_field(error: ValidationError, known: Iterable[str] = ()) -> str:
    """The first thing that is wrong in one line, "where: found this, expected that".

    The names of the known fields are used to suggest the nearest to an unknown one.

    Examples:
        >>> from pydantic import BaseModel, Field
        >>> class Config(BaseModel):
        ...     episodes: int = Field(ge=1)
        >>> try:
        ...     Config(episodes=0)
        ... except ValidationError as error:
        ...     first_wrong_field(error)
        'episodes: found 0, expected at least 1'
    """
    told = error.errors(include_url=False)
    same = [one for one in told if one["loc"][:1] == told[0]["loc"][:1]]
    first = max(same, key=lambda one: len(one["loc"]))  # of alternatives, the one that came nearest
    places = [str(part) for part in first["loc"]]
    where = ".".join(part for part in places if not _ALTERNATIVE.fullmatch(part))[:200]
    cause, message = first.get("ctx", {}).get("error"), " ".join(first["msg"].split())
    if isinstance(cause, InputError):
        said = str(cause)
    elif first["type"] == "extra_forbidden":
        near = difflib.get_close_matches(places[-1], known, n=1) if len(places) == 1 else []
        among = f"expected one of {', '.join(known)}" if list(known) else "expected no such key"
        said = "found an unknown key, " + (f"did you mean {near[0]!r}?" if near else among)
    elif first["type"] == "missing":
        said = "found none, expected one"
    else:
        expected = message.removeprefix("Input should be ").removeprefix("Value error, ")
        for theirs, ours in _BOUNDS.items():
            expected = expected.replace(theirs, ours)
        said = f"found {_shown(first['input'])}, expected {expected}"
    return f"{where}: {said}" if where else said


def _shown(value: object) -> str:
    """The beginning of a value in one line."""
    try:
        return f"{' '.join(repr(value).split()):.60}"
    except ValueError:  # Python spells no number of more than 4300 digits
        return "a number of thousands of digits"
