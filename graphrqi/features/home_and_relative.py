"""Two observers side by side: the one of a method, and the one for traffic of unknown kind."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.observer import Observation, Observer
from graphrqi.features.relative.observer import RelativeObserver

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class HomeAndRelativeObserver:
    """Features of a method's own observer, followed by those of `RelativeObserver`.

    Args:
        home: a fresh observer of the method.
    """

    def __init__(self, home: Observer) -> None:
        self._home, self._relative = home, RelativeObserver()
        self.feature_names = (*home.feature_names, *RelativeObserver.feature_names)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        self._home.update(time_s, ids, xy, drives)
        self._relative.update(time_s, ids, xy, drives)

    def observation(self) -> Observation:
        """Evidence of both observers on the drivers present, side by side."""
        home, relative = self._home.observation(), self._relative.observation()
        self._widths = home.sums.shape[1], home.instant.shape[1]
        return dataclasses.replace(
            home,
            sums=np.concatenate([home.sums, relative.sums], axis=1),
            instant=np.concatenate([home.instant, relative.instant], axis=1),
        )

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) features of the method, and then the relative ones."""
        s, i = self._widths
        own = self._home.features(seconds, np.ascontiguousarray(sums[:, :s]), instant[:, :i])
        relative = self._relative.features(
            seconds, np.ascontiguousarray(sums[:, s:]), instant[:, i:]
        )
        return np.concatenate([own, relative], axis=1)
