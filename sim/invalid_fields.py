"""What is wrong with a file's or a command's fields, in our words: where, found, expected."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Any, Final

from pydantic import ValidationError

from behaviors.errors import InputError

MAX_SHOWN: Final = 60
"""Most characters that are shown of a wrong value (the message stays one line)."""

_BOUNDS: Final = {
    "greater_than_equal": ("ge", "at least"),
    "greater_than": ("gt", "more than"),
    "less_than_equal": ("le", "at most"),
    "less_than": ("lt", "less than"),
}
"""pydantic's types of error for numbers out of bounds: the bound's name, and how it is said."""

_ALTERNATIVE: Final = re.compile(r"str|float|int|bool|(dict|list|tuple)\[.*\]")
"""What pydantic puts into the place of a field that may be of several types."""


def first_wrong_field(error: ValidationError, known: Iterable[str] = ()) -> str:
    """The first thing that is wrong, as "where: found this, expected that".

    Args:
        error: what pydantic says.
        known: the names of the fields that there are, to suggest the nearest to an unknown one.

    Returns:
        One line without pydantic's own words.

    Examples:
        >>> from pydantic import BaseModel, ConfigDict, Field
        >>> class Config(BaseModel):
        ...     model_config = ConfigDict(extra="forbid")
        ...     episodes: int = Field(ge=1)
        >>> def wrong(**given):
        ...     try:
        ...         Config(**given)
        ...     except ValidationError as error:
        ...         return first_wrong_field(error, Config.model_fields)
        >>> wrong(episodes=0)
        'episodes: found 0, expected at least 1'
        >>> wrong(episodes=1, episode=2)
        "episode: found an unknown key, did you mean 'episodes'?"
        >>> wrong()
        'episodes: found none, expected one'
        >>> class Mixed(BaseModel):
        ...     model_config = ConfigDict(strict=True)
        ...     mix: str | dict[str, float]
        >>> try:
        ...     Mixed(mix={"timid": "1"})
        ... except ValidationError as error:
        ...     first_wrong_field(error)
        "mix.timid: found '1', expected a valid number"
    """
    told = error.errors(include_url=False)
    same = [one for one in told if one["loc"][:1] == told[0]["loc"][:1]]
    first = max(same, key=lambda one: len(one["loc"]))  # of alternatives, the one that came nearest
    places = [str(part) for part in first["loc"]]
    where = ".".join(part for part in places if not _ALTERNATIVE.fullmatch(part))[:200]
    said = _said(dict(first), list(known))
    return f"{where}: {said}" if where else said


def _said(first: dict[str, Any], known: list[str]) -> str:
    kind, context, message = first["type"], first.get("ctx", {}), " ".join(first["msg"].split())
    cause = context.get("error")
    if isinstance(cause, InputError) or message.startswith("found "):
        return message if cause is None else str(cause)
    if kind == "extra_forbidden":
        name = str(first["loc"][-1])
        near = difflib.get_close_matches(name, known, n=1) if len(first["loc"]) == 1 else []
        if near:
            return f"found an unknown key, did you mean {near[0]!r}?"
        among = f"one of {', '.join(known)}" if known and len(first["loc"]) == 1 else "no such key"
        return f"found an unknown key, expected {among}"
    if kind == "missing":
        return "found none, expected one"
    if kind == "json_invalid":
        return f"found no JSON ({cause}), expected it"
    if kind in _BOUNDS:
        bound, words = _BOUNDS[kind]
        return f"found {_shown(first['input'])}, expected {words} {context[bound]:g}"
    if kind == "too_short":
        least = context["min_length"]
        return f"found {_shown(first['input'])}, expected {least} or more entries"
    expected = message.removeprefix("Input should be ").removeprefix("Value error, ")
    expected = expected.partition(", ")[0] if "unable to parse" in expected else expected
    return f"found {_shown(first['input'])}, expected {expected}"


def _shown(value: object) -> str:
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python spells no number of more than 4300 digits
        return "a number of thousands of digits"
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."
