"""All eigenpairs of a graph, component by component.

The Laplacian of a graph in pieces is block diagonal, so its spectrum is the union of the pieces'.
The null space comes out exactly, as the indicators of the components.
"""

from __future__ import annotations

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import Pairs, answer
from graphrqi.spectrum.spectrum import Floats, Spectrum
from graphrqi.spectrum.subspaces import pairs_by_component


def full_spectrum(graph: TrafficGraph, tol: float = 1e-8) -> Spectrum:
    """Compute every eigenpair, ascending.

    Args:
        graph: d vehicles.
        tol: residual up to which the answer counts as certified, relative to max(1, lambda_max).

    Returns:
        All d pairs, as the smallest end.

    Examples:
        >>> pairs = full_spectrum(TrafficGraph.from_edges([1, 2, 3, 4], [(1, 2), (3, 4)]))
        >>> pairs.eigenvalues.round(6).tolist()
        [0.0, 0.0, 2.0, 2.0]
    """
    values, vectors, null = pairs_by_component(graph)
    values = np.concatenate([np.zeros(null.shape[1]), values])
    pairs = Pairs(values, np.hstack([null, vectors]), complete=True)
    return answer(graph, pairs, "smallest", tol)


def topology(spectrum: Spectrum) -> Floats:
    """The paper's topology w_i = L u_i (eq. 1) of every pair.

    For an exact pair it is lambda_i u_i; computed from L, it shows an inexact one as it is.

    Args:
        spectrum: k pairs of d vehicles.

    Returns:
        (d, k) L u_i in columns.

    Examples:
        >>> pairs = full_spectrum(TrafficGraph.from_edges([1, 2], [(1, 2)]))
        >>> abs(topology(pairs)).round(3).tolist()
        [[0.0, 1.414], [0.0, 1.414]]
    """
    product: Floats = spectrum.graph.laplacian @ spectrum.eigenvectors
    return product
