"""GraphRQI, certified: the default solver.

Rayleigh-quotient iterations for the k wanted pairs that share their factorisations:

1. Reverse Cuthill-McKee order, elimination tree, pattern (almost no fill on traffic graphs).
2. Rayleigh-Ritz in the span of the earlier eigenvectors, carried over by vehicle id.
3. One kernel factorises L - s I at eight shifts s at once: the Rayleigh quotients of the
   unconverged vectors, and places where something has to be counted. Each factorisation is
   applied twice to its vector, and a Rayleigh-Ritz step in the span of the eight results, outside
   the pairs found already, gives the next ones.
4. The number of negative pivots of each factorisation is the number of eigenvalues below its
   shift (Sylvester's law of inertia). These counts say in which interval an eigenvalue is
   missing; there a new vector is started from noise.
5. It ends when a count just below the k-th value equals the number of pairs found above it. The
   rounding error of the factorisation is allowed for. Where eigenvalues equal to the k-th follow,
   those are found too.

At the smallest end it runs on -L outside the null space, which is known exactly (the component
indicators). Without a certificate it starts again without the earlier vectors. It then falls back
on dense solutions by component, then on ARPACK with a count. ``note`` names the fallback, and
``certified`` is False if nothing was shown.

Assumes little fill: costs O(d) per step where the factor has O(d) entries, as for vehicles seen at
one time. The accumulated graph of a crowded crossing fills in. Each factorisation then costs the
sum of the squared column counts. Small graphs, and requests for a third of all pairs or more, are
answered densely by component, which is faster there.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, chapters 3, 4 and 11. Grimes, Lewis, Simon
    (1994), A shifted block Lanczos algorithm, SIMAX 15.

Examples:
    >>> from graphrqi.graph import TrafficGraph
    >>> road = [(i, i + 1) for i in range(99)]
    >>> first = solve(TrafficGraph.from_edges(range(100), road), 3)
    >>> exact = 2 - 2 * np.cos(np.pi * np.arange(99, 96, -1) / 100)
    >>> bool(abs(first.eigenvalues - exact).max() < 1e-12), first.certified
    (True, True)
    >>> closed = TrafficGraph.from_edges(range(100), [*road, (99, 0)])
    >>> solve(closed, 3, previous=first).eigenvalues.round(6).tolist()
    [4.0, 3.996053, 3.996053]
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graphrqi.spectrum.certified.certificate import MAX_WORK, certify
from graphrqi.spectrum.certified.factorization import prepare
from graphrqi.spectrum.certified.tracking import Goal, track
from graphrqi.spectrum.contract import Pairs, Problem, Spectrum, carry_rows, eigensolver, null_space
from graphrqi.spectrum.libraries import arpack

DENSE_BELOW = 32
"""Vehicles below which a dense solution is faster (measured)."""
DENSE_SHARE = 3
"""One in this many pairs wanted, and a dense solution is faster (measured)."""
MAX_SWEEPS = 25
"""Factorisations before starting again without the earlier vectors; the median is 2 to 5."""
MAX_SWEEPS_COLD = 150
"""Factorisations before falling back."""
DENSE_UP_TO = 3000
"""Vehicles up to which the fallback is dense: 9e6 doubles."""


@eigensolver()
def solve(problem: Problem) -> Pairs:
    """Track the pairs from the earlier answer, and certify that none was missed."""
    d = problem.graph.ids.size
    if d < DENSE_BELOW or DENSE_SHARE * problem.asked >= d:
        return problem.dense()
    previous = problem.previous
    if previous is not None and previous.end != problem.end:
        previous = None
    found = _track(problem, previous)
    if found is None and previous is not None:
        found = _track(problem, None)
        if found is not None:
            found = replace(found, note="started again without the earlier vectors")
    return _fall_back(problem) if found is None else found


def _track(problem: Problem, previous: Spectrum | None) -> Pairs | None:
    """The pairs by the tracker, which carries all vectors it finds; None if it gives up."""
    graph, tol = problem.graph, problem.tol
    d, smallest = graph.ids.size, problem.end == "smallest"
    start = np.empty((d, 0))
    if previous is not None:
        vectors = previous.carried
        if not isinstance(vectors, np.ndarray):
            vectors = previous.eigenvectors
        start = carry_rows(previous, graph, vectors)
    matrix = prepare(graph, -1.0 if smallest else 1.0)
    zeros = min(matrix.components, problem.asked) if smallest else 0
    k = problem.asked - zeros
    if DENSE_SHARE * k >= d - matrix.components:
        return problem.dense()
    if matrix.work > MAX_WORK:
        return None
    null = null_space(graph)[:, :zeros]
    if k == 0:
        return Pairs(np.zeros(zeros), null, True, "", np.empty((d, 0)))
    low, high = -1.0, 2.0 * matrix.scale + 1.0  # Gershgorin: at most twice the largest degree
    if smallest:
        low, high = -high, 0.0
    sweeps = MAX_SWEEPS_COLD if previous is None else MAX_SWEEPS
    goal = Goal(int(k), smallest, matrix.scale, float(tol), low, high, sweeps)
    certified, values, residuals, found = track(matrix, goal, start)
    if not certified:
        return None
    values, residuals = np.abs(values[:k]), residuals[:k]
    departure = np.abs(found.T @ found - np.eye(found.shape[1])).max()
    if departure > 1e-12:
        # Newton's step to the nearest orthonormal block squares the departure
        found = 1.5 * found - 0.5 * found @ (found.T @ found)
        residuals = np.linalg.norm(graph.laplacian @ found[:, :k] - found[:, :k] * values, axis=0)
        if residuals.max() > tol * matrix.scale or departure > 1e-5:
            return None
    values = np.concatenate((np.zeros(zeros), values))
    residuals = np.concatenate((np.zeros(zeros), residuals))
    return Pairs(values, np.hstack((null, found[:, :k])), True, "", found, residuals)


def _fall_back(problem: Problem) -> Pairs:
    """The pairs where the tracker gave up."""
    if problem.graph.ids.size <= DENSE_UP_TO:
        return problem.dense("fell back on a dense solution")
    found = arpack(problem.graph, problem.asked, problem.end, None, problem.tol)
    certified = certify(found, problem.tol).certified
    return Pairs(found.eigenvalues, found.eigenvectors, certified, "fell back on ARPACK")
