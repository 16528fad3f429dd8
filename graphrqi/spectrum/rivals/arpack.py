"""Implicitly restarted Lanczos (ARPACK through scipy's eigsh).

At the largest end it needs products with L only; at the smallest it is run on the inverse of
L + s I (one sparse LU factorisation), s small and positive because L is singular. Costs some tens
of products or solves, O(m + fill) each, plus O(d k^2): the best general tool at thousands of
vehicles. It cannot see a repeated eigenvalue but by rounding, and so drops pairs without notice
where twins or equal components make them (15 to 20 % of a traffic graph's eigenvalues).

References:
    Lehoucq, Sorensen, Yang (1998), ARPACK Users' Guide.
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
    starting_block,
)
from graphrqi.spectrum.rivals import eigh

SHIFT = 1e-3
"""Shift below the spectrum at the smallest end, relative to max(1, the largest degree) (our choice:
far enough for an accurate factorisation, near enough to separate the smallest eigenvalues)."""


def solve(
    graph: TrafficGraph,
    num_pairs: int = 8,
    end: End = "largest",
    previous: Spectrum | None = None,
    tol: float = 1e-8,
    nonzero: bool = False,
) -> Spectrum:
    """Compute the pairs with ``scipy.sparse.linalg.eigsh``.

    Args:
        graph: d vehicles.
        num_pairs: how many pairs, at most d are returned.
        end: "largest" or "smallest".
        previous: earlier answer; the sum of its vectors is the start.
        tol: residual asked for, relative to max(1, lambda_max).
        nonzero: leave out the null space.

    Returns:
        The pairs; not certified, except where half of all pairs or more were asked for and the
        answer is `graphrqi.spectrum.rivals.eigh`'s.

    Raises:
        InputError: for an argument out of range.
    """
    from scipy.sparse import csc_array, eye_array
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

    check_arguments(num_pairs, end, tol)
    d = graph.ids.size
    null = null_space(graph) if nonzero else np.zeros((d, 0))
    k = min(num_pairs, d - null.shape[1])
    if k < 1 or 2 * k >= d:
        return eigh.solve(graph, num_pairs, end, previous, tol, nonzero)
    start = starting_block(graph, k, previous, null).sum(axis=1)
    rng = np.random.default_rng(0)  # for restarts; scipy's own differs from call to call
    laplacian = graph.laplacian
    scale = max(1.0, lambda_max_floor(graph))
    note = ""
    try:
        if end == "largest":
            values, vectors = eigsh(laplacian, k, which="LA", v0=start, tol=0.1 * tol, rng=rng)
        else:
            shift = SHIFT * scale
            factor = splu(csc_array(laplacian + shift * eye_array(d)))

            def inverse(x: Floats) -> Floats:
                y: Floats = factor.solve(x - null @ (null.T @ x))
                return y - null @ (null.T @ y)

            operator = LinearOperator((d, d), matvec=inverse, dtype=np.float64)
            _, vectors = eigsh(operator, k, which="LA", v0=start, tol=0.1 * tol, rng=rng)
            values = np.einsum("ij,ij->j", vectors, laplacian @ vectors)
            note = f"shift {shift:.1e} below the spectrum"
    except ArpackError as error:
        found = eigh.solve(graph, num_pairs, end, previous, tol, nonzero)
        return answer(
            graph, found.eigenvalues, found.eigenvectors, end, tol, True, f"solved anew: {error}"
        )
    order = pick(values, k, end)
    vectors, _ = np.linalg.qr(vectors[:, order])
    return answer(graph, values[order], vectors, end, tol, False, note)
