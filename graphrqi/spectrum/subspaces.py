"""Pieces that eigenvalue algorithms of a graph's Laplacian are made of.

Exact null space, dense solution, starting vectors, the Rayleigh-Ritz step, and bounds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.spectrum import End, Floats, Spectrum


def laplacian_scale(graph: TrafficGraph) -> float:
    """Size of a Laplacian: its largest vertex degree, at least 1.

    The largest eigenvalue is between the largest degree (x^T L x of that vertex) and twice that
    (Gershgorin).
    """
    return max(1.0, float(graph.values.max(initial=0.0)))  # entries off the diagonal are negative


def pick(values: Floats, num_pairs: int, end: End) -> NDArray[np.intp]:
    """Positions (min(num_pairs, d),) of the pairs asked for, in the order of an end."""
    order = np.argsort(values, kind="stable")
    return (order[::-1] if end == "largest" else order)[:num_pairs]


def components(graph: TrafficGraph) -> NDArray[np.int32]:
    """Number (d,) of each vehicle's connected component, in the order of their first rows."""
    from scipy.sparse.csgraph import connected_components

    labels: NDArray[np.int32] = connected_components(graph.laplacian, directed=False)[1]
    return labels


def null_space(graph: TrafficGraph) -> Floats:
    """Exact orthonormal basis of the Laplacian's null space.

    Args:
        graph: d vehicles in c connected components.

    Returns:
        (d, c) indicator of each component over the square root of its size.

    Examples:
        >>> null_space(TrafficGraph.from_edges([1, 2, 3], [(1, 2)])).round(3).tolist()
        [[0.707, 0.0], [0.707, 0.0], [0.0, 1.0]]
    """
    labels = components(graph)
    sizes = np.bincount(labels)
    basis = np.zeros((labels.size, sizes.size))
    basis[np.arange(labels.size), labels] = 1.0 / np.sqrt(sizes[labels])
    return basis


def all_pairs(graph: TrafficGraph) -> tuple[Floats, Floats]:
    """Every eigenpair of d vehicles: (d,) eigenvalues, ascending, and (d, d) eigenvectors.

    The Laplacian of a graph in pieces is block diagonal. The null space comes out exactly, as the
    indicators of the components. Costs the sum of the cubes of the component sizes.
    """
    null, laplacian, d = null_space(graph), graph.laplacian, graph.ids.size
    labels, above, zeros = components(graph), 4.0 * laplacian_scale(graph), null.shape[1]
    values, vectors = np.zeros(zeros), np.zeros((d, d))
    vectors[:, :zeros] = null
    for c in range(zeros):
        rows = np.flatnonzero(labels == c)
        block: Floats = (laplacian if zeros == 1 else laplacian[rows][:, rows]).toarray()
        inner, turn = np.linalg.eigh(block + above / rows.size)  # moves 0 above all the rest
        vectors[np.ix_(rows, values.size + np.arange(rows.size - 1))] = turn[:, :-1]
        values = np.append(values, inner[:-1])
    sort = np.argsort(values, kind="stable")
    return values[sort], vectors[:, sort]


def carry_rows(previous: Spectrum, graph: TrafficGraph, vectors: Floats | None = None) -> Floats:
    """Columns over an earlier answer's vehicles with the rows of a later graph, by vehicle id.

    They are the earlier eigenvectors unless given; rows of new vehicles are 0.
    """
    old = previous.eigenvectors if vectors is None else vectors
    rows = np.zeros((graph.ids.size, old.shape[1]))
    place = previous.graph.rows_of(graph.ids)
    rows[place >= 0] = old[place[place >= 0]]
    return rows


def rayleigh_ritz(graph: TrafficGraph, basis: Floats, end: End) -> tuple[Floats, Floats]:
    """(m,) Ritz values and (d, m) Ritz vectors in a basis (d, m), in the order of the end."""
    values, turn = np.linalg.eigh(basis.T @ (graph.laplacian @ basis))
    order = pick(values, values.size, end)
    return values[order], basis @ turn[:, order]
