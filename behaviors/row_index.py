"""The index from the rows of a table to agents and time steps.

An agent is present for a small part of a long episode, so its time series are stored as rows of
those moments only. All such arrays of an episode have the length and the order of one `RowIndex`:
by agent, then by time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
V = TypeVar("V", bound=np.generic)


class TimeBlock(NamedTuple):
    """The rows of some consecutive times.

    Attributes:
        rows: (k,) in order of time, then of agent.
        first: the first of the t times.
        begins: (t + 1,) where in ``rows`` those of each time begin, and k.
    """

    rows: IntArray
    first: int
    begins: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class RowIndex:
    """The m moments at which N agents were seen, of T times.

    Attributes:
        agent: (m,) agent of each row, ascending.
        step: (m,) time of each row.
        first: (N + 1,) first row of each agent.
        times: T.
        begins: (m,) not seen one time before.
    """

    agent: IntArray
    step: IntArray
    first: IntArray
    times: int
    begins: BoolArray

    @classmethod
    def of_rows(cls, agent: IntArray, step: IntArray, agents: int, times: int) -> RowIndex:
        """From rows in order.

        Args:
            agent: (m,) which agent, ascending.
            step: (m,) at which time, ascending for each agent.
            agents: how many agents there are.
            times: how many times there are.
        """
        begins = np.ones(agent.size, dtype=bool)
        begins[1:] = (agent[1:] != agent[:-1]) | (step[1:] != step[:-1] + 1)
        first = np.searchsorted(agent, np.arange(agents + 1))
        return cls(agent, step, first, times, begins)

    @classmethod
    def of(cls, valid: BoolArray) -> RowIndex:
        """From a mask.

        Args:
            valid: (N, T) whether each agent was seen at each time.

        Examples:
            >>> seen = RowIndex.of(np.array([[False, True, True], [True, False, True]]))
            >>> seen.agent.tolist(), seen.step.tolist(), seen.begins.tolist()
            ([0, 0, 1, 1], [1, 2, 0, 2], [True, False, True, True])
        """
        agent, step = np.nonzero(valid)
        return cls.of_rows(agent, step, *valid.shape)

    @property
    def agents(self) -> int:
        """How many agents there are."""
        return self.first.size - 1

    def rows(self, agent: int, begin: int = 0, end: int | None = None) -> slice:
        """The rows of one agent.

        Args:
            agent: which.
            begin: the first time wanted.
            end: one past the last; None for all.
        """
        low, high = int(self.first[agent]), int(self.first[agent + 1])
        step = self.step[low:high]
        until = high if end is None else low + int(step.searchsorted(end))
        return slice(low + int(step.searchsorted(begin)) if begin > 0 else low, until)

    def row(self, agent: int, time: int) -> int:
        """The row of one agent at one time; -1 if it was not seen then."""
        at = self.rows(agent, time, time + 1)
        return at.start if at.stop > at.start else -1

    def over(self, values: NDArray[V], agent: int, begin: int, end: int, empty: Any) -> NDArray[V]:
        """One agent's values at every time of a span.

        Args:
            values: (m, ...) one value per row.
            agent: which agent.
            begin: first time.
            end: one past the last.
            empty: fills the times at which the agent was not seen.

        Returns:
            (end - begin, ...) values.

        Examples:
            >>> seen = RowIndex.of(np.array([[False, True, True, False, True]]))
            >>> seen.over(np.array([1.0, 2.0, 4.0]), 0, 2, 5, 0.0).tolist()
            [2.0, 0.0, 4.0]
        """
        at = self.rows(agent, begin, end)
        if at.stop - at.start == end - begin:
            return values[at]
        filled = np.full((end - begin, *values.shape[1:]), empty, dtype=values.dtype)
        filled[self.step[at] - begin] = values[at]
        return filled

    def runs(self, flags: BoolArray, shortest: int = 1) -> Iterator[slice]:
        """Unbroken stretches of time over which a condition holds for one agent.

        Args:
            flags: (m,) where the condition holds.
            shortest: leave out stretches shorter than this.

        Yields:
            Their rows.

        Examples:
            >>> seen = RowIndex.of(np.array([[True, True, True], [True, False, True]]))
            >>> [(run.start, run.stop) for run in seen.runs(np.array([0, 1, 1, 1, 1]) > 0)]
            [(1, 3), (3, 4), (4, 5)]
        """
        at = np.flatnonzero(flags)  # usually few, so the rest works on these alone
        new = self.begins[at] | (np.diff(at, prepend=-2) > 1)
        first = np.flatnonzero(new)
        count = np.diff(first, append=at.size)
        long = count >= shortest
        for begin, steps in zip(at[first[long]].tolist(), count[long].tolist(), strict=True):
            yield slice(begin, begin + steps)

    def by_time(self) -> tuple[IntArray, IntArray]:
        """The rows in order of time, then of agent.

        Returns:
            (m,) rows, and (T + 1,) where those of each time begin, and m.
        """
        order = np.argsort(self.step, kind="stable")  # fast: a merge of one sorted run per agent
        counts = np.bincount(self.step, minlength=self.times)
        return order, np.concatenate([[0], np.cumsum(counts)])

    def time_blocks(self, most: int) -> Iterator[TimeBlock]:
        """All rows, in blocks of consecutive times.

        A loop over the blocks needs memory for one block only.

        Args:
            most: rows of a block; one time is never divided.

        Yields:
            At least one block.

        Examples:
            >>> seen = RowIndex.of(np.array([[True, True, True], [True, False, True]]))
            >>> [block.rows.tolist() for block in seen.time_blocks(3)]
            [[0, 3, 1], [2, 4]]
        """
        rows, begins = self.by_time()
        first = 0
        while True:
            end = int(np.searchsorted(begins, begins[first] + most, side="right")) - 1
            end = min(max(end, first + 1), self.times)
            yield TimeBlock(
                rows[begins[first] : begins[end]], first, begins[first : end + 1] - begins[first]
            )
            first = end
            if first >= self.times:
                return
