"""Brand's incremental SVD: fold each change of the matrix into a rank-k approximation.

Assumes that the matrix is of low rank, or nearly: what lies outside the k columns is thrown away at
every step. A Laplacian has full rank outside its null space. The error after several steps is of
the order of its (k+1)-th eigenvalue. Costs O(d (k + p)^2) for p changed edges.

References:
    Brand (2006), Fast low-rank modifications of the thin singular value decomposition, Linear
    Algebra and its Applications 415.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver
from graphrqi.spectrum.rivals.low_rank import carried_over, report, restart
from graphrqi.spectrum.spectrum import Floats
from graphrqi.spectrum.subspaces import pick


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Update the k pairs of this solver's last answer by the edges that changed."""
    before = carried_over(problem)
    if before is None:
        return report(problem, restart(problem), "started from a dense solution")
    tracked, w, weights = before
    values, vectors = fold_in(tracked.values, tracked.vectors, w, weights, problem.num_pairs)
    return report(problem, replace(tracked, values=values, vectors=vectors), "")


def fold_in(
    values: Floats, vectors: Floats, w: Floats, weights: Floats, rank: int
) -> tuple[Floats, Floats]:
    """Rank-r approximation of U diag(values) U^T + W diag(S) W^T (Brand's eqs. 2-4)."""
    basis, corner = np.linalg.qr(np.hstack([vectors, w]))
    core = (corner * np.concatenate([values, weights])) @ corner.T
    inner, turn = np.linalg.eigh(0.5 * (core + core.T))
    kept = pick(inner, rank, "largest")
    return inner[kept], basis @ turn[:, kept]
