"""The stream: a frame in, a posterior over the six behaviours of every driver out."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.graph.traffic_graph import MAX_COORDINATE_M
from graphrqi.methods import Model, load_model
from graphrqi.posterior import Posterior
from graphrqi.prior_shift import PriorShift
from sim.episode.buffer import FrameBuffer
from sim.frames import Frame, Tracks

MIN_SECONDS: Final = 1.0
"""Time after which a driver is classified (our choice: before it, velocity is hardly known)."""

MIX_EVERY_S: Final = 1.0
"""Time between estimates of how common each behaviour is here (our choice: drivers come and go more
slowly)."""

HISTORY_STEPS: Final = 50
"""Frames remembered for prediction (our choice: 5 s at 10 Hz)."""

DEFAULT_MODEL: Final = "graphrqi-plus"
"""The model that ships with the package."""


class BehaviorStream:
    """Classifies drivers as they drive.

    Uses nothing of a frame but its time and the ids, positions and kinds (driving or walking).
    Evidence on a driver accumulates for as long as it stays in sight, and how common each behaviour
    is here is learned of all drivers (`graphrqi.prior_shift`).

    Args:
        model: a trained model.
        min_seconds: a driver is classified from this long after it was first seen.
    """

    def __init__(self, model: Model, min_seconds: float = MIN_SECONDS) -> None:
        self.model = model
        self.min_seconds = min_seconds
        self._observer = model.observer()
        self._buffer = FrameBuffer(HISTORY_STEPS)
        self._mix = PriorShift(np.array(model.shares))
        self._mixed_s = -np.inf
        self._answered: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None

    def update(self, frame: Frame) -> Posterior:
        """Take the next frame and classify.

        Args:
            frame: later than the one before.

        Returns:
            Posterior of every driver present and seen long enough.

        Raises:
            InputError: if the frame's time does not increase or something in it is not usable, see
                `sim.episode.buffer.FrameBuffer.push`; the stream is as it was before then.
        """
        self.push(frame)
        return self.posterior()

    def push(self, frame: Frame) -> None:
        """Take the next frame; see `update`."""
        far = np.abs(frame.xy) > MAX_COORDINATE_M
        if far.any():
            agent = frame.ids[int(np.argwhere(far)[0, 0])]
            raise InputError(
                f"frame.xy: found agent {agent} beyond {MAX_COORDINATE_M:g} m, expected it nearer"
            )
        self._buffer.push(frame)
        self._observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        self._answered = None
        if frame.time_s >= self._mixed_s + MIX_EVERY_S - 1e-6:
            self._mix.observe(frame.time_s, *self._answers())
            self._mixed_s = frame.time_s

    def _answers(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Ids of those seen long enough, and what the model alone says of them now."""
        if self._answered is None:
            seen = self._observer.observation()
            ready = seen.seconds >= self.min_seconds - 1e-6
            features = self._observer.features(
                seen.seconds[ready], seen.sums[ready], seen.instant[ready]
            )
            self._answered = seen.ids[ready], self.model.posterior(features)
        return self._answered

    def posterior(self) -> Posterior:
        """Belief about every driver present and seen long enough, now."""
        ids, probability = self._answers()
        return Posterior(ids=ids, probability=self._mix.corrected(probability))

    @property
    def history(self) -> Tracks:
        """The last frames of the agents present now; the last column is the present."""
        return self._buffer.tracks()


def load_stream(name_or_folder: str | Path = DEFAULT_MODEL) -> BehaviorStream:
    """A stream over a trained model.

    Args:
        name_or_folder: a model that ships with the package, or a folder that ``graphrqi train``
            wrote.

    Returns:
        A fresh stream.

    Raises:
        InputError: if there is no such model.
    """
    return BehaviorStream(load_model(name_or_folder))
