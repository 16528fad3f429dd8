"""The paper's algorithm made correct: every eigenpair updated by Rayleigh-quotient iterations.

GraphRQI (Chandra et al. 2020) keeps all eigenpairs of the last graph and updates each by
Rayleigh-quotient iteration, the shifted inverse being applied through the old eigenbasis by
Sherman-Morrison. With w_e = e_i - e_j for every edge whose weight changed by s_e,

    L_t = blk(L_{t-1}, 0) + W S W^T,

so in the old eigenbasis (padded with e_new at eigenvalue 0) the inverse of
Lambda - mu I + W^ S W^^T is Woodbury's formula with one (p, p) system per pair.

Differs from the paper: the update is a Laplacian, p edges at once; pairs that converge to one
and the same vector are found by a pivoted orthogonalisation and made up for by a Rayleigh-Ritz
step in the complement (deflation); the iteration stops on its residual.

Assumes that the vehicles of the earlier graph are all still there (else it restarts from a dense
solution) and that few edges changed. Costs O(d p^2) for each of d pairs and O(d^3) for the
back-transformation with d^2 memory: asymptotically no better than solving anew.

Examples:
    >>> from graphrqi.graph import TrafficGraph
    >>> first = solve(TrafficGraph.from_edges([1, 2, 3, 4], [(1, 2), (2, 3), (3, 4)]))
    >>> longer = TrafficGraph.from_edges([1, 2, 3, 4], [(1, 2), (2, 3), (3, 4), (1, 3)])
    >>> second = solve(longer, 4, previous=first)
    >>> bool(abs(second.eigenvalues - [4, 3, 1, 0]).max() < 1e-12)
    True
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import change_between
from graphrqi.spectrum.contract import Pairs, Problem, eigensolver
from graphrqi.spectrum.spectrum import Floats
from graphrqi.spectrum.subspaces import dense_pairs, pick, rayleigh_ritz

MAX_ITERATIONS = 8
"""Rayleigh-quotient iterations per pair; they converge cubically."""
DEPENDENT = 0.1
"""A converged vector with less of it than this outside the span of the others is a duplicate."""
RESTART_EDGES = 2.0
"""Changed edges, in units of the square root of d, above which it solves anew: the update's d^2 p^2
is then beyond any use."""


@dataclass(frozen=True, eq=False)
class AllPairs:
    """What the update starts from.

    Attributes:
        values: (d,) all eigenvalues.
        vectors: (d, d) all eigenvectors.
    """

    values: Floats
    vectors: Floats


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Update all pairs of this solver's last answer to this graph; ``carried`` holds all."""
    pairs, note = _updated(problem)
    values, vectors = dense_pairs(problem.graph) if pairs is None else pairs
    kept = AllPairs(values, vectors)
    if problem.nonzero:
        null, end = problem.null, problem.end
        outside, _ = np.linalg.qr(np.hstack([null, vectors[:, pick(-values, values.size, end)]]))
        values, vectors = rayleigh_ritz(problem.graph, outside[:, null.shape[1] :], end)
    return Pairs(*problem.chosen(values, vectors), complete=True, note=note, carried=kept)


def _updated(problem: Problem) -> tuple[tuple[Floats, Floats] | None, str]:
    """All pairs, updated from the earlier answer; None if that cannot be done, and a remark."""
    graph, previous = problem.graph, problem.previous
    d = graph.ids.size
    if previous is None or not isinstance(previous.carried, AllPairs):
        return None, "solved anew: no earlier answer of this solver"
    before = previous.graph
    if not np.array_equal(graph.ids[: before.ids.size], before.ids):
        return None, "solved anew: vehicles departed or changed their order"
    change = change_between(before, graph)
    if len(change.edges) > RESTART_EDGES * d**0.5:
        return None, f"solved anew: {len(change.edges)} edges changed"
    goal = 0.1 * problem.tol * problem.scale
    order = np.argsort(graph.ids)
    ends = order[np.searchsorted(graph.ids[order], change.edges)]
    values, vectors, finished = _update(previous.carried, d, ends, change.weights, goal)
    drift = np.linalg.norm(graph.laplacian @ vectors - vectors * values, axis=0)
    if drift.max(initial=0.0) > 10.0 * goal:
        return None, "solved anew: rounding errors had built up"
    note = f"{d - finished} of {d} pairs by Rayleigh-Ritz" if finished < d else ""
    return (values, vectors), note


