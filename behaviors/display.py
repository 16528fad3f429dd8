"""How values show themselves: HTML tables for notebooks, and pandas where it is installed."""

from __future__ import annotations

import html
import importlib
from collections.abc import Iterable, Sequence
from typing import Any

from behaviors.errors import InputError


def html_table(caption: str, header: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A small table as HTML, every cell escaped.

    Examples:
        >>> html_table("two < three", ["n"], [[2]])
        '<table><caption>two &lt; three</caption><tr><th>n</th></tr><tr><td>2</td></tr></table>'
    """
    lines = [("th", header), *(("td", row) for row in rows)]
    cells = (
        "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in line) for tag, line in lines
    )
    body = "".join(f"<tr>{line}</tr>" for line in cells)
    return f"<table><caption>{html.escape(caption)}</caption>{body}</table>"


def printable(text: str) -> str:
    r"""Text that does nothing to a terminal: what is not printable is spelt as an escape.

    Ids and file names come from outside. Raw, their control characters could clear the screen, or
    begin a line that looks like a program's own.

    Examples:
        >>> printable("car\x1b[2J\n7 done")
        'car\\x1b[2J\\n7 done'
    """
    if text.isprintable():
        return text
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


def import_pandas() -> Any:
    """The pandas module, loaded when a table is first asked for.

    Raises:
        InputError: if pandas is not installed.
    """
    try:
        return importlib.import_module("pandas")
    except ImportError:
        raise InputError("pandas: found none, expected it installed: pip install pandas") from None
