"""All eigenpairs by LAPACK's dense symmetric solver, through numpy.

Assumes nothing and never fails. It costs O(d^3) time and d^2 memory, too much above a few thousand
vehicles.

References:
    Anderson et al. (1999), LAPACK Users' Guide, xSYEVD.

Examples:
    >>> from graphrqi.graph import TrafficGraph
    >>> ring = TrafficGraph.from_edges([0, 1, 2], [(0, 1), (1, 2), (2, 0)])
    >>> solve(ring, 2).eigenvalues.round(6).tolist()
    [3.0, 3.0]
"""

from __future__ import annotations

import numpy as np

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Compute all pairs with ``numpy.linalg.eigh`` and keep those asked for."""
    null = problem.null
    # The null space, if it is left out, is moved above every other eigenvalue.
    matrix = problem.graph.laplacian.toarray() + 4.0 * problem.scale * null @ null.T
    values, vectors = np.linalg.eigh(matrix)
    kept = values.size - null.shape[1]
    return Pairs(*problem.chosen(values[:kept], vectors[:, :kept]), complete=True)
