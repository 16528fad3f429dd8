"""GraphRQI as it is printed, with the residual it really has.

Chandra et al. (2020), eq. 2 and algorithm 1: every arrival of edges at a vehicle is taken as

    L_t = [L_{t-1} 0; 0 1] + delta delta^T

(without the border where the vehicle was there already). delta is 1 at its new neighbours. Each
eigenpair follows by Rayleigh-quotient iterations x <- (L_t - mu I)^-1 x, the inverse by
Sherman-Morrison in the old eigenbasis. This matrix is not a Laplacian for any binary delta, so the
pairs drift from the graph's at the first step. Edges that vanish have no update. Several pairs
converge to the same vector, so the columns are not orthonormal. The answer's ``residuals`` show the
resulting error. docs/spectrum.md shows each error in two lines; `graphrqi.spectrum.rivals.exact` is
the same algorithm made right.

The printed loop, "while ||x_new - x_old|| <= eps", is reversed (it would stop at once); it is run
the way it must have been meant. Costs O(d^2) per iteration and O(d^3) per arrival.
"""

from __future__ import annotations

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import Pairs, Problem, eigensolver
from graphrqi.spectrum.rivals.changes import AllPairs, all_pairs_before, change_between, rows_of
from graphrqi.spectrum.spectrum import Floats
from graphrqi.spectrum.subspaces import all_pairs

MAX_ITERATIONS = 5
"""Rayleigh-quotient iterations per pair and update (none is printed)."""
CHANGE = 1e-8
"""The printed eps: change of the unit vector at which the iteration ends; the value is ours."""


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Update all pairs of this solver's last answer by the printed formula.

    Without such an answer, or where vehicles departed, it starts from a dense solution, which
    alone can be certified.
    """
    graph, previous = problem.graph, problem.previous
    old = all_pairs_before(previous, graph)
    if old is None or previous is None:
        pairs, note = AllPairs(*all_pairs(graph)), "solved anew"
    else:
        pairs, note = _follow(old, previous.graph, graph), ""
    chosen = problem.chosen(*pairs)
    return Pairs(*chosen, complete=note != "", note=note, carried=pairs)


def _follow(pairs: AllPairs, before: TrafficGraph, graph: TrafficGraph) -> AllPairs:
    """Apply the printed update once for every vehicle that gained edges."""
    values, vectors = pairs
    edges, signs = change_between(before, graph)
    first, last = np.sort(rows_of(graph, edges)[signs > 0.0], axis=1).T
    grown = range(before.ids.size, graph.ids.size)
    for vertex in sorted({*last.tolist(), *grown}):
        if vertex in grown:
            values = np.append(values, 1.0)
            border = np.eye(values.size)
            border[:-1, :-1] = vectors
            vectors = border
        delta = np.zeros(values.size)
        delta[first[last == vertex]] = 1.0
        values, vectors = _rank_one(values, vectors, delta)
    return AllPairs(values, vectors)


def _rank_one(values: Floats, vectors: Floats, delta: Floats) -> tuple[Floats, Floats]:
    """Rayleigh-quotient iterations for every pair of U Lambda U^T + delta delta^T.

    U is taken for orthonormal as the paper does; nothing keeps the new vectors different.
    """
    r = vectors.T @ delta
    x = np.eye(values.size)
    shift = values + r**2
    for _ in range(MAX_ITERATIONS):
        gap = values[:, None] - shift
        gap = np.where(np.abs(gap) < 1e-14, 1e-14, gap)
        ax, ar = x / gap, r[:, None] / gap
        denominator = 1.0 + r @ ar
        denominator = np.where(np.abs(denominator) < 1e-14, 1e-14, denominator)
        y = ax - ar * ((r @ ax) / denominator)  # Sherman-Morrison
        length = np.linalg.norm(y, axis=0)
        usable = (length > 0.0) & np.isfinite(length)
        y = np.where(usable, y / np.where(usable, length, 1.0), x)
        change = np.minimum(np.linalg.norm(y - x, axis=0), np.linalg.norm(y + x, axis=0)).max()
        x = y
        shift = values @ x**2 + (r @ x) ** 2
        if change <= CHANGE:
            break
    moved = vectors @ x  # the columns of U may have become dependent: a zero column stays zero
    length = np.linalg.norm(moved, axis=0)
    return shift, moved / np.where(length > 0.0, length, 1.0)
