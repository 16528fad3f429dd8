"""Observers that use nothing but the traffic graph, and one that uses nothing at all."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.observer import Observation, RunningSums
from graphrqi.features.spectral import (
    INVARIANT_NAMES,
    NUM_PAIRS,
    SPECTRAL,
    GraphSpectrum,
    eigenvector_rows,
    spectral_means,
)
from graphrqi.graph import Sighting

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class NullObserver:
    """Measures how long each driver is present and has no features.

    Args:
        solver: not used; every observer takes one.
    """

    feature_names: tuple[str, ...] = ()

    def __init__(self, solver: str = "graphrqi") -> None:
        self._sums = RunningSums(0)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        drivers = ids[drives]
        self._sums.add(time_s, drivers, np.zeros((drivers.size, 0)))

    def observation(self) -> Observation:
        """The drivers present and their time observed."""
        return self._sums.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, 0) no columns."""
        return np.zeros((seconds.size, 0))


class EigenvectorObserver(NullObserver):
    """The features of the paper: rows of the matrix of the largest eigenvectors, now.

    Args:
        solver: a key of ``SOLVERS``.
    """

    feature_names = tuple(f"u_{k + 1}" for k in range(NUM_PAIRS))

    def __init__(self, solver: str = "graphrqi") -> None:
        super().__init__()
        self._spectrum = GraphSpectrum(solver)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        self._spectrum.observe(Sighting.of(ids, xy))
        super().update(time_s, ids, xy, drives)

    def observation(self) -> Observation:
        """The drivers present with their rows of the graph's present spectrum."""
        present = super().observation()
        spectrum, rows, _ = self._spectrum.solve(present.ids)
        vectors = eigenvector_rows(np.asarray(spectrum.eigenvectors))
        return dataclasses.replace(present, instant=vectors[rows])

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, NUM_PAIRS) the rows."""
        return instant


class SpectrumObserver:
    """Invariant spectral features of each driver, averaged over the time observed.

    Args:
        solver: a key of ``SOLVERS``.
    """

    feature_names = tuple(f"spectrum_{name}" for name in INVARIANT_NAMES)

    def __init__(self, solver: str = "graphrqi") -> None:
        self._spectrum = GraphSpectrum(solver)
        self._sums = RunningSums(SPECTRAL)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `graphrqi.features.observer.Observer.update`."""
        self._spectrum.observe(Sighting.of(ids, xy))
        self._sums.add(time_s, ids[drives], self._spectrum.moment(time_s, ids)[drives])

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._sums.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) means over the time observed."""
        return spectral_means(sums)
