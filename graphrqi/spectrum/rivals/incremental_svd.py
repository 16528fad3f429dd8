"""Brand's incremental SVD: fold each change of the matrix into a rank-k approximation.

Assumes that the matrix is of low rank, or nearly: what lies outside the k columns is thrown away
at every step. A Laplacian has full rank (d less the number of components), so the error left
after some steps is of the order of its (k+1)-th eigenvalue: residuals of order 1. Costs O(d (k +
p)^2) for p changed edges.

References:
    Brand (2006), Fast low-rank modifications of the thin singular value decomposition,
    Linear Algebra and its Applications 415, 20-30.
"""

from __future__ import annotations

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import End, Floats, Spectrum, check_arguments, pick
from graphrqi.spectrum.rivals.low_rank import Tracked, carried_over, rank_needed, report, restart


def solve(
    graph: TrafficGraph,
    num_pairs: int = 8,
    end: End = "largest",
    previous: Spectrum | None = None,
    tol: float = 1e-8,
    nonzero: bool = False,
) -> Spectrum:
    """Update the k pairs of this solver's last answer by the edges that changed.

    Args:
        graph: d vehicles.
        num_pairs: how many pairs, at most d are returned.
        end: "largest" or "smallest".
        previous: this solver's last answer; else the start is exact.
        tol: only what the answer is judged by.
        nonzero: leave out the null space.

    Returns:
        Orthonormal vectors and the tracked values; never certified.

    Raises:
        InputError: for an argument out of range.
    """
    check_arguments(num_pairs, end, tol)
    rank = rank_needed(graph, num_pairs, end, nonzero)
    before = carried_over(previous, graph, rank, end)
    if before is None:
        tracked, note = restart(graph, rank, end), "started from a dense solution"
    else:
        tracked, w, weights = before
        values, vectors = fold_in(tracked.values, tracked.vectors, w, weights, rank)
        tracked = Tracked(values, vectors, tracked.bound, tracked.base, tracked.base_loss)
        note = ""
    return report(graph, tracked, num_pairs, end, tol, nonzero, note)


def fold_in(
    values: Floats, vectors: Floats, w: Floats, weights: Floats, rank: int
) -> tuple[Floats, Floats]:
    """Rank-r approximation of U diag(values) U^T + W diag(S) W^T (Brand's eqs. 2-4).

    Args:
        values: (q,).
        vectors: (d, q), orthonormal up to rows that were dropped.
        w: (d, p).
        weights: (p,).
        rank: columns to keep.

    Returns:
        (r,) values and (d, r) orthonormal vectors.
    """
    basis, corner = np.linalg.qr(np.hstack([vectors, w]))
    core = (corner * np.concatenate([values, weights])) @ corner.T
    inner, turn = np.linalg.eigh(0.5 * (core + core.T))
    kept = pick(inner, rank, "largest")
    return inner[kept], basis @ turn[:, kept]
