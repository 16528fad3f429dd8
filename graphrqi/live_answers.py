"""What a model says about the drivers present, frame by frame.

Home's classifier answers anew in every frame, on motion over fractions of a second. What is known
of traffic elsewhere changes only when smoothed motion is measured, some times a second: those
answers are kept in between. A classifier that the gate takes for impossible is not asked.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from graphrqi.elsewhere import FOREIGN, HOME, RECORDED, UNSEEN, Elsewhere
from graphrqi.features.kinematics import align
from graphrqi.features.relative.observer import RelativeObserver
from graphrqi.methods import Model, make_observer

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class LiveAnswers:
    """Answers about the drivers of one stream, without the shares of behaviours in its traffic.

    Args:
        model: which answers.
        min_seconds: time observed after which a driver is classified, s.
    """

    def __init__(self, model: Model, min_seconds: float) -> None:
        self._model, self._min_seconds = model, min_seconds
        self._own = make_observer(model.method.name, model.solver)
        self._away = None if model.elsewhere is None else _Away(model.elsewhere)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        self._own.update(time_s, ids, xy, drives)
        if self._away is not None:
            self._away.observer.update(time_s, ids, xy, drives)

    def now(self) -> tuple[IntArray, FloatArray, float]:
        """The drivers that are present and were observed long enough.

        Returns:
            Their (n,) ascending ids, (n, 6) probabilities, and how foreign the traffic is.
        """
        if self._away is None:
            ids, found, domain = *self._at_home(), 0.0
        else:
            kinds = self._away.kinds()
            if kinds[HOME] > 0.0:
                ids, at_home = self._at_home()
                found = kinds[HOME] * at_home + self._away.answers(ids)
            else:
                ids = self._away.ready(self._min_seconds)
                found = self._away.answers(ids)
            domain = min(float(kinds[FOREIGN] + kinds[RECORDED]), 1.0)
        if self._model.adaptation is not None:
            found = self._model.adaptation.applied(found)
        return ids, found, domain if ids.size else 0.0

    def _at_home(self) -> tuple[IntArray, FloatArray]:
        """Ids of the drivers that are ready, and what the model's own classifier answers."""
        seen = self._own.observation()
        ready = seen.seconds >= self._min_seconds - 1e-6
        if not ready.any():
            return seen.ids[:0], np.zeros((0, len(BEHAVIORS)))
        features = self._own.features(seen.seconds, seen.sums, seen.instant)
        found = self._model.classifier.posterior(features)
        return seen.ids[ready], found[ready]


class _Away:
    """What is known of traffic elsewhere, as of the last moment that was measured."""

    def __init__(self, elsewhere: Elsewhere) -> None:
        self.observer = RelativeObserver()
        self._elsewhere = elsewhere
        self._asked_s = float("nan")
        self._place = elsewhere.empty_place()
        self._kinds = UNSEEN
        self._ids: IntArray = np.empty(0, dtype=np.int64)
        self._known: FloatArray = np.empty((0, len(BEHAVIORS)))

    def _refresh(self) -> None:
        """Ask again if something was measured since the last time."""
        if self.observer.measured_s == self._asked_s:
            return
        self._asked_s = self.observer.measured_s
        one = self.observer.measured(most=1)
        self._kinds = UNSEEN
        if one.ids.size:
            described = self.observer.features(one.seconds, one.sums, one.instant)
            self._kinds = self._elsewhere.kinds(described)[0]
        self._ids, self._known = one.ids[:0], np.empty((0, len(BEHAVIORS)))
        if self._kinds[HOME] < 1.0:
            seen, features = self.observer.described()
            self._ids = seen.ids
            self._known = self._elsewhere.answers_among(
                features, self._kinds, seen, self._asked_s, self._place
            )

    def kinds(self) -> FloatArray:
        """(4,) probability of each kind of traffic."""
        self._refresh()
        return self._kinds

    def answers(self, ids: IntArray) -> FloatArray:
        """(n, 6) probabilities times that of the kinds of traffic that are not as at home."""
        self._refresh()
        out = np.full((ids.size, len(BEHAVIORS)), (1.0 - self._kinds[HOME]) / len(BEHAVIORS))
        into, source = align(self._ids, ids)
        out[into] = self._known[source]
        return out

    def ready(self, min_seconds: float) -> IntArray:
        """Ids of the drivers that are present and were observed for so long."""
        present = self.observer.present()
        return present.ids[present.seconds >= min_seconds - 1e-6]
