"""Progress on stderr: a bar on a terminal, plain lines elsewhere, nothing when quiet."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Final

from behaviors.display import printable

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

LINE_EVERY_S: Final = 5.0
"""Least time between two plain lines, s."""


class Progress:
    """Shows how far a piece of work has come, while the ``with`` block lasts.

    Args:
        what: the work and what is counted ("generating episodes").
        total: how many there are to do; 0 where that is not known.
        quiet: whether to show nothing.
    """

    def __init__(self, what: str, total: int, quiet: bool = False) -> None:
        self._what, self._total = what, total
        self._done = self._agents = self._agent_steps = 0
        self._started = time.monotonic()
        self._last_line = -LINE_EVERY_S
        self._quiet = quiet
        self._bar: Bar | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> Progress:
        """Begin; on a terminal the bar appears."""
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[words]}"),
                console=Console(stderr=True),
            )
            self._bar.start()
            self._task = self._bar.add_task(self._what, total=self._total or None, words="")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End; the bar stays as it is."""
        if self._bar is not None:
            self._bar.stop()

    def advance(self, agents: int = 0, agent_steps: int = 0) -> None:
        """One more is done.

        Args:
            agents: agents in it.
            agent_steps: agent-steps in it.
        """
        self._done += 1
        self._agents += agents
        self._agent_steps += agent_steps
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=self._done, words=self._words())
        elif not self._quiet:
            self._line()

    def _line(self) -> None:
        now = time.monotonic()
        if now - self._last_line >= LINE_EVERY_S or self._done == self._total:
            self._last_line = now
            words = self._words()
            told = f" ({words})" if words else ""
            of = f" of {self._total}" if self._total else ""
            print(f"{printable(self._what)}: {self._done}{of}{told}", file=sys.stderr, flush=True)

    def _words(self) -> str:
        """Agents, rate and time left."""
        elapsed_s = max(time.monotonic() - self._started, 1e-9)
        parts = []
        if self._agent_steps:
            parts.append(f"{self._agents} agents")
            parts.append(f"{self._agent_steps / elapsed_s:,.0f} agent-steps/s")
        if self._done < self._total:
            left_s = elapsed_s / self._done * (self._total - self._done)
            parts.append(f"{left_s:.0f} s left")
        return ", ".join(parts)
