"""The stream: it takes frames and gives a posterior over the six behaviours of every driver."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.drivers import DriverObserver
from graphrqi.features.motion import align
from graphrqi.graph import MAX_COORDINATE_M
from graphrqi.methods import Model, make_observer
from graphrqi.model_files import load_model
from graphrqi.places.other_traffic import FINEST_S, OtherTraffic, Traffic, check_traffic
from graphrqi.places.prior_shift import PriorShift
from graphrqi.posterior import Posterior
from sim.episode.live import FrameBuffer, Window
from sim.frames import Frame, Tracks

MIN_SECONDS: Final = 1.0
"""Time after which a driver is classified, s; earlier velocities are uncertain."""

PRIOR_EVERY_S: Final = 1.0
"""Time between estimates of the shares of behaviours, s."""

HISTORY_STEPS: Final = 50
"""Frames remembered for prediction; 5 s at 10 Hz."""

DEFAULT_MODEL: Final = "graphrqi-plus"
"""Name of the model that is used by default."""


class BehaviorStream:
    """Classifies drivers frame by frame.

    It uses only a frame's time and the agents' ids, positions and kinds (driver or pedestrian).
    Evidence on a driver accumulates while it is present. The shares of the behaviours are estimated
    from all drivers (`graphrqi.places.prior_shift`).

    Args:
        model: a trained model.
        min_seconds: time observed after which a driver is classified, s.
        window: which agents are of interest; None for everybody. The others cost nothing
            and are not seen by any driver.
        traffic: where the frames come from. The engines of this project are ``simulated``, and the
            model's own classifier answers, unless positions are noisy. In ``recorded`` and in
            ``other`` traffic its network for these answers.
        is_scene: False if a recording is not plausible as a scene: all drivers are unknown then.
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
        self._classifier = self._network = None
        if model.other is not None:
            self._network = _NetworkAnswers(model.other, self.traffic)
        if self._network is None or self.traffic == "simulated":
            self._classifier = make_observer(model.method.name, model.solver)
        self._buffer = FrameBuffer(HISTORY_STEPS)
        self._last: Frame | None = None
        self._prior_shift = PriorShift(np.array(model.shares))
        self._shifted_s = -np.inf
        self._is_scene = is_scene
        self._answered: tuple[IntArray, FloatArray, float] | None = None

    def update(self, frame: Frame) -> Posterior:
        """Take the next frame and classify.

        Args:
            frame: later than the one before.

        Returns:
            Posterior of every driver that is present and was observed long enough.

        Raises:
            InputError: for an unusable frame, see `sim.episode.live.FrameBuffer.push`; the stream
                then stays as it was.
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
        for observer in (self._classifier, self._network):
            if observer is not None:
                observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        self._last, self._answered = frame, None
        if frame.time_s >= self._shifted_s + PRIOR_EVERY_S - 1e-6:
            ids, probability, _ = self._answers()
            self._prior_shift.observe(frame.time_s, ids, probability)
            self._shifted_s = frame.time_s

    def _answers(self) -> tuple[IntArray, FloatArray, float]:
        """Ids, probabilities without prior shift, domain; of the drivers observed long enough."""
        if self._answered is None:
            if self._network is not None and (self.traffic != "simulated" or self.is_noisy):
                ids, found = self._network.answers(self.min_seconds)
            else:
                assert self._classifier is not None
                seen = self._classifier.observation()
                seen = seen.where(seen.seconds >= self.min_seconds - 1e-6)
                ids, found = seen.ids, np.zeros((0, len(self.model.classes)))
                if ids.size:
                    features = self._classifier.features(seen.seconds, seen.sums, seen.instant)
                    found = self.model.classifier.posterior(features)
            if self.model.adaptation is not None:
                found = self.model.adaptation.applied(found)
            domain = float(self.traffic != "simulated" and ids.size > 0)
            self._answered = ids, found, domain
        return self._answered

    def posterior(self) -> Posterior:
        """Posterior of every driver that is present and was observed long enough."""
        ids, probability, domain = self._answers()
        # Other traffic is offset as a whole, which would be taken for another mix of drivers.
        shifted = self._prior_shift.corrected(probability)
        answer = (1.0 - domain) * shifted + domain * probability
        classes = self.model.classes
        if self._is_scene:
            return Posterior(ids, answer, domain, classes=classes)
        return Posterior(ids, answer, domain, np.ones(ids.size), classes)

    @property
    def is_noisy(self) -> bool:
        """Whether simulated positions are noisier than those that the classifier learned from.

        Its network for noisy traffic answers then.
        """
        return (
            self.traffic == "simulated" and self._network is not None and self._network.sees_noise
        )

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


class _NetworkAnswers:
    """The answers of a network, as of the last moment that was measured."""

    def __init__(self, other: OtherTraffic, traffic: Traffic) -> None:
        self._observer = DriverObserver("smoothed")
        self._other, self._traffic = other, traffic
        self._place = other.empty_place(traffic)
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._known: FloatArray = np.empty((0, len(BEHAVIORS)))
        self.sees_noise = False

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions, and update the answers where motion is measured."""
        observer = self._observer
        if self._traffic == "simulated" and observer.is_exact and observer.frame_s >= FINEST_S:
            return  # positions without noise stay without noise
        measured = observer.update(time_s, ids, xy, drives)
        self.sees_noise = observer.is_noisy or observer.frame_s < FINEST_S
        if not measured or (self._traffic == "simulated" and not self.sees_noise):
            return
        seen = observer.observation()
        features = observer.features(seen.seconds, seen.sums, seen.instant)
        self._ids = seen.ids
        self._known = self._other.among(features, self._traffic, seen, time_s, self._place)

    def answers(self, min_seconds: float) -> tuple[IntArray, FloatArray]:
        """The drivers that are present and observed for so long, and (n, 6) probabilities.

        Chances are equal for drivers of which nothing was measured yet.
        """
        present = self._observer.present()
        ids = present.ids[present.seconds >= min_seconds - 1e-6]
        out = np.full((ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
        into, source = align(self._ids, ids)
        out[into] = self._known[source]
        return ids, out


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
        InputError: if the model or the kind of traffic is unknown.
    """
    return BehaviorStream(load_model(name_or_folder), window=window, traffic=traffic)
