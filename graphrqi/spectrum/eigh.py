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

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Compute all pairs with ``numpy.linalg.eigh`` and keep those asked for."""
    return problem.dense()
