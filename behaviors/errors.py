"""The error every user mistake becomes, and the look-up every registry uses."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Final, TypeVar

T = TypeVar("T")

LONGEST: Final = 6000
"""Most characters of a message (our choice: a path, which may have 4096, and what was found)."""


class InputError(ValueError):
    r"""Bad input: one line that names the field or file, what was found and what was expected.

    The middle of a long message is left out, and lines are joined.

    Examples:
        >>> str(InputError("action: found [[0.],\n [0.]]"))
        'action: found [[0.],  [0.]]'
        >>> len(str(InputError("mix: found " + 10**6 * "="))) < LONGEST
        True
    """

    def __init__(self, message: str = "") -> None:
        message = " ".join(message.splitlines())
        if len(message) > LONGEST:
            message = f"{message[: LONGEST // 2]} ... {message[-LONGEST // 3 :]}"
        super().__init__(message)


def lookup(registry: Mapping[str, T], name: str, what: str) -> T:
    """Return ``registry[name]``, or say which name was probably meant.

    ``what`` the registry holds, in the singular ("solver"), is used in the message.

    Raises:
        InputError: if the name is not registered.

    Examples:
        >>> lookup({"eigh": 1, "svd": 2}, "eihg", "solver")
        Traceback (most recent call last):
        ...
        behaviors.errors.InputError: unknown solver 'eihg': did you mean 'eigh'? (eigh, svd)
    """
    if name in registry:
        return registry[name]
    near = difflib.get_close_matches(name, registry, n=1)
    hint = f"did you mean {near[0]!r}? " if near else "expected one of "
    raise InputError(f"unknown {what} {name!r:.80}: {hint}({', '.join(registry)})")
