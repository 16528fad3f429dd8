"""What programs say on stderr while they work: notices of the package's logger, a line each."""

from __future__ import annotations

import logging
import sys


class _OnStderr(logging.Handler):
    """Writes to whatever stderr is at that moment."""

    def emit(self, record: logging.LogRecord) -> None:
        sys.stderr.write(f"graphrqi: {record.getMessage()}\n")
        sys.stderr.flush()


def show_notices(quiet: bool = False) -> None:
    """Show messages of the logger "graphrqi" from level INFO on.

    Args:
        quiet: show warnings and errors only.
    """
    logger = logging.getLogger("graphrqi")
    logger.setLevel(logging.WARNING if quiet else logging.INFO)
    if not any(isinstance(handler, _OnStderr) for handler in logger.handlers):
        logger.addHandler(_OnStderr())
