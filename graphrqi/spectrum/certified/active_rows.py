"""The part of a large graph in which its leading eigenvectors live, treated before the whole.

The eigenvectors of the largest eigenvalues are localised around vertices of high degree.
"""

from __future__ import annotations

import math

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.certified.analysis import (
    Analysis,
    Bools,
    Floats,
    Ints,
    analyse,
    workspace_for,
)
from graphrqi.spectrum.certified.factorization import Pattern
from graphrqi.spectrum.certified.search import Goal
from graphrqi.spectrum.certified.tracking import track
from sim.compiled import compiled

NEGLIGIBLE = 1e-9
"""Size of a vector's entries that do not matter for residuals of 1e-8."""
AROUND = 12
"""Edges around a vertex that may have a new vector, whose entries fall by some 5 an edge."""
MAX_SWEEPS = 12
"""Factorisations of the part before it is left to the whole."""


@compiled
def active_rows(
    order: Ints,
    diagonal: Floats,
    changed: Bools,
    indptr: Ints,
    indices: Ints,
    values: Floats,
    vectors: Floats,
    k: int,
    most: int,
) -> Bools:
    """Rows in which eigenvectors of the largest eigenvalues are not negligible, probably.

    These are the rows that matter in the earlier vectors, and those around changed rows that may
    have a vector now: the largest eigenvalue of a vertex i and its neighbours is about
    degree_i + sum_j 1 / (lambda - degree_j), which is compared with that of the vertices that
    have one.

    Args:
        order: (d,) row at each place of the elimination order.
        diagonal: (d,) of the Laplacian, by place.
        changed: (d,) rows in which the Laplacian changed.
        indptr: (d + 1,) the Laplacian in CSR: row starts,
        indices: columns,
        values: and values.
        vectors: (d, m) earlier eigenvectors.
        k: how many of them matter.
        most: stop when there are more rows.

    Returns:
        (d,) whether a row is one of them.
    """
    d = changed.size
    degree, steps = np.empty(d, np.float64), np.empty(d, np.int32)
    queue, peak = np.empty(d + 1, np.int32), np.empty(k, np.int32)
    height, active = np.empty(k, np.float64), np.empty(d, np.bool_)
    for c in range(k):
        peak[c], height[c] = 0, 0.0
    n = 0
    for j in range(d):
        degree[order[j]] = diagonal[j]
    for i in range(d):  # rows that matter in the earlier vectors
        largest = 0.0
        for c in range(k):
            size = abs(vectors[i, c])
            largest = max(largest, size)
            if size > height[c]:
                peak[c], height[c] = i, size
        active[i] = largest > NEGLIGIBLE
        steps[i] = 1
        queue[n] = i
        n += active[i]
    level = least = math.inf
    for c in range(k):
        level = min(level, degree[peak[c]] + 1.0)
    for t in range(k + d):  # the vectors' largest entries, then changed rows like them
        i = peak[t] if t < k else t - k
        if t >= k and (not changed[i] or degree[i] + 1.0 < 0.5 * level):
            continue
        value = degree[i]
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] != i:
                value += values[p] * values[p] / max(level - degree[indices[p]], 1.0)
        if t < k:
            least = min(least, value)
        elif value >= least:
            steps[i] = AROUND
            queue[n] = i
            n += not active[i]
            active[i] = True
    head = 0
    while head < n and n <= most:  # and the rows around all of these
        i = queue[head]
        head += 1
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            if steps[i] > 0 and not active[j]:
                active[j] = True
                steps[j] = steps[i] - 1
                queue[n] = j
                n += 1
    return active


def track_active(
    graph: TrafficGraph, whole: Analysis, goal: Goal, start: Floats, workspace: Floats
) -> Floats:
    """Better vectors to start from: those of the part of the matrix in which they live.

    Args:
        graph: d vehicles.
        whole: of its Laplacian.
        goal: what is searched for in the whole.
        start: (d, m) vectors to start from.
        workspace: memory for the factor, as of `workspace_for` the whole matrix.

    Returns:
        (d, m) the part's eigenvectors, 0 in the other rows; ``start`` if they were not found.
    """
    order, k = whole.order, goal.k
    most = order.size // 2
    matrix = (graph.indptr, graph.indices, graph.values)
    active = active_rows(
        order, Pattern(*whole.pattern).diagonal, whole.changed, *matrix, start, k, most
    )
    active_order = order[active[order]]
    if not 8 * k <= active_order.size <= most:
        return start
    part = analyse(graph, active_order)._replace(changed=whole.changed)
    part_goal = goal._replace(tol=0.5 * goal.tol, max_sweeps=MAX_SWEEPS)
    certified, _, vectors, _ = track(part, part_goal, start, workspace_for(part, workspace))
    return vectors if certified else start
