"""Features of vertices in the spectrum of the paper's accumulated traffic graph.

The paper feeds its classifier with row i of the eigenvector matrix U. An eigenvector is defined up
to its sign, or up to a rotation where its eigenvalue is repeated. Rows of U are therefore not
functions of the graph. The features of `invariant` are. They are sums of f(lambda) u_i^2 over whole
eigenspaces, which do not depend on the choice of eigenvectors.
Eigenvalues are scaled by the largest one, so that neither number nor order of the vehicles matters.
`GraphSpectrum` follows the graph and its largest eigenpairs from frame to frame, for two observers:
`EigenvectorObserver` gives rows of U, `SpectrumObserver` invariant features.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.observer import Observation, Observer
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS, Spectrum

NEIGHBORS: Final = 4
"""Nearest neighbours joined by an edge (the paper)."""

RESET: Final = 100
"""Steps after which the accumulated graph is reset (the paper)."""

SPECTRUM_EVERY_S: Final = 0.5
"""Time between the spectra that averaged features use."""

NUM_PAIRS: Final = 8
"""Eigenpairs kept at the largest end (since the paper does not state its own)."""

HEAT_SCALES: Final = (0.5, 1.0, 2.0, 4.0)
"""Diffusion times of the heat filters, in units of 1 / lambda_max."""

INVARIANT_NAMES: Final[tuple[str, ...]] = (
    "degree",
    "degree_over_mean",
    "energy",
    "leading_amplitude",
    *(f"filter_{s:g}" for s in HEAT_SCALES),
)
"""Columns of `invariant`."""

SPECTRAL: Final = len(INVARIANT_NAMES) + 1
"""Columns of spectral evidence: the features, and the number of times they were taken."""

_SAME_EIGENVALUE: Final = 1e-6
"""Relative distance below which two eigenvalues count as one (solvers deliver 1e-8)."""


def whole_eigenspaces(eigenvalues: FloatArray, complete: bool) -> int:
    """How many leading pairs of descending eigenvalues form whole eigenspaces.

    The last eigenspace is left out where pairs of it may be missing.
    """
    if complete or eigenvalues.size == 0:
        return int(eigenvalues.size)
    tolerance = _SAME_EIGENVALUE * max(1.0, float(abs(eigenvalues[0])))
    return int(np.count_nonzero(eigenvalues > eigenvalues[-1] + tolerance))


def invariant(eigenvalues: FloatArray, eigenvectors: FloatArray, degrees: FloatArray) -> FloatArray:
    """(d, F) spectral features that do not depend on the choice of eigenvectors.

    Columns are named by ``INVARIANT_NAMES``. They are the degree, the degree over the mean one, and
    the energy of the vertex in the leading spaces. The amplitude in the first space is multiplied
    by sqrt(d), so that a graph twice as large gives the same numbers. The filters are sum_k exp(-t
    (1 - lambda_k / lambda_1)) u_ik^2 for several t, times d / k.
    """
    d, k = eigenvectors.shape
    out = np.zeros((d, len(INVARIANT_NAMES)))
    if d == 0:
        return out
    out[:, 0] = degrees
    out[:, 1] = degrees / max(float(degrees.mean()), 1e-12)
    whole = whole_eigenspaces(eigenvalues, complete=k >= d)
    if whole == 0 or eigenvalues[0] <= 0:
        return out
    values, energy = eigenvalues[:whole], eigenvectors[:, :whole] ** 2
    first = values > values[0] * (1.0 - _SAME_EIGENVALUE)
    out[:, 2] = energy.sum(axis=1) * d / whole
    out[:, 3] = np.sqrt(energy[:, first].sum(axis=1) * d / int(first.sum()))
    closeness = 1.0 - values / values[0]
    for column, scale in enumerate(HEAT_SCALES, start=4):
        out[:, column] = (energy * np.exp(-scale * NUM_PAIRS * closeness)).sum(axis=1) * d / whole
    return out


class GraphSpectrum:
    """The accumulated graph and its largest eigenpairs; each solution starts from the last one."""

    def __init__(self, solver: str) -> None:
        self._solve: Callable[..., Spectrum] = SOLVERS[solver]
        self._graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
        self._previous: Spectrum | None = None
        self._solved_s = -np.inf

    def observe(
        self, ids: IntArray, xy: FloatArray, nearest: NDArray[np.int32] | None = None
    ) -> None:
        """Add the next positions to the graph; see `TrafficGraph.observe`."""
        self._graph = self._graph.observe(ids, xy, nearest)

    def solve(self, ids: IntArray) -> tuple[Spectrum, IntArray, FloatArray]:
        """The spectrum now, the rows of the given agents in it, and the degrees of all vertices."""
        self._previous = self._solve(
            self._graph, num_pairs=NUM_PAIRS + 1, end="largest", previous=self._previous
        )
        rows = self._graph.rows_of(ids)
        return self._previous, rows, self._graph.degree

    def moment(self, time_s: float, ids: IntArray) -> FloatArray:
        """(n, F + 1) invariant features of the agents and a one; zeros while no spectrum is due."""
        if time_s - self._solved_s < SPECTRUM_EVERY_S - 1e-6:
            return np.zeros((ids.size, SPECTRAL))
        self._solved_s = time_s
        spectrum, rows, degrees = self.solve(ids)
        values = invariant(spectrum.eigenvalues, spectrum.eigenvectors, degrees)
        return np.concatenate([values[rows], np.ones((ids.size, 1))], axis=1)


def spectral_means(sums: FloatArray) -> FloatArray:
    """(n, F) means of the invariant features over the moments summed in (n, F + 1)."""
    total = sums[:, -1:]
    return np.asarray(sums[:, :-1] / np.where(total > 1e-9, total, 1.0))


class EigenvectorObserver(Observer):
    """The features of the paper: rows of the matrix of the largest eigenvectors, now."""

    feature_names = tuple(f"u_{k + 1}" for k in range(NUM_PAIRS))

    def __init__(self, solver: str = "graphrqi") -> None:
        super().__init__()
        self._spectrum = GraphSpectrum(solver)

    def _moment(
        self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray
    ) -> FloatArray:
        """Extend the graph; there is no additive evidence."""
        self._spectrum.observe(ids, xy)
        return np.zeros((ids.size, 0))

    def observation(self) -> Observation:
        """The drivers present with their rows of the graph's present spectrum."""
        present = super().observation()
        spectrum, rows, _ = self._spectrum.solve(present.ids)
        vectors = np.zeros((rows.size, NUM_PAIRS))  # stay zero where there are fewer pairs
        known = spectrum.eigenvectors[rows, :NUM_PAIRS]
        vectors[:, : known.shape[1]] = known
        return present._replace(instant=vectors)


class SpectrumObserver(Observer):
    """Invariant spectral features of each driver, averaged over the time observed."""

    feature_names = tuple(f"spectrum_{name}" for name in INVARIANT_NAMES)

    def __init__(self, solver: str = "graphrqi") -> None:
        super().__init__(solver, SPECTRAL)
        self._spectrum = GraphSpectrum(solver)

    def _moment(
        self, time_s: float, ids: IntArray, xy: FloatArray, drives: BoolArray
    ) -> FloatArray:
        """(n, SPECTRAL) see `GraphSpectrum.moment`."""
        self._spectrum.observe(ids, xy)
        return self._spectrum.moment(time_s, ids)

    def features(self, seconds: FloatArray, sums: FloatArray, instant: FloatArray) -> FloatArray:
        """(n, F) means over the time observed."""
        return spectral_means(sums)
