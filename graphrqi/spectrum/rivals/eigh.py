"""All eigenpairs by LAPACK's dense symmetric solver, through numpy.

Assumes nothing and never fails; costs O(d^3) time and d^2 memory, so it is the yardstick below a
few hundred vehicles and out of the question above a few thousand.

References:
    Anderson et al. (1999), LAPACK Users' Guide, xSYEVD.
"""

from __future__ import annotations

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import (
    End,
    Floats,
    Spectrum,
    answer,
    check_arguments,
    lambda_max_floor,
    null_space,
    pick,
)


def solve(
    graph: TrafficGraph,
    num_pairs: int = 8,
    end: End = "largest",
    previous: Spectrum | None = None,
    tol: float = 1e-8,
    nonzero: bool = False,
) -> Spectrum:
    """Compute all pairs with ``numpy.linalg.eigh`` and keep those asked for.

    Args:
        graph: d vehicles.
        num_pairs: how many pairs, at most d are returned.
        end: "largest" or "smallest".
        previous: not needed.
        tol: residual asked for, relative to max(1, lambda_max).
        nonzero: leave out the null space.

    Returns:
        The pairs; complete, because all d were computed.

    Raises:
        InputError: for an argument out of range.

    Examples:
        >>> ring = TrafficGraph.from_edges([0, 1, 2], [(0, 1), (1, 2), (2, 0)])
        >>> solve(ring, 2).eigenvalues.round(6).tolist()
        [3.0, 3.0]
    """
    check_arguments(num_pairs, end, tol)
    values, vectors = dense_pairs(graph, nonzero)
    chosen = pick(values, num_pairs, end)
    return answer(graph, values[chosen], vectors[:, chosen], end, tol, complete=True)


def dense_pairs(graph: TrafficGraph, nonzero: bool) -> tuple[Floats, Floats]:
    """All eigenpairs, ascending, or all but the null space.

    The null space is set aside exactly: adding s N N^T, N the component indicators, moves it
    from 0 to s above every other eigenvalue and touches nothing else.

    Args:
        graph: d vehicles in c components.
        nonzero: leave out the null space.

    Returns:
        (m,) eigenvalues and (d, m) eigenvectors, m = d or d - c.
    """
    matrix = graph.laplacian.toarray()
    if not nonzero:
        values, vectors = np.linalg.eigh(matrix)
        return values, vectors
    null = null_space(graph)
    above = 4.0 * max(1.0, lambda_max_floor(graph))
    values, vectors = np.linalg.eigh(matrix + above * null @ null.T)
    kept = values.size - null.shape[1]
    return values[:kept], vectors[:, :kept]
