"""What the two low-rank tracking methods share: the matrix they track and its changes.

Both keep the k largest pairs of a matrix M: the Laplacian itself at the largest end, s I - L at
the smallest, where s bounds the spectrum (and the null space, if it is to be left out, is taken
away from the k kept, so one more column per component is tracked).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphrqi.graph import TrafficGraph, change_between
from graphrqi.spectrum.contract import (
    End,
    Floats,
    Spectrum,
    answer,
    carry_rows,
    lambda_max_floor,
    null_space,
    pick,
    rayleigh_ritz,
)
from graphrqi.spectrum.rivals import eigh


@dataclass(frozen=True, eq=False)
class Tracked:
    """The rank-r approximation M ~ U diag(values) U^T that is carried from step to step.

    Attributes:
        values: (r,) of M.
        vectors: (d, r) orthonormal.
        bound: the s of s I - L, or 0 at the largest end.
        base: the graph of the last restart.
        base_loss: squared Frobenius norm of M - U diag(values) U^T then.
    """

    values: Floats
    vectors: Floats
    bound: float
    base: TrafficGraph
    base_loss: float


def rank_needed(graph: TrafficGraph, num_pairs: int, end: End, nonzero: bool) -> int:
    """Columns to track so that the pairs asked for are among them.

    Args:
        graph: d vehicles.
        num_pairs: pairs asked for.
        end: which end.
        nonzero: leave out the null space.

    Returns:
        At most d.
    """
    extra = null_space(graph).shape[1] if nonzero and end == "smallest" else 0
    return min(num_pairs + extra, graph.ids.size)


def restart(graph: TrafficGraph, rank: int, end: End) -> Tracked:
    """Exact pairs of this graph, to track from.

    Args:
        graph: d vehicles.
        rank: columns to keep.
        end: which end.

    Returns:
        The approximation with the smallest loss.
    """
    values, vectors = eigh.dense_pairs(graph, False)
    bound = 4.0 * max(1.0, lambda_max_floor(graph)) if end == "smallest" else 0.0
    shifted = bound - values if bound else values
    kept = pick(shifted, rank, "largest")
    loss = float((shifted**2).sum() - (shifted[kept] ** 2).sum())
    return Tracked(shifted[kept], vectors[:, kept], bound, graph, loss)


def carried_over(
    previous: Spectrum | None, graph: TrafficGraph, rank: int, end: End
) -> tuple[Tracked, Floats, Floats] | None:
    """The earlier approximation with this graph's rows, and how M changed since.

    Args:
        previous: the earlier answer.
        graph: d vehicles.
        rank: columns needed.
        end: which end.

    Returns:
        None if a restart is needed (no earlier answer of this method and end, too few columns,
        or a spectrum above the old bound). Else the approximation, (d, p) columns W and (p,)
        weights S such that M is the old M (bordered by zeros) + W diag(S) W^T.
    """
    old = None if previous is None else previous.carried
    if previous is None or not isinstance(old, Tracked) or previous.end != end:
        return None
    if old.values.size < rank or (old.bound and old.bound < 2.0 * lambda_max_floor(graph)):
        return None
    vectors = carry_rows(previous, graph, old.vectors)
    change = change_between(previous.graph, graph)
    staying = np.isin(change.edges, graph.ids).all(axis=1)
    order = np.argsort(graph.ids)
    ends = order[np.searchsorted(graph.ids[order], change.edges[staying])]
    weights = change.weights[staying]
    w = np.zeros((graph.ids.size, len(ends)))
    w[ends[:, 0], np.arange(len(ends))] = 1.0
    w[ends[:, 1], np.arange(len(ends))] = -1.0
    lost = np.zeros(graph.ids.size)  # an edge to a departed vehicle leaves its end's degree
    for (a, b), weight in zip(change.edges[~staying], change.weights[~staying], strict=True):
        for vehicle in (a, b):
            lost[graph.ids == vehicle] += weight
    hit = np.flatnonzero(lost)
    sign = -1.0 if old.bound else 1.0
    columns, sizes = [w, np.eye(graph.ids.size)[:, hit]], [sign * weights, sign * lost[hit]]
    if old.bound and change.arrived.size:
        columns.append(np.eye(graph.ids.size)[:, np.isin(graph.ids, change.arrived)])
        sizes.append(np.full(change.arrived.size, old.bound))
    tracked = Tracked(old.values, vectors, old.bound, old.base, old.base_loss)
    return tracked, np.hstack(columns), np.concatenate(sizes)


def report(
    graph: TrafficGraph,
    tracked: Tracked,
    num_pairs: int,
    end: End,
    tol: float,
    nonzero: bool,
    note: str,
) -> Spectrum:
    """Answer with the pairs asked for out of a tracked approximation.

    Args:
        graph: d vehicles.
        tracked: the approximation of this graph.
        num_pairs: pairs asked for.
        end: which end.
        tol: what the answer is judged by.
        nonzero: leave out the null space.
        note: remark.

    Returns:
        The answer, never certified.
    """
    values = tracked.bound - tracked.values if tracked.bound else tracked.values
    vectors = tracked.vectors
    if nonzero and end == "smallest":
        null = null_space(graph)
        outside = vectors - null @ (null.T @ vectors)
        strongest = np.linalg.svd(outside, full_matrices=False)[0]
        kept = min(num_pairs, vectors.shape[1] - null.shape[1])
        values, vectors = rayleigh_ritz(graph, strongest[:, :kept], end)
    chosen = pick(values, min(num_pairs, values.size), end)
    if nonzero and end == "largest":
        chosen = chosen[: graph.ids.size - null_space(graph).shape[1]]
    return answer(graph, values[chosen], vectors[:, chosen], end, tol, False, note, tracked)
