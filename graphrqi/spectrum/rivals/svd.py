"""The singular value decomposition by LAPACK, as the paper's table has it.

A Laplacian is symmetric and positive semidefinite, so its singular values are its eigenvalues
and its left singular vectors eigenvectors. Costs O(d^3), a few times
`graphrqi.spectrum.eigh`, for it does not use the symmetry; fails nowhere.

References:
    Anderson et al. (1999), LAPACK Users' Guide, xGESDD.
"""

from __future__ import annotations

import numpy as np

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Compute all pairs with ``numpy.linalg.svd`` and keep those asked for."""
    vectors, values, _ = np.linalg.svd(problem.graph.laplacian.toarray())
    return Pairs(*problem.chosen(values, vectors), complete=True)
