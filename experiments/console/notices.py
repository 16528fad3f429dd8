"""Progress messages on stderr: those of the package's logger, a line each."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

LOGGER: Final = logging.getLogger("graphrqi")
"""The package's logger. Its levels: WARNING says what was left out or kept, INFO what takes long,
DEBUG what is read and how long it took."""

_URL: Final = re.compile(r"\b(s3|gs|gcs|az|abfs|abfss|memory|hdfs|https?):/(?=[^/\s])")
"""A URL that a path has taken one of its slashes away from."""


def for_terminal(text: str) -> str:
    """A message with nothing raw in it, and URLs with both slashes."""
    from behaviors.display import printable  # which imports numpy

    return _URL.sub(r"\1://", printable(text))


class _OnStderr(logging.Handler):
    """Writes to whatever stderr is at that moment."""

    def emit(self, record: logging.LogRecord) -> None:
        sys.stderr.write(f"graphrqi: {for_terminal(record.getMessage())}\n")
        sys.stderr.flush()


def say(text: str, err: bool = False) -> None:
    """Print a line about the user's files; nothing in their names reaches the terminal raw.

    Args:
        text: the line.
        err: whether it goes to stderr.
    """
    print(for_terminal(text), file=sys.stderr if err else sys.stdout)


def show_notices(quiet: bool = False, verbose: bool = False) -> None:
    """Show messages of the logger "graphrqi", by default from level INFO on.

    Args:
        quiet: show warnings and errors only.
        verbose: show messages of level DEBUG, too.
    """
    LOGGER.setLevel(logging.DEBUG if verbose else logging.WARNING if quiet else logging.INFO)
    if not any(isinstance(handler, _OnStderr) for handler in LOGGER.handlers):
        LOGGER.addHandler(_OnStderr())


@contextmanager
def called(path: Path, name: Path) -> Iterator[None]:
    """Let messages and errors call a path by another name while the block lasts.

    Commands make a temporary dataset of recordings; users know it by the path that they gave.

    Args:
        path: what messages would say.
        name: what they say instead.

    Raises:
        InputError: one of the block, with the path replaced.
    """
    from behaviors.errors import InputError

    def renamed(record: logging.LogRecord) -> bool:
        record.msg, record.args = record.getMessage().replace(str(path), str(name)), ()
        return True

    LOGGER.addFilter(renamed)
    try:
        yield
    except InputError as error:
        if str(path) not in str(error):
            raise
        raise type(error)(str(error).replace(str(path), str(name))) from error
    finally:
        LOGGER.removeFilter(renamed)
