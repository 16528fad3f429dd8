"""Observers that see nothing but the traffic graph (and one that sees nothing at all)."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.evidence import Evidence
from graphrqi.features.graph_spectrum import SPECTRAL, GraphSpectrum, spectral_means
from graphrqi.features.observer import Observation
from graphrqi.features.spectral import INVARIANT_NAMES, NUM_PAIRS, eigenvector_rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class BlindObserver:
    """Counts the seconds and sees nothing else.

    Args:
        solver: not used; every observer takes one.
    """

    feature_names: tuple[str, ...] = ()

    def __init__(self, solver: str = "graphrqi") -> None:
        self._evidence = Evidence(0)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        drivers = ids[drives]
        self._evidence.add(time_s, drivers, np.zeros((drivers.size, 0)))

    def observation(self) -> Observation:
        """Who is present, and for how long."""
        return self._evidence.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """No columns."""
        return np.zeros((seconds.size, 0))


class EigenvectorObserver:
    """What the paper feeds its classifier: rows of the largest-end eigenvector matrix, now.

    Args:
        solver: a key of ``SOLVERS``.
    """

    feature_names = tuple(f"u_{k + 1}" for k in range(NUM_PAIRS))

    def __init__(self, solver: str = "graphrqi") -> None:
        self._spectrum = GraphSpectrum(solver)
        self._evidence = Evidence(0)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        self._spectrum.observe(ids, xy)
        drivers = ids[drives]
        self._evidence.add(time_s, drivers, np.zeros((drivers.size, 0)))

    def observation(self) -> Observation:
        """The rows of the drivers present, of the graph's spectrum now."""
        present = self._evidence.observation()
        spectrum, rows, _ = self._spectrum.solve(present.ids)
        return dataclasses.replace(
            present, instant=eigenvector_rows(np.asarray(spectrum.eigenvectors))[rows]
        )

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """The rows as they are."""
        return instant


class SpectrumObserver:
    """Invariant spectral features of each driver, averaged over the time observed.

    Args:
        solver: a key of ``SOLVERS``.
    """

    feature_names = tuple(f"spectrum_{name}" for name in INVARIANT_NAMES)

    def __init__(self, solver: str = "graphrqi") -> None:
        self._spectrum = GraphSpectrum(solver)
        self._evidence = Evidence(SPECTRAL)

    def update(self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray) -> None:
        """Take the next positions; see `Observer.update`."""
        self._spectrum.observe(ids, xy)
        self._evidence.add(time_s, ids[drives], self._spectrum.moment(time_s, ids)[drives])

    def observation(self) -> Observation:
        """Evidence on the drivers present."""
        return self._evidence.observation()

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """Means over the time observed."""
        return spectral_means(sums)
