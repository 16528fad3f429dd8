"""The paper's accumulated traffic graph and its leading eigenpairs, followed from step to step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.spectral import INVARIANT_NAMES, NUM_PAIRS, invariant
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS, Spectrum

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NEIGHBORS: Final = 4
"""Nearest neighbours joined by an edge (the paper)."""

RESET: Final = 100
"""Steps after which the accumulated graph starts anew (the paper)."""

SPECTRUM_EVERY_S: Final = 0.5
"""How often averages of spectral features look at the spectrum (our choice: a graph changes by a
few per cent of its edges per tenth of a second)."""

SPECTRAL: Final = len(INVARIANT_NAMES) + 1
"""Columns of spectral evidence: the features, and how often they were taken."""


class GraphSpectrum:
    """The paper's accumulated graph and its largest eigenpairs, warm-started step by step."""

    def __init__(self, solver: str) -> None:
        self._solve: Callable[..., Spectrum] = SOLVERS[solver]
        self._graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
        self._previous: Spectrum | None = None
        self._looked_s = -np.inf

    def observe(self, ids: IntArray, xy: FloatArray) -> None:
        """Take the next positions into the graph."""
        self._graph = self._graph.observe(ids, xy)

    def solve(self, ids: IntArray) -> tuple[Spectrum, IntArray, FloatArray]:
        """The spectrum now, the rows of the given agents in it, and all degrees."""
        self._previous = self._solve(
            self._graph, num_pairs=NUM_PAIRS + 1, end="largest", previous=self._previous
        )
        rows = self._graph.rows_of(ids)
        return self._previous, rows, self._graph.degree

    def moment(self, time_s: float, ids: IntArray) -> FloatArray:
        """(n, F + 1) invariant features of the agents and a one, or zeros until it is due again."""
        if time_s - self._looked_s < SPECTRUM_EVERY_S - 1e-6:
            return np.zeros((ids.size, SPECTRAL))
        self._looked_s = time_s
        spectrum, rows, degrees = self.solve(ids)
        values = invariant(
            np.asarray(spectrum.eigenvalues), np.asarray(spectrum.eigenvectors), degrees
        )
        return np.concatenate([values[rows], np.ones((ids.size, 1))], axis=1)


def spectral_means(sums: FloatArray) -> FloatArray:
    """Means (n, F) of the invariant features from their evidence (n, F + 1)."""
    total = sums[:, -1:]
    return np.asarray(sums[:, :-1] / np.where(total > 1e-9, total, 1.0))
