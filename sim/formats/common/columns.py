"""Which columns of a table say what of its agents: one declaration for each format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.formats.common.motion import MOVING_MPS
from sim.formats.common.recording import Rows, first_sizes
from sim.formats.common.tables import Table, read_table
from sim.frames import AgentKind, FloatArray
from sim.units import in_si


@dataclass(frozen=True)
class Columns:
    """The columns of a format whose files have a row for each agent and time.

    Attributes:
        id: name of an agent; further columns tell agents of one name apart.
        t: time, or number of a frame.
        xy: centre of an agent.
        heading: angle from +x; "" where it is taken from the velocity or the motion.
        speed: the speed, or both components of the velocity.
        size: length and width.
        kind: word for the kind; "" where all agents are cars.
        kinds: kind of each word.
        units: of columns that are in no SI unit, as `sim.units.in_si` takes them.
        from_zero: whether the first time becomes 0.
        words: further columns of text.
        numbers: further columns of numbers.
        optional: columns that files may lack.
        empty: columns that may have empty fields.
    """

    id: tuple[str, ...]
    t: str
    xy: tuple[str, str] = ("x", "y")
    heading: str = ""
    speed: tuple[str, ...] = ()
    size: tuple[str, ...] = ()
    kind: str = ""
    kinds: Mapping[str, AgentKind] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    from_zero: bool = False
    words: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    empty: tuple[str, ...] = ()

    @property
    def measured(self) -> list[str]:
        """Every column of numbers."""
        named = (self.t, *self.xy, self.heading, *self.speed, *self.size, *self.numbers)
        return [name for name in dict.fromkeys(named) if name]

    def read(self, path: Path) -> Table:
        """Read a file's columns.

        Raises:
            InputError: naming the file and the column or row that is wrong.
        """
        named = dict.fromkeys((*self.id, self.kind, *self.words))
        words = [name for name in named if name and name not in self.numbers]
        return read_table(path, self.measured, words, self.optional, self.empty)

    def rows(
        self,
        table: Table,
        agents: tuple[NDArray[np.int64], Sequence[str]] | None = None,
        rate_hz: float = 1.0,
    ) -> Rows:
        """Rows of a table in SI units.

        Headings that are missing are those of velocities above `MOVING_MPS`.

        Args:
            table: as `read` gives it, or a part.
            agents: index of each row's agent, and the agents' names; None to tell them by ``id``.
            rate_hz: by which times are divided: frames per second, where they are frames.

        Raises:
            InputError: naming the column that is wrong.
        """

        def column(name: str) -> FloatArray:
            return table.measured(name, self.units.get(name, ""))

        agent, names = agents or table.names(*self.id)
        time = table.measured(self.t)
        first = np.nanmin(time) if self.from_zero else 0.0
        heading = column(self.heading) if self.heading else None
        speed = None
        if len(self.speed) == 1:
            speed = column(self.speed[0])
        elif self.speed:
            vx, vy = (column(name) for name in self.speed)
            speed = np.hypot(vx, vy)
            course = np.where(speed >= MOVING_MPS, np.arctan2(vy, vx), np.nan)
            heading = course if heading is None else np.where(np.isnan(heading), course, heading)
        sides = np.stack([column(name) for name in self.size], axis=1) if self.size else None
        return Rows(
            agent,
            names,
            in_si((time - first) / rate_hz, self.units.get(self.t, "")),
            np.stack([column(name) for name in self.xy], axis=1),
            heading,
            speed,
            table.kinds(self.kind, agent, self.kinds) if self.kind else None,
            None if sides is None else first_sizes(agent, sides),
        )
