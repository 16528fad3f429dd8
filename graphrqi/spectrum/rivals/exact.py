"""The paper's algorithm made correct: every eigenpair updated by Rayleigh-quotient iterations.

With w_e = e_i - e_j for every edge that came (s_e = 1) or went (-1),

    L_t = blk(L_{t-1}, 0) + W S W^T,

so Woodbury's formula gives the inverse of Lambda - mu I + W^ S W^^T in the old eigenbasis, with one
(p, p) system per pair.

Differs from the paper: the update is a Laplacian, p edges at once. Pairs that converge to the same
vector are replaced by a Rayleigh-Ritz step in the complement (deflation). The iteration stops on
its residual.

Assumes that the vehicles of the earlier graph are all still there (else it starts from a dense
solution) and that few edges changed. Costs O(d p^2) for each of d pairs and O(d^3) for the
back-transformation with d^2 memory: asymptotically no better than a new solution.

"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver
from graphrqi.spectrum.rivals.changes import AllPairs, all_pairs_before, change_between, rows_of
from graphrqi.spectrum.spectrum import Floats
from graphrqi.spectrum.subspaces import all_pairs

MAX_ITERATIONS = 8
"""Rayleigh-quotient iterations per pair; they converge cubically."""
DEPENDENT = 0.1
"""A converged vector with less of it than this outside the span of the others is a duplicate."""
RESTART_EDGES = 2.0
"""Changed edges, in units of the square root of d, above which it starts from a dense solution."""


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Update all pairs of this solver's last answer to this graph; ``carried`` holds all."""
    pairs, note = _updated(problem)
    kept = AllPairs(*all_pairs(problem.graph)) if pairs is None else pairs
    return Pairs(*problem.chosen(*kept), complete=True, note=note, carried=kept)


def _updated(problem: Problem) -> tuple[AllPairs | None, str]:
    """All pairs, updated from the earlier answer; None if that cannot be done, and a remark."""
    graph, previous = problem.graph, problem.previous
    old = all_pairs_before(previous, graph)
    if old is None or previous is None:
        return None, "solved anew: no earlier answer of this solver, or vehicles departed"
    edges, signs = change_between(previous.graph, graph)
    if len(edges) > RESTART_EDGES * graph.ids.size**0.5:
        return None, f"solved anew: {len(edges)} edges changed"
    goal = 0.1 * problem.tol * problem.scale
    values, vectors = pairs = update(old, graph.ids.size, rows_of(graph, edges), signs, goal)
    drift = np.linalg.norm(graph.laplacian @ vectors - vectors * values, axis=0)
    if drift.max(initial=0.0) > 10.0 * goal:
        return None, "solved anew: rounding errors had built up"
    return pairs, ""


def update(old: AllPairs, d: int, ends: NDArray[np.int64], signs: Floats, goal: float) -> AllPairs:
    """All eigenpairs of d vehicles, ascending, after the change of p edges.

    The first vehicles are those of ``old``. ``ends`` (p, 2) are rows of the edges, and ``signs``
    (p,) are 1 or -1. ``goal`` is the residual of convergence.
    """
    c = old.values.size
    spread = np.concatenate([old.values, np.zeros(d - c)])
    basis = np.eye(d)
    basis[:c, :c] = old.vectors
    w = basis[ends[:, 0]].T - basis[ends[:, 1]].T  # (d, p) W^ = U^T W
    scale = max(1.0, float(np.abs(spread).max(initial=0.0)) + 2.0 * signs.size)
    x = np.eye(d)  # column j is the iterate of pair j in the old eigenbasis
    shift = spread + (w**2) @ signs
    norms = np.full(d, np.inf)
    active = np.arange(d)
    for _ in range(MAX_ITERATIONS):
        y = _shifted_solves(spread, w, signs, shift[active], x[:, active], scale)
        y /= np.linalg.norm(y, axis=0)
        applied = spread[:, None] * y + w @ (signs[:, None] * (w.T @ y))
        shift[active] = np.einsum("ij,ij->j", y, applied)
        norms[active] = np.linalg.norm(applied - y * shift[active], axis=0)
        x[:, active] = y
        active = active[norms[active] > goal]
        if not active.size:
            break
    everything = np.diag(spread) + (w * signs) @ w.T
    frame, corner, _ = qr(x[:, norms <= goal], pivoting=True)
    m = int((np.abs(np.diag(corner)) >= DEPENDENT).sum())
    if m < d:  # what no iteration reached: Rayleigh-Ritz in the orthogonal complement
        rest = frame[:, m:]
        frame[:, m:] = rest @ np.linalg.eigh(rest.T @ everything @ rest)[1]
    final = np.einsum("ij,ij->j", frame, everything @ frame)
    order = np.argsort(final, kind="stable")
    return AllPairs(final[order], (basis @ frame)[:, order])


def _shifted_solves(
    spread: Floats, w: Floats, signs: Floats, shifts: Floats, x: Floats, scale: float
) -> Floats:
    """(Lambda - mu_j I + W S W^T)^-1 x_j for every pair j, by Woodbury's formula."""
    gap = spread[:, None] - shifts
    floor = 1e-15 * scale  # a shift within rounding of a pole is moved off it
    gap = np.where(np.abs(gap) < floor, np.where(gap < 0.0, -floor, floor), gap)
    out = x / gap
    for j in range(shifts.size):
        scaled = w / gap[:, j : j + 1]
        system, right = np.diag(1.0 / signs) + w.T @ scaled, w.T @ out[:, j]
        try:
            step = np.linalg.solve(system, right)
        except np.linalg.LinAlgError:  # the shift is an eigenvalue to the last bit
            step = np.linalg.lstsq(system, right, rcond=None)[0]
        out[:, j] -= scaled @ step
    return out
