"""The last frames of a running simulation as `Tracks`, for predictors and streams."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.row_index import RowIndex, find_sorted
from sim.frames import KINDS, MAX_MAGNITUDE, OF_AGENTS, SIGNALS, Frame, Tracks

MAX_TIME_S: Final = MAX_MAGNITUDE
"""Latest time, s (as of recordings: 30 years; far later ones have no next step)."""


class FrameBuffer:
    """Keeps the last frames; memory does not grow with time.

    Args:
        steps: how many frames to keep.
    """

    def __init__(self, steps: int) -> None:
        if steps < 1:
            raise InputError(f"steps: found {steps}, expected at least 1")
        self._frames: deque[Frame] = deque(maxlen=steps)
        self._moved: deque[NDArray[np.float64]] = deque(maxlen=steps)  # x, y, heading, speed

    def push(self, frame: Frame) -> None:
        """Add the next frame.

        Raises:
            InputError: if the time is out of order or beyond ``MAX_TIME_S``, the ids do not
                ascend, a position or kind is invalid, or the signals differ. The buffer then stays
                unchanged.
        """
        last = self._frames[-1] if self._frames else None
        time_s, ids = frame.time_s, frame.ids
        if not abs(time_s) <= MAX_TIME_S:
            raise InputError(f"frame.time_s: found {time_s}, expected seconds up to {MAX_TIME_S:g}")
        if last is not None and time_s <= last.time_s:
            raise InputError(f"frame.time_s: found {time_s}, expected later than {last.time_s}")
        if last is not None and frame.signals.size != last.signals.size:
            before = f"expected {last.signals.size} as before"
            raise InputError(f"frame.signals: found {frame.signals.size}, {before}")
        if not (ids[1:] > ids[:-1]).all():
            raise InputError("frame.ids: found ids that do not ascend, expected each once")
        for name, codes, known in (
            ("kind", frame.kind, KINDS),
            ("signals", frame.signals, SIGNALS),
        ):
            if not ((codes >= 0) & (codes < len(known))).all():
                raise InputError(f"frame.{name}: found other codes than 0 to {len(known) - 1}")
        finite = np.isfinite(frame.xy).all(axis=1)
        if not finite.all():
            agent = ids[int(finite.argmin())]
            raise InputError(f"frame.xy: found no finite place of agent {agent}, expected metres")
        for name in ("heading", "speed", "length", "width"):
            values = np.abs(getattr(frame, name))
            if not np.fmax.reduce(values, initial=0.0) <= MAX_MAGNITUDE:
                agent = ids[int(np.argmax(values > MAX_MAGNITUDE))]
                raise InputError(
                    f"frame.{name}: found agent {agent} beyond {MAX_MAGNITUDE:g}, expected less"
                )
        self._frames.append(frame)
        self._moved.append(np.column_stack([frame.xy, frame.heading, frame.speed]))

    def __len__(self) -> int:
        """How many frames are kept now."""
        return len(self._frames)

    @property
    def last(self) -> Frame:
        """The newest frame.

        Raises:
            InputError: if there is none yet.
        """
        if not self._frames:
            raise InputError("frames: found none, expected at least one")
        return self._frames[-1]

    def tracks(self) -> Tracks:
        """Tracks of the agents that are present now; the last column is the present."""
        if not self._frames:
            return Tracks.from_frames(())
        frames, last = self._frames, self._frames[-1]
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
