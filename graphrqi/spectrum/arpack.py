"""Implicitly restarted Lanczos (ARPACK through scipy's eigsh).

At the largest end it needs products with L only. At the smallest it runs on the inverse of L + s I
(one sparse LU factorisation), s > 0 because L is singular. Costs some tens of products or solves,
O(m + fill) each, plus O(d k^2): the best general tool at thousands of vehicles. It cannot see a
repeated eigenvalue but by rounding, and so drops pairs without notice where twins or equal
components make them (15 to 20 % of a traffic graph's eigenvalues).

References:
    Lehoucq, Sorensen, Yang (1998), ARPACK Users' Guide.
"""

from __future__ import annotations

import numpy as np

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver
from graphrqi.spectrum.spectrum import Floats

SHIFT = 1e-3
"""Shift below the spectrum at the smallest end, relative to max(1, the largest degree) (far enough
for an accurate factorisation, near enough to separate the smallest eigenvalues)."""


@eigensolver(dense_share=2)
def solve(problem: Problem) -> Pairs:
    """Compute the pairs with ``scipy.sparse.linalg.eigsh``, from the sum of the earlier vectors."""
    from scipy.sparse import csc_array, eye_array
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

    laplacian, k = problem.graph.laplacian, problem.num_pairs
    d = problem.graph.ids.size
    start = problem.starting_block().sum(axis=1)
    rng = np.random.default_rng(0)  # for restarts; scipy's own differs from call to call
    goal = 0.1 * problem.tol
    note = ""
    try:
        if problem.end == "largest":
            values, vectors = eigsh(laplacian, k, which="LA", v0=start, tol=goal, rng=rng)
        else:
            shift = SHIFT * problem.scale
            factor = splu(csc_array(laplacian + shift * eye_array(d)))

            def inverse(x: Floats) -> Floats:
                y: Floats = factor.solve(x)
                return y

            operator = LinearOperator((d, d), matvec=inverse, dtype=np.float64)
            _, vectors = eigsh(operator, k, which="LA", v0=start, tol=goal, rng=rng)
            values = np.einsum("ij,ij->j", vectors, laplacian @ vectors)
            note = f"shift {shift:.1e} below the spectrum"
    except ArpackError as error:
        return problem.dense(f"solved anew: {error}")
    values, vectors = problem.chosen(values, vectors)
    return Pairs(values, np.linalg.qr(vectors)[0], note=note)
