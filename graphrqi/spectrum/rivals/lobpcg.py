"""Locally optimal block preconditioned conjugate gradients, warm-started (scipy's lobpcg).

Needs products with L only, and improves the earlier vectors: O((m + d k) k) per iteration. Without
a preconditioner its convergence depends on the gap after the k-th pair relative to the whole
spectrum; at the smallest end of a long road that takes hundreds of iterations, cut off here.
Started from vectors of the last graph it holds on to them, and does not see an eigenvalue that
arrived outside their span.

References:
    Knyazev (2001), SIAM J. Sci. Comput. 23, 517-541.
"""

from __future__ import annotations

import warnings

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
    starting_block,
)
from graphrqi.spectrum.rivals import eigh

MAX_ITERATIONS = 100
"""Iterations before giving up (our choice; scipy's own default is 20)."""


def solve(
    graph: TrafficGraph,
    num_pairs: int = 8,
    end: End = "largest",
    previous: Spectrum | None = None,
    tol: float = 1e-8,
    nonzero: bool = False,
) -> Spectrum:
    """Improve the earlier vectors with ``scipy.sparse.linalg.lobpcg``.

    Args:
        graph: d vehicles.
        num_pairs: how many pairs, at most d are returned.
        end: "largest" or "smallest".
        previous: earlier answer, its vectors are the start.
        tol: residual asked for, relative to max(1, lambda_max).
        nonzero: leave out the null space.

    Returns:
        The pairs, converged or not; not certified, except where a fifth of all pairs or more
        were asked for and the answer is `graphrqi.spectrum.rivals.eigh`'s.

    Raises:
        InputError: for an argument out of range.
    """
    from scipy.linalg import LinAlgWarning
    from scipy.sparse.linalg import lobpcg

    check_arguments(num_pairs, end, tol)
    d = graph.ids.size
    null = null_space(graph) if nonzero else np.zeros((d, 0))
    k = min(num_pairs, d - null.shape[1])
    if k < 1 or 5 * k + null.shape[1] >= d:
        return eigh.solve(graph, num_pairs, end, previous, tol, nonzero)
    start = starting_block(graph, k, previous, null)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # not converged: the residuals say so
        warnings.simplefilter("ignore", LinAlgWarning)
        values, vectors = lobpcg(
            graph.laplacian,
            start,
            Y=null if null.shape[1] else None,
            tol=tol * max(1.0, lambda_max_floor(graph)),
            maxiter=MAX_ITERATIONS,
            largest=end == "largest",
        )
    values = np.asarray(values, dtype=np.float64)
    order = pick(values, k, end)
    vectors, _ = np.linalg.qr(vectors[:, order])
    return answer(graph, values[order], np.asarray(vectors), end, tol, complete=False)
