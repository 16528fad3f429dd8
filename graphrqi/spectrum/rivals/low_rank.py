"""Shared by the two low-rank tracking methods: the matrix they track and its changes.

Both keep the k largest pairs of a matrix M. It is the Laplacian at the largest end, and s I - L at
the smallest, where s bounds the spectrum. Where vehicles departed, or the spectrum outgrew the old
bound, they start from a dense solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import Pairs, Problem
from graphrqi.spectrum.rivals.changes import change_between, rows_of
from graphrqi.spectrum.spectrum import Floats
from graphrqi.spectrum.subspaces import all_pairs, carry_rows, pick


@dataclass(frozen=True, eq=False)
class Tracked:
    """The rank-r approximation M ~ U diag(values) U^T that is carried from step to step.

    ``bound`` is the s of s I - L, or 0. ``base`` is the graph of the last restart, ``base_loss``
    its loss (squared Frobenius norm).
    """

    values: Floats
    vectors: Floats
    bound: float
    base: TrafficGraph
    base_loss: float


def restart(problem: Problem) -> Tracked:
    """Exact pairs of this graph to track from: the approximation with the smallest loss."""
    values, vectors = all_pairs(problem.graph)
    bound = 4.0 * problem.scale if problem.end == "smallest" else 0.0
    shifted = bound - values if bound else values
    kept = pick(shifted, problem.num_pairs, "largest")
    loss = float((shifted**2).sum() - (shifted[kept] ** 2).sum())
    return Tracked(shifted[kept], vectors[:, kept], bound, problem.graph, loss)


def carried_over(problem: Problem) -> tuple[Tracked, Floats, Floats] | None:
    """The earlier approximation with this graph's rows, and how M changed since.

    M is the old M, bordered by zeros, + W diag(S) W^T: W (d, p) and S (p,) are returned, too; None
    if a restart is needed.
    """
    graph, previous = problem.graph, problem.previous
    old = None if previous is None else previous.carried
    if previous is None or not isinstance(old, Tracked) or previous.end != problem.end:
        return None
    if old.values.size < problem.num_pairs or (old.bound and old.bound < 2.0 * problem.scale):
        return None
    if not np.isin(previous.ids, graph.ids).all():
        return None
    edges, signs = change_between(previous.graph, graph)
    unit = np.eye(graph.ids.size)
    first, last = rows_of(graph, edges).T
    arrived = ~np.isin(graph.ids, previous.ids) if old.bound else np.zeros(graph.ids.size, bool)
    w = np.hstack([unit[:, first] - unit[:, last], unit[:, arrived]])
    signs = -signs if old.bound else signs
    weights = np.concatenate([signs, np.full(int(arrived.sum()), old.bound)])
    return replace(old, vectors=carry_rows(previous, graph, old.vectors)), w, weights


def report(problem: Problem, tracked: Tracked, note: str) -> Pairs:
    """The pairs asked for out of a tracked approximation, which is carried on."""
    values = tracked.bound - tracked.values if tracked.bound else tracked.values
    return Pairs(*problem.chosen(values, tracked.vectors), note=note, carried=tracked)
