"""A window of interest: the part of the traffic that is reported.

A stream or a predictor that is given a window never sees the agents outside it, and costs what the
agents inside cost. Its answers are limited likewise: a vehicle just outside is not a leader.
Choose a window that is wider than what is asked about by what drivers there react to, some 100 m.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.frames import MOVING, OF_AGENTS, BoolArray, FloatArray, Frame, IntArray, Tracks

DEFAULT_RADIUS_M: Final = 100.0
"""Distance from an ego within which others count, m (what drivers react to)."""


@dataclass(frozen=True, slots=True)
class Window:
    """Selection of agents at a time: those that satisfy every given condition.

    Attributes:
        region: smallest x and y and largest x and y, m; None for everywhere.
        around: id of an agent; only it and those within ``radius_m`` of it count, and none while
            it is absent.
        radius_m: m.
        agents: ids; None for all.

    Examples:
        >>> frame = Frame(0.0, [3, 7], [[0.0, 0.0], [500.0, 0.0]], [0, 0], [9, 9], [4, 4], [2, 2],
        ...               [0, 0])
        >>> Window(around=3).of(frame).ids.tolist()
        [3]
    """

    region: tuple[float, float, float, float] | None = None
    around: int | None = None
    radius_m: float = DEFAULT_RADIUS_M
    agents: Collection[int] | None = None

    def __post_init__(self) -> None:
        """Refuse a window that nothing can be in."""
        if self.region is not None:
            x0, y0, x1, y1 = self.region
            if not (x0 <= x1 and y0 <= y1):
                raise InputError(
                    f"window.region: found {self.region}, expected smallest x, smallest y, "
                    "largest x, largest y, m"
                )
        if not (math.isfinite(self.radius_m) and self.radius_m > 0):
            raise InputError(f"window.radius_m: found {self.radius_m}, expected metres > 0")

    def admits(self, ids: IntArray, xy: FloatArray) -> BoolArray:
        """(n,) which agents count, of everybody at one time at (n, 2) places, m."""
        inside = np.ones(ids.size, dtype=np.bool_)
        if self.region is not None:
            x0, y0, x1, y1 = self.region
            inside &= ((xy >= (x0, y0)) & (xy <= (x1, y1))).all(axis=1)
        if self.around is not None:
            who = np.flatnonzero(ids == self.around)
            if not who.size:
                return np.zeros(ids.size, dtype=np.bool_)
            away = xy - xy[who[0]]
            inside &= np.hypot(away[:, 0], away[:, 1]) <= self.radius_m
        if self.agents is not None:
            inside &= np.isin(ids, np.fromiter(self.agents, np.int64, len(self.agents)))
        return inside

    def of(self, frame: Frame) -> Frame:
        """The frame with the agents that count, and the events among these."""
        inside = self.admits(frame.ids, frame.xy)
        if inside.all():
            return frame
        here = set(frame.ids[inside].tolist())
        return dataclasses.replace(
            frame,
            **{name: getattr(frame, name)[inside] for name in ("ids", *MOVING, *OF_AGENTS)},
            events=tuple(event for event in frame.events if event.agent in here),
        )

    def of_tracks(self, tracks: Tracks) -> Tracks:
        """The tracks of the agents that count at the last time; they keep their whole past."""
        if not tracks.row_speed.size:
            return tracks
        at = tracks.index.at(-1)
        rows = tracks.index.agent[at]
        inside = self.admits(tracks.ids[rows], tracks.row_xy[at])
        return tracks.part(rows[inside], slice(None)) if at.size else tracks