def _update(
    old: AllPairs, d: int, ends: NDArray[np.int64], weights: Floats, goal: float
) -> tuple[Floats, Floats, int]:
    """All eigenpairs after a change of p edges.

    Args:
        old: the c pairs before.
        d: vehicles now, the first c of them being the old ones.
        ends: (p, 2) rows joined by the changed edges.
        weights: (p,) their change of weight, not 0.
        goal: residual at which a pair has converged.

    Returns:
        (d,) eigenvalues ascending, (d, d) eigenvectors, and how many converged to
        different vectors by themselves.
    """
    c = old.values.size
    spread = np.concatenate([old.values, np.zeros(d - c)])
    basis = np.eye(d)
    basis[:c, :c] = old.vectors
    w = basis[ends[:, 0]].T - basis[ends[:, 1]].T  # (d, p) W^ = U^T W
    scale = max(1.0, float(np.abs(spread).max(initial=0.0)) + 2.0 * float(np.abs(weights).sum()))
    x = np.eye(d)  # column j is the iterate of pair j in the old eigenbasis
    shift = spread + (w**2) @ weights
    norms = np.full(d, np.inf)
    active = np.arange(d)
    for _ in range(MAX_ITERATIONS):
        y = _shifted_solves(spread, w, weights, shift[active], x[:, active], scale)
        y /= np.linalg.norm(y, axis=0)
        small = w.T @ y
        applied = spread[:, None] * y + w @ (weights[:, None] * small)
        shift[active] = np.einsum("ij,ij->j", y, applied)
        norms[active] = np.linalg.norm(applied - y * shift[active], axis=0)
        x[:, active] = y
        active = active[norms[active] > goal]
        if not active.size:
            break
    order = np.concatenate([np.flatnonzero(norms <= goal), np.flatnonzero(norms > goal)])
    accepted = np.zeros((d, d))
    m = 0
    for j in order:  # Gram-Schmidt, twice; converged pairs first
        if norms[j] > goal:
            break
        v = x[:, j] - accepted[:, :m] @ (accepted[:, :m].T @ x[:, j])
        length = float(np.linalg.norm(v))
        if length < DEPENDENT:
            continue
        v /= length
        v -= accepted[:, :m] @ (accepted[:, :m].T @ v)
        accepted[:, m] = v / np.linalg.norm(v)
        m += 1
    everything = np.diag(spread) + (w * weights) @ w.T
    frame, _ = np.linalg.qr(accepted[:, :m], mode="complete")
    frame[:, :m] = accepted[:, :m]
    inside = frame.T @ everything @ frame
    if m < d:  # what no iteration reached: Rayleigh-Ritz in the orthogonal complement
        _, turn = np.linalg.eigh(inside[m:, m:])
        frame[:, m:] = frame[:, m:] @ turn
    final = np.einsum("ij,ij->j", frame, everything @ frame)
    order = np.argsort(final, kind="stable")
    return final[order], (basis @ frame)[:, order], m


def _shifted_solves(
    spread: Floats, w: Floats, weights: Floats, shifts: Floats, x: Floats, scale: float
) -> Floats:
    """(Lambda - mu_j I + W S W^T)^-1 x_j for every pair j, by Woodbury's formula.

    Args:
        spread: (d,) Lambda.
        w: (d, p).
        weights: (p,) diagonal of S.
        shifts: (m,) mu.
        x: (d, m) right-hand sides.
        scale: size of the matrix; a shift within rounding of a pole is moved off it.

    Returns:
        (d, m) solutions.
    """
    gap = spread[:, None] - shifts
    floor = 1e-15 * scale
    gap = np.where(np.abs(gap) < floor, np.where(gap < 0.0, -floor, floor), gap)
    solved = x / gap
    core = np.diag(1.0 / weights)
    out = solved
    for j in range(shifts.size):
        scaled = w / gap[:, j : j + 1]
        system = core + w.T @ scaled
        right = w.T @ solved[:, j]
        try:
            step = np.linalg.solve(system, right)
        except np.linalg.LinAlgError:  # the shift is an eigenvalue to the last bit
            step = np.linalg.lstsq(system, right, rcond=None)[0]
        out[:, j] -= scaled @ step
    return out
