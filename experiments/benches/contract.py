"""What every bench is: a name, settings at full and at quick size, and tidy rows.

A bench is a module with a ``BENCH`` and a line in `experiments.benches.registry`. Its settings are
one frozen dataclass of its own, which says how much is measured and of what; every field made by
`option` is also an option of ``graphrqi bench NAME``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from experiments.score.rows import Row, stamped

S = TypeVar("S")


def option(default: Any, help: str, metavar: str | None = None) -> Any:
    """A field of a bench's settings that the command line offers as an option.

    Args:
        default: its value at full size.
        help: one sentence for ``--help``.
        metavar: what stands for the value in ``--help``; None for the type's own word.
    """
    return field(default=default, metadata={"help": help, "metavar": metavar})


@dataclass(frozen=True)
class Bench(Generic[S]):
    """One thing that is measured.

    Attributes:
        name: its key in the registry, and in the ``command`` of its rows.
        summary: one sentence on what it measures.
        keys: what says what was measured in a row, beside ``metric, value, low, high, n``.
        full: settings at full size.
        quick: settings at a size that only shows that it works.
        measure: yields rows, part by part, so that a long bench can be stopped and keep them.
        table: lays rows out for reading; None to print them as they are.
        plot: draws rows into a picture; None if the bench has no picture.
        needs: the environment variable that names its recordings; "" if it needs none.
    """

    name: str
    summary: str
    keys: tuple[str, ...]
    full: S
    quick: S
    measure: Callable[[S], Iterable[Sequence[Row]]]
    table: Callable[[Sequence[Any]], Sequence[Row]] | None = None
    plot: Callable[[Sequence[Any], Path], None] | None = None
    needs: str = ""

    def run(
        self, settings: S | None = None, on_rows: Callable[[list[Row]], None] | None = None
    ) -> list[Row]:
        """Measure.

        Args:
            settings: how much, and of what; None for the full size.
            on_rows: called with all rows so far after each part.

        Returns:
            Tidy rows that say how they were made, with `keys` and ``metric, value, low, high, n``.

        Raises:
            InputError: if a setting is wrong.
        """
        rows: list[Row] = []
        chosen = self.full if settings is None else settings
        for part in self.measure(chosen):
            rows += stamped(part, f"bench {self.name}", getattr(chosen, "seed", None))
            if on_rows is not None:
                on_rows(rows)
        return rows
