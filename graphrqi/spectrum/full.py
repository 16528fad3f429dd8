"""All eigenpairs of a graph, component by component.

The Laplacian of a graph in pieces is block diagonal, so its spectrum is the union of the pieces'.
Costs the sum of the cubes of the component sizes: for a crossing with d = 1000 in pieces a tenth of
one dense solution. The null space comes out exactly, as the indicators of the components.
"""

from __future__ import annotations

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import Pairs, answer
from graphrqi.spectrum.spectrum import Floats, Spectrum
from graphrqi.spectrum.subspaces import components, laplacian_scale


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


def pairs_by_component(graph: TrafficGraph) -> tuple[Floats, Floats, Floats]:
    """Every eigenpair of d vehicles in c components, with the null space apart.

    Returns (d - c,) nonzero eigenvalues, ascending, (d, d - c) their eigenvectors, and (d, c) the
    orthonormal indicators of the components.
    """
    d = graph.ids.size
    labels = components(graph)
    count = int(labels.max(initial=-1)) + 1
    null = np.zeros((d, count))
    values = np.zeros(d - count)
    vectors = np.zeros((d, d - count))
    laplacian = graph.laplacian
    above = 4.0 * laplacian_scale(graph)
    order = np.argsort(labels, kind="stable")
    bounds = np.searchsorted(labels[order], np.arange(count + 1))
    done = 0
    for c in range(count):
        rows = order[bounds[c] : bounds[c + 1]]
        size = rows.size
        null[rows, c] = 1.0 / np.sqrt(size)
        if size == 1:
            continue
        block: Floats = (laplacian if count == 1 else laplacian[rows][:, rows]).toarray()
        inner, turn = np.linalg.eigh(block + above / size)  # moves 0 above all the rest
        values[done : done + size - 1] = inner[:-1]
        vectors[np.ix_(rows, np.arange(done, done + size - 1))] = turn[:, :-1]
        done += size - 1
    sort = np.argsort(values, kind="stable")
    return values[sort], vectors[:, sort], null


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
