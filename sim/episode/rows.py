"""An episode as one row per agent and time step, for searches over whole episodes.

`sim.frames.Tracks` holds the same, and gives dense arrays on request.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from behaviors.row_index import RowIndex
from sim.frames import PEDESTRIAN, BoolArray, CodeArray, Event, FloatArray, IntArray, Tracks

BLOCK_ROWS: Final = 200_000
"""Rows of an episode that are worked on at once where one time needs nothing of the others (they
take some 20 to 60 MB)."""

BREAK_S: Final = 1.0
"""Longest time between two frames without a break, s."""

BREAK_STEPS: Final = 3.0
"""Most usual steps that may lie between two frames without a break."""


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryRows:
    """The trajectories of N agents at T times: m rows, by agent, then by time.

    Attributes:
        tracks: the same as dense arrays.
        row_index: the agent and the time of each row.
        ids: (N,) agent ids, ascending.
        kind: (N,) codes into ``KINDS``.
        length: (N,) m.
        width: (N,) m.
        time_s: (T,) s, increasing.
        step_s: time between frames, s.
        xy: (m, 2) m.
        heading: (m,) rad.
        speed: (m,) m/s.
        signals: (S, T) codes into ``SIGNALS``.
        events: the source's own events, in time order.
    """

    tracks: Tracks
    row_index: RowIndex
    ids: IntArray
    kind: CodeArray
    length: FloatArray
    width: FloatArray
    time_s: FloatArray
    step_s: float
    xy: FloatArray
    heading: FloatArray
    speed: FloatArray
    signals: CodeArray
    events: tuple[Event, ...] = ()

    @classmethod
    def of(cls, tracks: Tracks) -> TrajectoryRows:
        """The rows of an episode or a recording.

        Args:
            tracks: at least two frames long.

        Examples:
            >>> TrajectoryRows.of(Tracks(
            ...     ids=[7], names=("7",), kind=[0], length=[4.0], width=[2.0], time_s=[0.1, 0.2],
            ...     xy=[[[np.nan, np.nan], [3.0, 4.0]]], heading=[[np.nan, 0.0]],
            ...     speed=[[np.nan, 5.0]], valid=[[False, True]], signals=np.zeros((0, 2)))).xy
            array([[3., 4.]])
        """
        seen = tracks.as_rows()
        return cls(
            tracks=tracks,
            row_index=seen.index,
            ids=tracks.ids,
            kind=tracks.kind,
            length=tracks.length,
            width=tracks.width,
            time_s=tracks.time_s,
            step_s=tracks.step_s,
            xy=seen.xy,
            heading=seen.heading,
            speed=seen.speed,
            signals=tracks.signals,
            events=tracks.events,
        )

    def between_breaks(self) -> Iterator[TrajectoryRows]:
        """The parts between breaks, in order of time; itself where there are none.

        A break is a time between two frames of more than `BREAK_S` and of more than `BREAK_STEPS`
        usual ones. A part has the agents that are seen in it.
        """
        longest_s = max(BREAK_S, BREAK_STEPS * self.step_s)
        begins = [0, *(np.flatnonzero(np.diff(self.time_s) > longest_s) + 1).tolist()]
        if len(begins) == 1:
            yield self
            return
        everyone = np.arange(self.ids.size)
        for begin, end in pairwise([*begins, self.time_s.size]):
            if end - begin > 1:
                part = self.tracks.part(everyone, slice(begin, end))
                seen = np.flatnonzero(np.diff(part.as_rows().index.first))
                yield TrajectoryRows.of(part.part(seen, slice(None)))

    def agent_and_time(self, row: int) -> tuple[int, float]:
        """The agent's id and the time, s, of a row."""
        index = self.row_index
        return int(self.ids[index.agent[row]]), float(self.time_s[index.step[row]])

    @property
    def walking(self) -> BoolArray:
        """(m,) whether the agent is a pedestrian."""
        return np.asarray((self.kind == PEDESTRIAN)[self.row_index.agent])
