"""Running traffic: the part of it that is reported, and its last frames as `Tracks`.

A stream or a predictor that is given a window never sees the agents outside it, and costs what the
agents inside cost. Its answers are limited likewise: a vehicle just outside is not a leader.
Choose a window that is wider than what is asked about by what drivers there react to, some 100 m.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.row_index import RowIndex, find_sorted
from sim.frames import (
    KINDS,
    MAX_MAGNITUDE,
    MOVING,
    OF_AGENTS,
    SIGNALS,
    BoolArray,
    FloatArray,
    Frame,
    IntArray,
    Tracks,
)

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


class FrameBuffer:
    """Keeps the last ``steps`` frames; memory does not grow with time."""

    def __init__(self, steps: int) -> None:
        self._frames: deque[Frame] = deque(maxlen=steps)
        self._moved: deque[FloatArray] = deque(maxlen=steps)  # x, y, heading, speed of each frame

    def push(self, frame: Frame) -> None:
        """Add the next frame.

        Raises:
            InputError: if the time is out of order or beyond 30 years, the ids do not ascend, a
                place or a code is invalid, or the signals differ. The buffer then stays unchanged.
        """
        time_s, ids, last = frame.time_s, frame.ids, self._frames[-1] if self._frames else None
        if not abs(time_s) <= MAX_MAGNITUDE:
            expected = f"expected seconds up to {MAX_MAGNITUDE:g}"
            raise InputError(f"frame.time_s: found {time_s}, {expected}")
        if last is not None and time_s <= last.time_s:
            raise InputError(f"frame.time_s: found {time_s}, expected later than {last.time_s}")
        if last is not None and frame.signals.size != last.signals.size:
            before = f"expected {last.signals.size} as before"
            raise InputError(f"frame.signals: found {frame.signals.size}, {before}")
        if not (ids[1:] > ids[:-1]).all():
            raise InputError("frame.ids: found ids that do not ascend, expected each once")
        for name, codes, known in (
            ("kind", frame.kind, len(KINDS)),
            ("signals", frame.signals, len(SIGNALS)),
        ):
            if not ((codes >= 0) & (codes < known)).all():
                raise InputError(f"frame.{name}: found other codes than 0 to {known - 1}")
        finite = np.isfinite(frame.xy).all(axis=1)
        if not finite.all():
            agent = ids[int(finite.argmin())]
            raise InputError(f"frame.xy: found no finite place of agent {agent}, expected metres")
        self._frames.append(frame)
        self._moved.append(np.column_stack([frame.xy, frame.heading, frame.speed]))

    def __len__(self) -> int:
        """How many frames are kept now."""
        return len(self._frames)

    @property
    def last(self) -> Frame:
        """The newest frame."""
        return self._frames[-1]

    def tracks(self) -> Tracks:
        """Tracks of the agents that are present now; the last column is the present."""
        if not self._frames:
            return Tracks.from_frames(())
        frames, last = self._frames, self.last
        agents, times = len(last), len(frames)
        agent, here = find_sorted(last.ids, np.concatenate([frame.ids for frame in frames]))
        step = np.repeat(np.arange(times), [len(frame) for frame in frames])
        source = np.full(agents * times, -1)  # the row of each agent at each time
        source[(agent * times + step)[here]] = np.flatnonzero(here)
        rows = source[source >= 0]
        moved = np.concatenate(self._moved).take(rows, axis=0)
        return Tracks(
            ids=last.ids,
            names=tuple(map(str, last.ids.tolist())),
            **{name: getattr(last, name) for name in OF_AGENTS},
            time_s=np.array([frame.time_s for frame in frames]),
            index=RowIndex.of_rows(agent[rows], step[rows], agents, times),
            row_xy=moved[:, :2].copy(),
            row_heading=moved[:, 2].copy(),
            row_speed=moved[:, 3].copy(),
            signals=np.array([frame.signals for frame in frames]).T.copy(),
            events=tuple(event for frame in frames for event in frame.events),
        )
