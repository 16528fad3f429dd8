"""The stream: it takes frames and gives a posterior over the six behaviours of every driver."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.graph.sighting import MAX_COORDINATE_M
from graphrqi.live_answers import LiveAnswers
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.other_traffic import Traffic, check_traffic
from graphrqi.posterior import Posterior
from graphrqi.prior_shift import PriorShift
from graphrqi.scene_check import SceneMonitor
from sim.episode.buffer import FrameBuffer
from sim.episode.window import Window
from sim.frames import Frame, Tracks

if TYPE_CHECKING:
    pass

MIN_SECONDS: Final = 1.0
"""Time after which a driver is classified; before it, velocity is hardly known."""

PRIOR_EVERY_S: Final = 1.0
"""Time between estimates of the shares of behaviours; drivers come and go more slowly."""

HISTORY_STEPS: Final = 50
"""Frames remembered for prediction; 5 s at 10 Hz."""

DEFAULT_MODEL: Final = "graphrqi-plus"
"""Name of the model that is used by default."""


class BehaviorStream:
    """Classifies drivers frame by frame.

    Of a frame only the time and the agents' ids, positions and kinds (driver or pedestrian) are
    used. Evidence on a driver accumulates for as long as it is present, and the shares of the
    behaviours are estimated from all drivers (`graphrqi.prior_shift`).

    Args:
        model: a trained model.
        min_seconds: time observed after which a driver is classified, s.
        window: which agents are of interest; None for everybody. The others cost nothing, and are
            nobody's neighbours.
        traffic: where the frames come from. The engines of this project are ``simulated``, and the
            model's own classifier answers, unless positions are noisy. In ``recorded`` and in
            ``other`` traffic its network for these answers.
        is_scene: False if a check of the whole recording, which sees sizes, found no scene that can
            be believed (`graphrqi.scene_check.check_scene`): everybody is unknown then.
    """

    def __init__(
        self,
        model: Model,
        min_seconds: float = MIN_SECONDS,
        window: Window | None = None,
        traffic: Traffic = "simulated",
        is_scene: bool = True,
    ) -> None:
        self.model = model
        self.traffic = check_traffic(traffic)
        self.window = window
        self.min_seconds = min_seconds
        self._live = LiveAnswers(model, min_seconds, self.traffic)
        self._buffer = FrameBuffer(HISTORY_STEPS)
        self._last: Frame | None = None
        self._prior_shift = PriorShift(np.array(model.shares))
        self._shifted_s = -np.inf
        self._monitor = None if traffic == "simulated" else SceneMonitor(outlines=False)
        self._believed = self._is_scene = is_scene
        self._answered: tuple[NDArray[np.int64], NDArray[np.float64], float] | None = None

    def update(self, frame: Frame) -> Posterior:
        """Take the next frame and classify.

        Args:
            frame: later than the one before.

        Returns:
            Posterior of every driver that is present and was observed long enough.

        Raises:
            InputError: if the frame's time does not increase or a value in it is not usable, see
                `sim.episode.buffer.FrameBuffer.push`; the stream then stays as it was.
        """
        self.push(frame)
        return self.posterior()

    def push(self, frame: Frame) -> None:
        """Take the next frame; see `update`."""
        if self.window is not None:
            frame = self.window.of(frame)
        far = np.abs(frame.xy) > MAX_COORDINATE_M
        if far.any():
            agent = frame.ids[int(np.argwhere(far)[0, 0])]
            raise InputError(
                f"frame.xy: found agent {agent} beyond {MAX_COORDINATE_M:g} m, expected it nearer"
            )
        self._buffer.push(frame)
        self._live.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        if self._monitor is not None:
            self._is_scene = self._monitor.update(frame) and self._believed
        self._last, self._answered = frame, None
        if frame.time_s >= self._shifted_s + PRIOR_EVERY_S - 1e-6:
            ids, probability, _ = self._answers()
            self._prior_shift.observe(frame.time_s, ids, probability)
            self._shifted_s = frame.time_s

    def _answers(self) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
        """Ids, probabilities without prior shift, domain; of the drivers observed long enough."""
        if self._answered is None:
            self._answered = self._live.now()
        return self._answered

    def posterior(self) -> Posterior:
        """Posterior of every driver that is present and was observed long enough."""
        ids, probability, domain = self._answers()
        # Other traffic is offset as a whole, which would be taken for another mix of drivers.
        shifted = self._prior_shift.corrected(probability)
        answer = (1.0 - domain) * shifted + domain * probability
        if self._is_scene:
            return Posterior(ids, answer, domain)
        return Posterior(ids, answer, domain, np.ones(ids.size))

    @property
    def is_noisy(self) -> bool:
        """Whether simulated positions are noisier than those that the classifier learned from.

        Its network for noisy traffic answers then.
        """
        return self._live.is_noisy

    def __repr__(self) -> str:
        """The model, and the time and the agents of the last frame."""
        now = "no frame yet"
        if self._last is not None:
            drivers = int(self._last.driving.sum())
            now = (
                f"at {self._last.time_s:g} s: {drivers} drivers, "
                f"{len(self._last) - drivers} pedestrians"
            )
        return (
            f"BehaviorStream({self.model.method.name} with solver {self.model.solver}, "
            f"answers after {self.min_seconds:g} s, {now})"
        )

    @property
    def history(self) -> Tracks:
        """The last frames of the agents present now; the last column is the present."""
        return self._buffer.tracks()


def load_stream(
    name_or_folder: str | Path = DEFAULT_MODEL,
    window: Window | None = None,
    traffic: Traffic = "simulated",
) -> BehaviorStream:
    """A stream over a trained model.

    Args:
        name_or_folder: a model that ships with the package, or a folder that ``graphrqi train``
            wrote.
        window: which agents are of interest; None for everybody.
        traffic: where the frames come from: ``simulated`` (by the engines of this project),
            ``recorded`` or ``other``.

    Returns:
        A fresh stream.

    Raises:
        InputError: if there is no such model or kind of traffic.
    """
    return BehaviorStream(load_model(name_or_folder), window=window, traffic=traffic)
