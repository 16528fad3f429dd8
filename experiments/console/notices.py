"""Messages on stderr: notices of the package's logger, and one line where a program ends early.

Only what every program needs is imported here, so that help appears at once.
"""

from __future__ import annotations

import logging
import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final, NoReturn

LOGGER: Final = logging.getLogger("graphrqi")
"""The package's logger. Its levels: WARNING says what was left out or kept, INFO what takes long,
DEBUG what is read and how long it took."""

STOPPED: Final = 130
"""Exit code of a program that Ctrl-C stopped: 128 plus the signal's number, as in shells."""

STOPPED_WORDS: Final = "stopped: run the same command again"

_URL: Final = re.compile(r"\b(s3|gs|gcs|az|abfs|abfss|memory|hdfs|https?):/(?=[^/\s])")
"""A URL that a path has taken one of its slashes away from."""


def for_terminal(text: str) -> str:
    """A message with nothing raw in it, and URLs with both slashes."""
    from behaviors.errors import printable  # which imports numpy

    return _URL.sub(r"\1://", printable(text))


def say(text: str, err: bool = False) -> None:
    """Print a line about the user's files; nothing in their names reaches the terminal raw."""
    print(for_terminal(text), file=sys.stderr if err else sys.stdout)


class _OnStderr(logging.Handler):
    """Writes to whatever stderr is at that moment."""

    def emit(self, record: logging.LogRecord) -> None:
        sys.stderr.write(f"graphrqi: {for_terminal(record.getMessage())}\n")
        sys.stderr.flush()


def show_notices(quiet: bool = False, verbose: bool = False) -> None:
    """Show messages of the logger from level INFO on: quiet WARNING, and verbose DEBUG."""
    LOGGER.setLevel(logging.DEBUG if verbose else logging.WARNING if quiet else logging.INFO)
    if not any(isinstance(handler, _OnStderr) for handler in LOGGER.handlers):
        LOGGER.addHandler(_OnStderr())


@contextmanager
def called(path: Path, name: Path) -> Iterator[None]:
    """Let messages and errors call a path by another name while the block lasts.

    Commands make a temporary dataset of recordings; users know it by the path that they gave.
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


class Interrupted(Exception):
    """The user stopped a run; the message says how to go on."""


@contextmanager
def exit_on_user_error() -> Iterator[None]:
    """Turn errors that the user made into one line on stderr and exit code 2, Ctrl-C into 130.

    SIGTERM and SIGHUP unwind the program, too, so that what it was writing is cleared away. Any
    other exception is a defect of the program and keeps its traceback.
    """
    from typer.exceptions import TyperException

    if threading.current_thread() is threading.main_thread():
        for one in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(one) is signal.SIG_DFL:  # under nohup SIGHUP is ignored
                signal.signal(one, _unwind)
    try:
        yield
    except (Interrupted, KeyboardInterrupt) as stop:
        _end(str(stop) or STOPPED_WORDS, STOPPED)
    except TyperException as error:
        _end(f"error: {error.format_message()}", 2)
    except (ValueError, OSError) as error:
        from behaviors.errors import InputError

        if isinstance(error, InputError):
            reason = str(error)
        elif isinstance(error, OSError) and error.strerror:
            reason = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
        else:
            raise
        _end(f"error: {reason}", 2)


def _unwind(number: int, frame: FrameType | None) -> NoReturn:
    signal.signal(number, signal.SIG_IGN)  # a second one does not disturb the clearing
    _end(STOPPED_WORDS, 128 + number)


def _end(message: str, code: int) -> NoReturn:
    sys.stderr.write(f"graphrqi: {for_terminal(' '.join(message.split()))}\n")
    raise SystemExit(code) from None
