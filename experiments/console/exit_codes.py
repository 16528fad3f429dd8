"""A program that fails because of its input, or is stopped, says why in one line and exits.

Only what every program needs is imported here, so that help appears at once.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NoReturn

from typer.exceptions import TyperException

STOPPED: Final = 130
"""Exit code of a program that Ctrl-C stopped: 128 plus the signal's number, as in shells."""

ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that stop a program, Ctrl-C's first: what it was writing is cleared away."""


class Interrupted(Exception):
    """The user stopped a run; the message says how to go on."""


STOPPED_WORDS: Final = "stopped: run the same command again to go on"


@contextmanager
def exit_on_user_error() -> Iterator[None]:
    """Turn errors that the user made into one line on stderr and exit code 2, Ctrl-C into 130.

    SIGTERM and SIGHUP stop the program in the same way, with the exit codes 143 and 129.

    Raises:
        SystemExit: instead of an `InputError`, an `OSError` with a reason given by the system, a
            wrong command line, an `Interrupted` or a `KeyboardInterrupt`. Any other exception is a
            defect of the program and keeps its traceback.
    """
    received: list[int] = []
    try:
        with _stopping(received):
            yield
    except (Interrupted, KeyboardInterrupt) as stop:
        code = 128 + received[0] if received else STOPPED
        _end(str(stop) or STOPPED_WORDS, code)
    except Exception as error:
        if received:  # what a signal broke: an import in native code turns it into other errors
            _end(STOPPED_WORDS, 128 + received[0])
        if not isinstance(error, TyperException | ValueError | OSError):
            raise
        reason = _reason(error)
        if reason is None:
            raise
        _end(f"error: {reason}", 2)


@contextmanager
def _stopping(received: list[int]) -> Iterator[None]:
    """In the block, `ENDING` signals raise KeyboardInterrupt, once; those ignored stay ignored."""

    def stop(number: int, frame: object) -> NoReturn:
        received.append(number)
        for one in handled:  # a second one does not disturb the clearing
            signal.signal(one, signal.SIG_IGN)
        raise KeyboardInterrupt

    in_main = threading.current_thread() is threading.main_thread()
    usual = (signal.SIG_DFL, signal.default_int_handler)  # under nohup SIGHUP is ignored
    before = {one: signal.getsignal(one) for one in ENDING}
    handled = [one for one in ENDING if in_main and before[one] in usual]
    for one in handled:
        signal.signal(one, stop)
    try:
        yield
    finally:
        for one in handled:
            signal.signal(one, before[one])


def _end(message: str, code: int) -> NoReturn:
    from experiments.console.notices import for_terminal

    sys.stderr.write(f"graphrqi: {for_terminal(' '.join(message.split()))}\n")
    raise SystemExit(code) from None


def _reason(error: Exception) -> str | None:
    """What the user did wrong; None if the program is to blame."""
    from behaviors.errors import InputError

    if isinstance(error, TyperException):
        return _in_our_words(error)
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return None


def _in_our_words(error: TyperException) -> str:
    """What typer says; values that are no numbers or out of bounds as in files' wrong fields."""
    said = error.format_message()
    if not said.startswith("Invalid value for "):
        return said
    from pydantic import ValidationError

    from sim.invalid_fields import first_wrong_field

    if not isinstance(error.__cause__, ValidationError):
        return said
    option = said.removeprefix("Invalid value for ").partition(": ")[0].strip("'")
    return f"{option}: {first_wrong_field(error.__cause__)}"
