"""Progress on stderr: a bar on a terminal, plain lines in a log, nothing when quiet."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any, Final

from behaviors.errors import printable

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

LINE_EVERY_S: Final = 5.0
"""Least time between two plain lines, s."""


class Progress:
    """Shows how far a piece of work has come, while the ``with`` block lasts.

    What is counted ("generating episodes") has a total, 0 where that is not known.
    """

    def __init__(self, what: str, total: int, quiet: bool = False) -> None:
        self._what, self._total, self._quiet = printable(what), total, quiet
        self._done = self._agents = self._agent_steps = 0
        self._started, self._last_line = time.monotonic(), -LINE_EVERY_S
        self._bar: Bar | None = None

    def __enter__(self) -> Progress:
        """Begin; on a terminal the bar appears."""
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress as Bar

            self._bar = Bar(console=Console(stderr=True))
            self._bar.add_task(self._what, total=self._total or None)
            self._bar.start()
        return self

    def __exit__(self, *error: Any) -> None:
        """End; the bar stays as it is."""
        if self._bar is not None:
            self._bar.stop()

    def advance(self, agents: int = 0, agent_steps: int = 0) -> None:
        """One more is done, with so many agents and agent-steps in it."""
        self._done += 1
        self._agents += agents
        self._agent_steps += agent_steps
        now = time.monotonic()
        if self._bar is not None:
            self._bar.advance(self._bar.task_ids[0])
        elif not self._quiet and (
            now - self._last_line >= LINE_EVERY_S or self._done == self._total
        ):
            self._last_line, elapsed_s = now, max(now - self._started, 1e-9)
            words = [f"{self._what}: {self._done}" + (f" of {self._total}" if self._total else "")]
            if self._agent_steps:
                rate = self._agent_steps / elapsed_s
                words.append(f"{self._agents} agents, {rate:,.0f} agent-steps/s")
            if self._done < self._total:
                words.append(f"{elapsed_s / self._done * (self._total - self._done):.0f} s left")
            print(", ".join(words), file=sys.stderr, flush=True)
