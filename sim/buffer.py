"""The last frames of a running simulation, as `Tracks`: what a stream remembers."""

from __future__ import annotations

from collections import deque

from behaviors.errors import InputError
from sim.frames import Frame, Tracks


class FrameBuffer:
    """Keeps the last frames; memory does not grow with time.

    Args:
        steps: how many frames to keep.
    """

    def __init__(self, steps: int) -> None:
        if steps < 1:
            raise InputError(f"steps: found {steps}, expected at least 1")
        self._frames: deque[Frame] = deque(maxlen=steps)

    def push(self, frame: Frame) -> None:
        """Add the next frame.

        Raises:
            InputError: if its time is not after the last one's.
        """
        if self._frames and frame.time_s <= self._frames[-1].time_s:
            raise InputError(
                f"frame.time_s: found {frame.time_s}, expected later than {self._frames[-1].time_s}"
            )
        self._frames.append(frame)

    def __len__(self) -> int:
        """How many frames are kept now."""
        return len(self._frames)

    @property
    def last(self) -> Frame:
        """The newest frame."""
        return self._frames[-1]

    def tracks(self) -> Tracks:
        """What is remembered of the agents that are present now; the last column is the present."""
        return Tracks.from_frames(self._frames).window(len(self._frames), len(self._frames))
