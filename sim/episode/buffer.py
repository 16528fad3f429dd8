"""The last frames of a running simulation as `Tracks`, for predictors and streams."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.row_index import find_sorted
from sim.frames import KINDS, MAX_MAGNITUDE, SIGNALS, Event, Frame, Tracks

_TABLES = ("_xy", "_heading", "_speed", "_valid")
"""Names of the tables of agents by times."""


MAX_TIME_S: Final = MAX_MAGNITUDE
"""Latest time, s (as of recordings: 30 years; far later ones have no next step)."""


class FrameBuffer:
    """Keeps the last frames; memory does not grow with time.

    Tables of agents by times are twice as wide as needed. A frame is written into the next column;
    only when the right end is reached do the kept columns move back to the left. They have more
    rows than agents: a new agent takes the next free row, and the others keep theirs.

    Args:
        steps: how many frames to keep.
    """

    def __init__(self, steps: int) -> None:
        if steps < 1:
            raise InputError(f"steps: found {steps}, expected at least 1")
        self._steps, self._end, self._count = steps, 0, 0
        self._last: Frame | None = None
        self._ids = np.empty(0, dtype=np.int64)
        self._row = np.empty(0, dtype=np.int64)  # of each id in the tables
        self._xy = np.empty((0, 2 * steps, 2))  # NaN where unseen, like the next two
        self._heading = np.empty((0, 2 * steps))
        self._speed = np.empty((0, 2 * steps))
        self._valid = np.empty((0, 2 * steps), dtype=bool)
        self._fixed = np.empty((0, 3))  # kind, length, width
        self._time_s = np.empty(2 * steps)
        self._signals = np.empty((0, 2 * steps), dtype=np.int8)
        self._events: deque[tuple[Event, ...]] = deque(maxlen=steps)

    def push(self, frame: Frame) -> None:
        """Add the next frame.

        Raises:
            InputError: if the time is out of order or beyond ``MAX_TIME_S``, the ids do not
                ascend, a position or kind is invalid, or the signals differ. The buffer then stays
                unchanged.
        """
        self._check(frame)
        if self._last is None:
            self._signals = np.empty((frame.signals.size, 2 * self._steps), dtype=np.int8)
        if self._end == 2 * self._steps:
            self._move_back()
        at, known = find_sorted(self._ids, frame.ids)
        if not known.all():
            self._add(frame.ids[~known])
            at = np.searchsorted(self._ids, frame.ids)
        row, column = self._row[at], self._end
        for table, unseen, seen in (
            (self._xy, np.nan, frame.xy),
            (self._heading, np.nan, frame.heading),
            (self._speed, np.nan, frame.speed),
            (self._valid, False, True),
        ):
            table[: self._ids.size, column] = unseen
            table[row, column] = seen
        self._fixed[row] = np.stack([frame.kind, frame.length, frame.width], axis=1)
        self._time_s[column] = frame.time_s
        self._signals[:, column] = frame.signals
        self._events.append(frame.events)
        self._last = frame
        self._end, self._count = self._end + 1, min(self._count + 1, self._steps)

    def _check(self, frame: Frame) -> None:
        """Refuse what tracks cannot hold."""
        last, kinds, lights = self._last, len(KINDS), len(SIGNALS)
        time_s, ids, signals = frame.time_s, frame.ids, frame.signals
        if not abs(time_s) <= MAX_TIME_S:
            raise InputError(f"frame.time_s: found {time_s}, expected seconds up to {MAX_TIME_S:g}")
        if last is not None and time_s <= last.time_s:
            raise InputError(f"frame.time_s: found {time_s}, expected later than {last.time_s}")
        if last is not None and signals.size != last.signals.size:
            before = f"expected {last.signals.size} as before"
            raise InputError(f"frame.signals: found {signals.size}, {before}")
        if not (ids[1:] > ids[:-1]).all():
            raise InputError("frame.ids: found ids that do not ascend, expected each once")
        if not ((frame.kind >= 0) & (frame.kind < kinds)).all():
            raise InputError(f"frame.kind: found other codes than 0 to {kinds - 1}")
        if not ((signals >= 0) & (signals < lights)).all():
            raise InputError(f"frame.signals: found other codes than 0 to {lights - 1}")
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

    def _move_back(self) -> None:
        """Move the kept columns to the left end, and drop agents that are in none of them."""
        kept = slice(self._end - self._steps + 1, self._end)
        some = self._valid[self._row, kept].any(axis=1)
        self._ids, self._row = self._ids[some], self._row[some]
        for name in _TABLES:
            old = getattr(self, name)[self._row]
            old[:, : self._steps - 1] = old[:, kept].copy()
            setattr(self, name, old)
        self._fixed = self._fixed[self._row]
        self._row = np.arange(self._ids.size)
        for values in (self._time_s, self._signals):
            values[..., : self._steps - 1] = values[..., kept].copy()
        self._end = self._steps - 1

    def _add(self, ids: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        """Give agents that were not seen before the next rows."""
        taken, needed = self._ids.size, self._ids.size + ids.size
        for name in (*_TABLES, "_fixed"):
            table = getattr(self, name)
            if needed > len(table):
                old = table
                table = np.empty((2 * needed, *old.shape[1:]), dtype=old.dtype)
                table[:taken] = old[:taken]
                setattr(self, name, table)
            # Spare rows are not touched: until they are needed, they take no memory.
            table[taken:needed] = np.nan if table.dtype == np.float64 else False
        every = np.concatenate((self._ids, ids))
        order = np.argsort(every, kind="stable")
        self._ids = every[order]
        self._row = np.concatenate((self._row, np.arange(taken, needed)))[order]

    def __len__(self) -> int:
        """How many frames are kept now."""
        return self._count

    @property
    def last(self) -> Frame:
        """The newest frame.

        Raises:
            InputError: if there is none yet.
        """
        if self._last is None:
            raise InputError("frames: found none, expected at least one")
        return self._last

    def tracks(self) -> Tracks:
        """Tracks of the agents that are present now; the last column is the present."""
        kept = slice(self._end - self._count, self._end)
        here = self._valid[self._row, self._end - 1] if self._count else np.empty(0, dtype=bool)
        row, ids = self._row[here], self._ids[here]
        fixed = self._fixed[row]
        return Tracks.of_dense(
            ids=ids,
            names=tuple(map(str, ids.tolist())),
            kind=fixed[:, 0].astype(np.int8),
            length=fixed[:, 1],
            width=fixed[:, 2],
            time_s=self._time_s[kept].copy(),
            xy=self._xy[row, kept],
            heading=self._heading[row, kept],
            speed=self._speed[row, kept],
            valid=self._valid[row, kept],
            signals=self._signals[:, kept].copy(),
            events=tuple(e for events in self._events for e in events),
        )
