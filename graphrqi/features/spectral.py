"""Features of vertices in the spectrum of their traffic graph.

`eigenvector_rows` is what the paper feeds to its classifier: row i of the eigenvector matrix U. An
eigenvector is defined up to its sign, and inside a repeated eigenvalue's space up to a rotation,
so rows of U are not functions of the graph. `invariant` is: it only uses sums f(lambda) u_i^2 over
whole eigenspaces, which no choice of eigenvectors changes, and scales eigenvalues by the largest,
so that neither the number of vehicles nor their order matters.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NUM_PAIRS: Final = 8
"""Eigenpairs kept at the largest end (our choice: the paper does not state its own)."""

HEAT_SCALES: Final = (0.5, 1.0, 2.0, 4.0)
"""Diffusion times of the filters, in units of 1 / lambda_max (our choice: powers of two)."""

INVARIANT_NAMES: Final[tuple[str, ...]] = (
    "degree",
    "degree_over_mean",
    "energy",
    "leading_amplitude",
    *(f"filter_{s:g}" for s in HEAT_SCALES),
)
"""What each column of `invariant` is."""

_SAME_EIGENVALUE: Final = 1e-6
"""Relative distance below which two eigenvalues count as one (solvers deliver 1e-8)."""


def eigenvector_rows(eigenvectors: FloatArray, num_pairs: int = NUM_PAIRS) -> FloatArray:
    """Rows of U, padded with zeros where the graph has fewer pairs than asked for.

    Args:
        eigenvectors: (d, k) columns in descending order of eigenvalue.
        num_pairs: columns wanted.

    Returns:
        (d, num_pairs) one row per vertex.
    """
    d, k = eigenvectors.shape
    out = np.zeros((d, num_pairs))
    out[:, : min(k, num_pairs)] = eigenvectors[:, :num_pairs]
    return out


def whole_eigenspaces(eigenvalues: FloatArray, complete: bool) -> int:
    """How many leading pairs form whole eigenspaces.

    Args:
        eigenvalues: (k,) descending.
        complete: whether these are all of the graph's eigenvalues.

    Returns:
        A count: the last eigenspace is left out if pairs of it may be missing.

    Examples:
        >>> whole_eigenspaces(np.array([5.0, 3.0, 3.0]), complete=False)
        1
    """
    if complete or eigenvalues.size == 0:
        return int(eigenvalues.size)
    tolerance = _SAME_EIGENVALUE * max(1.0, float(abs(eigenvalues[0])))
    return int(np.count_nonzero(eigenvalues > eigenvalues[-1] + tolerance))


def invariant(eigenvalues: FloatArray, eigenvectors: FloatArray, degrees: FloatArray) -> FloatArray:
    """Spectral features that no choice of eigenvectors, order or size changes.

    Args:
        eigenvalues: (k,) largest eigenvalues of the Laplacian, descending.
        eigenvectors: (d, k) orthonormal columns.
        degrees: (d,) weighted degree of each vertex.

    Returns:
        (d, F) columns named by ``INVARIANT_NAMES``: the degree, the degree over the mean one, the
        energy of the vertex in the leading spaces, sqrt(d) times its amplitude in the first
        space (so that a graph twice as large gives the same numbers), and
        sum_k exp(-t (1 - lambda_k / lambda_1)) u_ik^2 for several t, times d / k.
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
