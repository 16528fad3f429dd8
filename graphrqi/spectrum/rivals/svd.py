"""The singular value decomposition by LAPACK, as the paper's table has it.

A Laplacian is symmetric and positive semidefinite, so its singular values are its eigenvalues
and its left singular vectors eigenvectors. Costs O(d^3), a few times
`graphrqi.spectrum.rivals.eigh`, for it does not use the symmetry; fails nowhere.

References:
    Anderson et al. (1999), LAPACK Users' Guide, xGESDD.
"""

from __future__ import annotations

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import (
    End,
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
    """Compute all pairs with ``numpy.linalg.svd`` and keep those asked for.

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
    """
    check_arguments(num_pairs, end, tol)
    matrix = graph.laplacian.toarray()
    kept = graph.ids.size
    if nonzero:  # move the null space above every other eigenvalue, then leave it out
        null = null_space(graph)
        matrix += 4.0 * max(1.0, lambda_max_floor(graph)) * null @ null.T
        kept -= null.shape[1]
    vectors, values, _ = np.linalg.svd(matrix)
    values, vectors = values[::-1][:kept], vectors[:, ::-1][:, :kept]
    chosen = pick(values, num_pairs, end)
    return answer(graph, values[chosen], vectors[:, chosen], end, tol, complete=True)
