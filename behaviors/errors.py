"""The error every user mistake becomes, and the words in which things show themselves."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar

T = TypeVar("T")

LONGEST: Final = 6000
"""Most characters of a message (our choice: a path, which may have 4096, and what was found)."""


class InputError(ValueError):
    r"""Bad input: one line that names the field or file, what was found and what was expected.

    Lines are joined, and the end of a long message is left out.

    Examples:
        >>> str(InputError("action: found [[0.],\n [0.]]"))
        'action: found [[0.],  [0.]]'
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(" ".join(message.splitlines())[:LONGEST])


def lookup(registry: Mapping[str, T], name: str, what: str) -> T:
    """Return ``registry[name]``, or say in an `InputError` which name was probably meant.

    ``what`` the registry holds, in the singular ("solver"), is used in the message.

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


@contextmanager
def in_file(path: Path | str) -> Iterator[None]:
    """Name a file in the errors about what it says."""
    try:
        yield
    except InputError as error:
        said = str(error)
        raise InputError(said if said.startswith(str(path)) else f"{path}: {said}") from None


def printable(text: str) -> str:
    """Text that does nothing to a terminal: what is not printable is spelt as an escape."""
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in text
    )


def counted(count: int, noun: str) -> str:
    """A count and its noun, in the plural unless the count is 1."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
