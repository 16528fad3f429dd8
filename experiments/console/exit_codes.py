"""A program that fails because of its input, or is stopped, says why in one line and exits.

Only what every program needs is imported here, so that help appears at once.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, NoReturn

from typer.exceptions import TyperException

STOPPED: Final = 130
"""Exit code of a program that Ctrl-C stopped: 128 plus the signal's number, as in shells."""

STOPPED_WORDS: Final = "stopped: run the same command again to go on"


class Interrupted(Exception):
    """The user stopped a run; the message says how to go on."""


@contextmanager
def exit_on_user_error() -> Iterator[None]:
    """Turn errors that the user made into one line on stderr and exit code 2, Ctrl-C into 130.

    SIGTERM and SIGHUP unwind the program, too, so that what it was writing is cleared away.

    Raises:
        SystemExit: instead of an `InputError`, an `OSError` with a reason given by the system, a
            wrong command line, an `Interrupted`, a `KeyboardInterrupt` or a signal. Any other
            exception is a defect of the program and keeps its traceback.
    """
    if threading.current_thread() is threading.main_thread():
        for one in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(one) is signal.SIG_DFL:  # under nohup SIGHUP is ignored
                signal.signal(one, _unwind)
    try:
        yield
    except (Interrupted, KeyboardInterrupt) as stop:
        _end(str(stop) or STOPPED_WORDS, STOPPED)
    except (TyperException, ValueError, OSError) as error:
        reason = _reason(error)
        if reason is None:
            raise
        _end(f"error: {reason}", 2)


def _unwind(number: int, frame: FrameType | None) -> NoReturn:
    signal.signal(number, signal.SIG_IGN)  # a second one does not disturb the clearing
    _end(STOPPED_WORDS, 128 + number)


def _end(message: str, code: int) -> NoReturn:
    from experiments.console.notices import for_terminal

    sys.stderr.write(f"graphrqi: {for_terminal(' '.join(message.split()))}\n")
    raise SystemExit(code) from None


def _reason(error: Exception) -> str | None:
    """The user's mistake in words; None if the program is to blame."""
    from behaviors.errors import InputError

    if isinstance(error, TyperException):
        return error.format_message()
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return None
