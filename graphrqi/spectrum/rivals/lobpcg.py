"""Locally optimal block preconditioned conjugate gradients, warm-started (scipy's lobpcg).

Needs products with L only, and improves the earlier vectors: O((m + d k) k) per iteration. Without
a preconditioner its convergence depends on the gap after the k-th pair relative to the spectrum.
The smallest end of a long road would take hundreds of iterations. Started from vectors of the last
graph it holds on to them, and does not see an eigenvalue that arrived outside their span.

References:
    Knyazev (2001), SIAM J. Sci. Comput. 23, 517-541.
"""

from __future__ import annotations

import warnings

import numpy as np

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver

MAX_ITERATIONS = 100
"""Iterations before giving up (scipy's own default is 20)."""


@eigensolver(dense_share=5)
def solve(problem: Problem) -> Pairs:
    """Improve the earlier vectors with ``scipy.sparse.linalg.lobpcg``, converged or not."""
    from scipy.linalg import LinAlgWarning
    from scipy.sparse.linalg import lobpcg

    start = problem.starting_block()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # not converged: the residuals say so
        warnings.simplefilter("ignore", LinAlgWarning)
        values, vectors = lobpcg(
            problem.graph.laplacian,
            start,
            tol=problem.tol * problem.scale,
            maxiter=MAX_ITERATIONS,
            largest=problem.end == "largest",
        )
    values, vectors = problem.chosen(np.asarray(values, dtype=np.float64), np.asarray(vectors))
    return Pairs(values, np.linalg.qr(vectors)[0])
