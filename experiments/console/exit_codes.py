"""How a program ends when its user asked for what cannot be, or stopped it: one line, no traceback.

Only what every program needs is imported here, so that help appears at once.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NoReturn

from typer.exceptions import TyperException

STOPPED: Final = 130
"""Exit code of a program that Ctrl-C stopped: 128 and the signal's number, as shells have it."""


class Interrupted(Exception):
    """The user stopped a run; the message says how to go on."""


@contextmanager
def one_line() -> Iterator[None]:
    """Turn errors of the user's making into a line on stderr and exit code 2, Ctrl-C into 130.

    Raises:
        SystemExit: instead of an `InputError`, an `OSError` with a reason of the system's, a wrong
            command line, an `Interrupted` or a `KeyboardInterrupt`; whatever else is raised is a
            defect of the program and keeps its traceback.
    """
    try:
        yield
    except (Interrupted, KeyboardInterrupt) as stop:
        _end(str(stop) or "stopped: run the same command again to go on", STOPPED)
    except (TyperException, ValueError, OSError) as error:
        reason = _reason(error)
        if reason is None:
            raise
        _end(f"error: {reason}", 2)


def _end(message: str, code: int) -> NoReturn:
    sys.stderr.write(f"graphrqi: {' '.join(message.split())}\n")
    raise SystemExit(code) from None


def _reason(error: Exception) -> str | None:
    """What the user did wrong; None if it was not the user."""
    from behaviors.errors import InputError

    if isinstance(error, TyperException):
        return error.format_message()
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return None
