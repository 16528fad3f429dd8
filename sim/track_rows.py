"""Rows of each agent: the content of `sim.frames.Tracks`.

An agent is present for a small part of a long recording. Arrays of all agents at all times are
mostly empty then, and thousands of agents that are seen once each would need gigabytes for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.row_index import RowIndex
from sim.checked_arrays import frozen

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DenseName = Literal["xy", "heading", "speed", "valid"]

DENSE: Final[tuple[DenseName, ...]] = ("xy", "heading", "speed", "valid")
"""Quantities that are arrays of all agents at all times."""

MAX_CELLS: Final = 5 * 10**7
"""Most agents times times of dense arrays (all four together take 1.65 GB)."""


@dataclass(frozen=True, eq=False)
class TrackRows:
    """The places of N agents at T times: m rows, by agent, then by time.

    Attributes:
        index: the agent and the time of each row.
        xy: (m, 2) m.
        heading: (m,) rad.
        speed: (m,) m/s.
    """

    index: RowIndex
    xy: FloatArray
    heading: FloatArray
    speed: FloatArray

    def __post_init__(self) -> None:
        """Make the arrays 64-bit and read-only."""
        for name in ("xy", "heading", "speed"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, frozen(values))

    @classmethod
    def of_dense(
        cls, valid: NDArray[np.bool_], xy: FloatArray, heading: FloatArray, speed: FloatArray
    ) -> TrackRows:
        """The valid cells of arrays of agents times times.

        Args:
            valid: (N, T) whether each agent is present.
            xy: (N, T, 2) m.
            heading: (N, T) rad.
            speed: (N, T) m/s.
        """
        index = RowIndex.of(valid)
        at = index.agent, index.step
        return cls(index, xy[at], heading[at], speed[at])

    def dense(self, name: DenseName) -> NDArray[Any]:
        """One quantity as an array of all agents at all times.

        Args:
            name: which.

        Returns:
            (N, T) or (N, T, 2), NaN without a row; for "valid", whether there is one.

        Raises:
            InputError: if that would be more than ``MAX_CELLS``.

        Examples:
            >>> seen = RowIndex.of(np.array([[False, True], [True, False]]))
            >>> TrackRows(seen, np.zeros((2, 2)), np.zeros(2), np.array([3.0, 4.0])).dense("speed")
            array([[nan,  3.],
                   [ 4., nan]])
        """
        n, t = self.index.agents, self.index.times
        if n * t > MAX_CELLS:
            raise InputError(
                f"Tracks.{name}: found {n} agents at {t} times, expected agents times times at "
                f"most {MAX_CELLS} where all are looked at together: cut the recording in time"
            )
        at = self.index.agent, self.index.step
        if name == "valid":
            valid = np.zeros((n, t), dtype=bool)
            valid[at] = True
            return valid
        values = getattr(self, name)
        filled = np.full((n, t, *values.shape[1:]), np.nan)
        filled[at] = values
        return filled

    @cached_property
    def _by_time(self) -> tuple[IntArray, IntArray]:
        return self.index.by_time()

    def at(self, step: int) -> IntArray:
        """(k,) the rows of one time, by agent."""
        order, begins = self._by_time
        step %= self.index.times  # -1 is the last one
        return order[begins[step] : begins[step + 1]]

    def counts(self) -> IntArray:
        """(T,) how many agents are present at each time."""
        return np.bincount(self.index.step, minlength=self.index.times)

    def first_steps(self) -> IntArray:
        """(N,) the time at which each agent is first present; 0 for one that never is."""
        first = self.index.first
        steps = np.zeros(self.index.agents, dtype=np.int64)
        present = first[1:] > first[:-1]
        steps[present] = self.index.step[first[:-1][present]]
        return steps

    @cached_property
    def _cells(self) -> IntArray:
        return self.index.agent * self.index.times + self.index.step

    def find(self, agent: IntArray, step: IntArray) -> tuple[IntArray, NDArray[np.bool_]]:
        """Find the rows of agents at given times.

        Args:
            agent: indices of agents.
            step: indices of times, of a shape that fits.

        Returns:
            The row for each, and whether there is one; where there is none, the row is any.
        """
        cell = np.asarray(agent * self.index.times + step)
        if not self._cells.size:
            return np.zeros(cell.shape, dtype=np.int64), np.zeros(cell.shape, dtype=bool)
        row = np.minimum(np.searchsorted(self._cells, cell), self._cells.size - 1)
        return row, self._cells[row] == cell

    def places(self, agent: IntArray, step: IntArray) -> FloatArray:
        """Positions of agents at given times.

        Args:
            agent: as in `find`.
            step: as in `find`.

        Returns:
            (..., 2) m; NaN where an agent is not present.

        Examples:
            >>> seen = RowIndex.of(np.array([[False, True], [True, False]]))
            >>> rows = TrackRows(seen, np.array([[1.0, 2.0], [3.0, 4.0]]), np.zeros(2), np.zeros(2))
            >>> rows.places(np.array([0, 1]), np.array([1, 1]))
            array([[ 1.,  2.],
                   [nan, nan]])
        """
        row, there = self.find(agent, step)
        places = np.full((*row.shape, 2), np.nan)
        places[there] = self.xy[row[there]]
        return places

    def part(self, agents: IntArray, columns: slice | IntArray) -> TrackRows:
        """The rows of some agents at some of the times.

        Args:
            agents: indices of the agents, ascending.
            columns: which times; as indices, ascending.

        Returns:
            Their rows; agents and times get new numbers.
        """
        times = np.arange(self.index.times)[columns]
        if not times.size:
            rows = np.empty(0, dtype=np.int64)
        elif times[-1] - times[0] + 1 == self.index.times:
            rows = np.arange(self.index.step.size)
        else:
            order, begins = self._by_time
            rows = np.sort(order[begins[times[0]] : begins[times[-1] + 1]])
        step, there = _places(times, self.index.step[rows])
        rows, step = rows[there], step[there]
        agent, kept = _places(agents, self.index.agent[rows])
        rows, step, agent = rows[kept], step[kept], agent[kept]
        index = RowIndex.of_rows(agent, step, len(agents), times.size)
        return TrackRows(index, self.xy[rows], self.heading[rows], self.speed[rows])


def _places(wanted: IntArray, values: IntArray) -> tuple[IntArray, NDArray[np.bool_]]:
    """The place of each value among ascending ones, and whether it is one of them."""
    if wanted.size and wanted[-1] - wanted[0] + 1 == wanted.size:  # consecutive: no search
        place = values - wanted[0]
        return place, (place >= 0) & (place < wanted.size)
    place = np.searchsorted(wanted, values)
    inside = place < wanted.size
    inside[inside] = wanted[place[inside]] == values[inside]
    return place, inside
