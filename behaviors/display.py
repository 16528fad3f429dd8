"""How values show themselves in words."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Text that does nothing to a terminal: what is not printable is spelt as an escape.

    Ids and file names come from outside. Raw, their control characters could clear the screen, or
    begin a line that looks like a program's own.

    Examples:
        >>> printable("car\x1b[2J\n7 done")
        'car\\x1b[2J\\n7 done'
    """
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in text
    )


def counted(count: int, noun: str) -> str:
    """A count and its noun, in the plural unless the count is 1.

    Examples:
        >>> counted(1, "frame"), counted(0, "frame")
        ('1 frame', '0 frames')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"
