"""The index from the rows of a table to agents and time steps.

An agent is present for a small part of a long episode, so its time series are stored as rows of
those moments only. All such arrays of an episode have the length and the order of one `RowIndex`:
by agent, then by time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
V = TypeVar("V", bound=np.generic)

BLOCK_ROWS: Final = 200_000
"""Rows that are worked on at once where one time needs nothing of the others (some 20 to 60 MB)."""


def find_sorted(known: IntArray, ids: IntArray) -> tuple[IntArray, BoolArray]:
    """The index of each id in (m,) ascending ``known`` ones, and whether it is there."""
    if known.size == 0:
        return np.zeros(ids.shape, dtype=np.int64), np.zeros(ids.shape, dtype=bool)
    at = np.minimum(np.searchsorted(known, ids), known.size - 1)
    return at, known[at] == ids


@dataclass(frozen=True, eq=False)
class RowIndex:
    """The m moments at which N agents were seen, of T times.

    Attributes:
        agent: (m,) agent of each row, ascending.
        step: (m,) time of each row.
        first: (N + 1,) first row of each agent.
        times: T.
        begins: (m,) not seen one time before.

    Examples:
        >>> seen = RowIndex.of(np.array([[False, True, True], [True, False, True]]))
        >>> seen.agent.tolist(), seen.step.tolist(), seen.begins.tolist()
        ([0, 0, 1, 1], [1, 2, 0, 2], [True, False, True, True])
        >>> seen.over(np.array([1.0, 2.0, 4.0, 8.0]), 0, 0, 3, 0.0).tolist()
        [0.0, 1.0, 2.0]
        >>> [(run.start, run.stop) for run in seen.runs(np.array([1, 1, 1, 0]) > 0)]
        [(0, 2), (2, 3)]
    """

    agent: IntArray
    step: IntArray
    first: IntArray
    times: int
    begins: BoolArray

    @classmethod
    def of_rows(cls, agent: IntArray, step: IntArray, agents: int, times: int) -> RowIndex:
        """From the agent and the time of each row, in order, and how many of both there are."""
        begins = np.ones(agent.size, dtype=bool)
        begins[1:] = (agent[1:] != agent[:-1]) | (step[1:] != step[:-1] + 1)
        return cls(agent, step, np.searchsorted(agent, np.arange(agents + 1)), times, begins)

    @classmethod
    def of(cls, valid: BoolArray) -> RowIndex:
        """From a mask, (N, T) whether each agent was seen at each time."""
        agent, step = np.nonzero(valid)
        return cls.of_rows(agent, step, *valid.shape)

    @property
    def agents(self) -> int:
        """How many agents there are."""
        return self.first.size - 1

    def rows(self, agent: int, begin: int = 0, end: int | None = None) -> slice:
        """The rows of one agent from time ``begin`` until before ``end``; None for all."""
        low, high = int(self.first[agent]), int(self.first[agent + 1])
        step = self.step[low:high]
        until = high if end is None else low + int(step.searchsorted(end))
        return slice(low + int(step.searchsorted(begin)) if begin > 0 else low, until)

    def over(self, values: NDArray[V], agent: int, begin: int, end: int, empty: Any) -> NDArray[V]:
        """(end - begin, ...) values of one agent at each time; ``empty`` where it was not seen."""
        at = self.rows(agent, begin, end)
        filled = np.full((end - begin, *values.shape[1:]), empty, dtype=values.dtype)
        filled[self.step[at] - begin] = values[at]
        return filled

    def runs(self, flags: BoolArray, shortest: int = 1) -> Iterator[slice]:
        """The rows of each unbroken stretch of time over which flags (m,) hold for one agent.

        Stretches shorter than ``shortest`` are left out.
        """
        at = np.flatnonzero(flags)  # usually few, so the rest works on these alone
        first = np.flatnonzero(self.begins[at] | (np.diff(at, prepend=-2) > 1))
        count = np.diff(first, append=at.size)
        long = count >= shortest
        for begin, steps in zip(at[first[long]].tolist(), count[long].tolist(), strict=True):
            yield slice(begin, begin + steps)

    @cached_property
    def by_time(self) -> tuple[IntArray, IntArray]:
        """(m,) the rows in order of time, then of agent; (T + 1,) where each time begins, and m."""
        order = np.argsort(self.step, kind="stable")  # fast: a merge of one sorted run per agent
        return order, np.concatenate([[0], np.cumsum(self.counts())])

    def at(self, step: int) -> IntArray:
        """(k,) the rows of one time, by agent; -1 is the last time."""
        order, begins = self.by_time
        step %= self.times
        return order[begins[step] : begins[step + 1]]

    def counts(self) -> IntArray:
        """(T,) how many agents are present at each time."""
        return np.bincount(self.step, minlength=self.times)

    @cached_property
    def cells(self) -> IntArray:
        """(m,) number of each row's agent and time, in an array of all agents at all times."""
        return self.agent * self.times + self.step

    def find(self, agent: IntArray, step: IntArray) -> tuple[IntArray, BoolArray]:
        """The row for each agent and time, and whether there is one; if none, the row is any."""
        return find_sorted(self.cells, np.asarray(agent * self.times + step))

    def part(self, agents: IntArray, times: slice | IntArray) -> tuple[IntArray, RowIndex]:
        """The rows of some agents at some of the times, both ascending, and their own index."""
        times = np.arange(self.times)[times]
        order, begins = self.by_time
        rows = np.sort(order[begins[times[0]] : begins[times[-1] + 1]]) if times.size else times
        step, some = find_sorted(times, self.step[rows])
        rows, step = rows[some], step[some]
        agent, some = find_sorted(agents, self.agent[rows])
        index = RowIndex.of_rows(agent[some], step[some], agents.size, times.size)
        return rows[some], index

    def time_blocks(self) -> Iterator[tuple[IntArray, int, IntArray]]:
        """All rows, in at least one block of consecutive times, for loops that save memory.

        Yields:
            (k,) rows in order of time, then of agent, at most `BLOCK_ROWS` unless of one time;
            the first of the t times; (t + 1,) where in the rows those of each begin, and k.
        """
        rows, begins = self.by_time
        first = 0
        while first < max(self.times, 1):
            end = int(np.searchsorted(begins, begins[first] + BLOCK_ROWS, side="right")) - 1
            end = min(max(end, first + 1), self.times)
            yield rows[begins[first] : begins[end]], first, begins[first : end + 1] - begins[first]
            first = max(end, 1)
