"""TIMERS: first-order perturbation of k pairs, and a restart when a bound says it drifted.

Each step moves the k pairs by first-order perturbation theory inside their own span. The loss ||M -
U diag(s) U^T||_F^2 is compared with a lower bound on that of the best rank-k approximation. The
bound is the loss at the last restart plus the change of trace of M M^T, less that change's k
largest eigenvalues. Beyond a margin the method restarts.

Assumes changes that are small against the gaps between eigenvalues; a traffic graph's are not,
so it restarts at most steps, and costs what its dense restart costs. Between restarts its vectors
are of first order only.

References:
    Zhang, Cui, Pei, Wang, Zhu (2018), TIMERS: Error-bounded SVD restart on dynamic networks, AAAI.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import Pairs, Problem, eigensolver
from graphrqi.spectrum.rivals.low_rank import Tracked, carried_over, report, restart
from graphrqi.spectrum.spectrum import Floats
from graphrqi.spectrum.subspaces import pick

MARGIN = 0.01
"""Loss above the bound, relative to the bound, that calls for a restart; the authors try .01 to .2
and we take their strictest."""


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Perturb the k pairs of this solver's last answer, or restart."""
    before = carried_over(problem)
    if before is not None:
        old, w, weights = before
        values, vectors = perturb(old.values, old.vectors, w, weights)
        moved = replace(old, values=values, vectors=vectors)
        if not drifted(problem.graph, moved):
            return report(problem, moved, "")
    return report(problem, restart(problem), "restarted")


def perturb(values: Floats, vectors: Floats, w: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """First-order change of eigenpairs inside their own span, by W diag(S) W^T."""
    small = w.T @ vectors
    change = small.T @ (weights[:, None] * small)
    gap = values[None, :] - values[:, None]
    usable = np.abs(gap) > np.abs(change)  # first order means nothing where the gap is smaller
    mixing = np.where(usable, change / np.where(usable, gap, 1.0), 0.0)
    vectors, corner = np.linalg.qr(vectors + vectors @ mixing)
    return values + np.diag(change), vectors * np.where(np.diag(corner) < 0.0, -1.0, 1.0)


def drifted(graph: TrafficGraph, tracked: Tracked) -> bool:
    """Whether the loss exceeds the least possible by more than the margin (theorem 1).

    Always, where vehicles came or went since the last restart.
    """
    if not np.array_equal(tracked.base.ids, graph.ids):
        return True
    now, then = (_matrix(g, tracked.bound) for g in (graph, tracked.base))
    u = tracked.vectors
    inner = np.einsum("ij,ij->j", u, now @ u)
    loss = (now**2).sum() - 2.0 * (tracked.values * inner).sum() + (tracked.values**2).sum()
    growth = now @ now.T - then @ then.T
    top = np.asarray(np.linalg.eigvalsh(growth), dtype=np.float64)
    best = tracked.base_loss + np.trace(growth) - top[pick(top, u.shape[1], "largest")].sum()
    return bool(loss - best > MARGIN * max(best, 1e-12 * float((now**2).sum())))


def _matrix(graph: TrafficGraph, bound: float) -> Floats:
    """The matrix that is tracked."""
    laplacian: Floats = graph.laplacian.toarray()
    return bound * np.eye(graph.ids.size) - laplacian if bound else laplacian
