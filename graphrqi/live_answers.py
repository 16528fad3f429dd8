"""What a model says about the drivers present, frame by frame.

In simulated traffic the model's own classifier answers anew in every frame, on motion over
fractions of a second. Where positions are noisy, and in all other traffic, the networks of
`graphrqi.other_traffic` answer. What they see changes only when smoothed motion is measured, some
times a second: their answers are kept in between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from graphrqi.features.kinematics import align
from graphrqi.features.relative.observer import RelativeObserver
from graphrqi.methods import Model, make_observer
from graphrqi.other_traffic import FINEST_S, OtherTraffic, Traffic

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class LiveAnswers:
    """Answers about the drivers of one stream, without the shares of behaviours in its traffic.

    Args:
        model: which answers.
        min_seconds: time observed after which a driver is classified, s.
        traffic: where the positions come from.
    """

    def __init__(self, model: Model, min_seconds: float, traffic: Traffic = "simulated") -> None:
        self._model, self._min_seconds, self._traffic = model, min_seconds, traffic
        self._network = None
        if model.other is not None:
            self._network = _NetworkAnswers(model.other, traffic)
        self._own = None
        if self._network is None or traffic == "simulated":
            self._own = make_observer(model.method.name, model.solver)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        if self._own is not None:
            self._own.update(time_s, ids, xy, drives)
        if self._network is not None:
            self._network.observer.update(time_s, ids, xy, drives)

    @property
    def is_noisy(self) -> bool:
        """Whether simulated traffic is seen with more noise than the classifier learned from."""
        return (
            self._traffic == "simulated"
            and self._network is not None
            and (self._network.observer.is_noisy or self._network.observer.frame_s < FINEST_S)
        )

    def now(self) -> tuple[IntArray, FloatArray, float]:
        """The drivers that are present and were observed long enough.

        Returns:
            Their (n,) ascending ids, (n, 6) probabilities, and the domain of the traffic: 0
            simulated here, 1 other traffic that the model has a network for.
        """
        domain = 0.0
        if self._network is None or (self._traffic == "simulated" and not self.is_noisy):
            ids, found = self._own_answers()
        else:
            ids = self._network.ready(self._min_seconds)
            found = self._network.answers(ids)
            domain = 0.0 if self._traffic == "simulated" else 1.0
        if self._model.adaptation is not None:
            found = self._model.adaptation.applied(found)
        return ids, found, domain if ids.size else 0.0

    def _own_answers(self) -> tuple[IntArray, FloatArray]:
        """Ids of the drivers that are ready, and what the model's own classifier answers."""
        assert self._own is not None
        seen = self._own.observation()
        ready = seen.seconds >= self._min_seconds - 1e-6
        if not ready.any():
            return seen.ids[:0], np.zeros((0, len(BEHAVIORS)))
        features = self._own.features(seen.seconds, seen.sums, seen.instant)
        found = self._model.classifier.posterior(features)
        return seen.ids[ready], found[ready]


class _NetworkAnswers:
    """The answers of a network, as of the last moment that was measured."""

    def __init__(self, other: OtherTraffic, traffic: Traffic) -> None:
        self.observer = RelativeObserver()
        self._other, self._traffic = other, traffic
        self._place = other.empty_place(traffic)
        self._asked_s = float("nan")
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._known: FloatArray = np.empty((0, len(BEHAVIORS)))

    def answers(self, ids: IntArray) -> FloatArray:
        """(n, 6) probabilities; equal chances for drivers of which nothing was measured yet."""
        if self.observer.measured_s != self._asked_s:
            self._asked_s = self.observer.measured_s
            seen, features = self.observer.described()
            self._ids = seen.ids
            self._known = self._other.among(
                features, self._traffic, seen, self._asked_s, self._place
            )
        out = np.full((ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
        into, source = align(self._ids, ids)
        out[into] = self._known[source]
        return out

    def ready(self, min_seconds: float) -> IntArray:
        """Ids of the drivers that are present and were observed for so long."""
        present = self.observer.present()
        return present.ids[present.seconds >= min_seconds - 1e-6]
