"""GraphRQI, certified: the default solver.

Rayleigh-quotient iterations for the k wanted pairs that share their factorisations:

1. Reverse Cuthill-McKee order (kept from step to step while it serves), elimination tree, pattern
   (almost no fill on traffic graphs).
2. Rayleigh-Ritz in the span of the earlier eigenvectors, carried over by vehicle id. In a large
   graph the eigenvectors of the largest eigenvalues live around a few vehicles of high degree:
   all of this is done first for the part of the matrix where they are, which gives vectors that
   the whole matrix only has to confirm. What that part misses, steps 3 to 5 find.
3. One kernel factorises L - s I at eight shifts s at once: the Rayleigh quotients of the
   unconverged vectors, and places where something has to be counted. Each factorisation is
   applied twice to its vector, and a Rayleigh-Ritz step in the span of the eight results, outside
   the pairs found already, gives the next ones. Where by the gain so far the same factors will do
   for all that is left, they are applied once more (twice, where the factor is dense) instead.
4. The number of negative pivots of each factorisation is the number of eigenvalues below its
   shift (Sylvester's law of inertia). These counts say in which interval an eigenvalue is
   missing; there a new vector is started, mostly noise on the vehicles whose edges changed,
   because every eigenvector that the change made has a part there.
5. It ends when a count just below the k-th value equals the number of pairs found above it,
   allowing for the rounding error of the factorisation (largest pivot times unit roundoff).
   Where eigenvalues equal to the k-th follow, those are found too.

At the smallest end it runs on -L outside the null space, which is known exactly (the component
indicators). Where the certificate is not reached it starts again without the earlier vectors,
then falls back on dense solutions by component (d up to 3000), then on ARPACK with a count;
``note`` says so, and ``certified`` is False if even that could not be shown.

Assumes little fill: costs O(d) per step where the factor has O(d) entries, as for vehicles on roads
seen at one time; an accumulated graph of a crowded crossing fills in, and each factorisation then
costs the sum of the squared column counts. Small graphs, and requests for a third of all pairs or
more, are answered densely by component, which is faster there.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, sections 3.3, 4.6-4.9, 11.
    Grimes, Lewis, Simon (1994), A shifted block Lanczos algorithm, SIMAX 15, 228-272.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.certified import active_rows, analysis, tracking
from graphrqi.spectrum.certified.certificate import MAX_WORK, certify
from graphrqi.spectrum.certified.search import Goal
from graphrqi.spectrum.contract import Pairs, answer, check_arguments
from graphrqi.spectrum.full import pairs_by_component
from graphrqi.spectrum.rivals import arpack
from graphrqi.spectrum.spectrum import End, Floats, Spectrum
from graphrqi.spectrum.subspaces import (
    carry_rows,
    dense_pairs,
    null_space,
    pick,
)

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
ACTIVE_FROM = 600
"""Vertices from which the part where the vectors are is treated first (measured)."""
STALE = 1.15
"""Growth of the fill after which vertices are ordered anew: ordering costs as much (measured)."""
EXTRA = 8
"""Pairs beyond the k-th, found because they equal it, that are kept to start from."""


class Carried(NamedTuple):
    """What the next step starts from.

    Attributes:
        vectors: (d, m) all eigenvectors found, m >= k, without the null space.
        order: (d,) elimination order to use again, or None to find a new one.
        fill: entries of the factor to one of the matrix when that order was found.
        product: (d,) the Laplacian times noise, see `analysis.Analysis`, infinite for a new row;
            None if not known.
        workspace: (r, 8) memory that a factor fitted into; its numbers mean nothing.
    """

    vectors: Floats
    order: NDArray[np.int32] | None = None
    fill: float = 0.0
    product: Floats | None = None
    workspace: Floats | None = None


def solve(
    graph: TrafficGraph,
    num_pairs: int = 8,
    end: End = "largest",
    previous: Spectrum | None = None,
    tol: float = 1e-8,
    nonzero: bool = False,
) -> Spectrum:
    """Compute pairs at one end and certify that none was missed.

    Args:
        graph: d vehicles.
        num_pairs: how many pairs, at most d are returned.
        end: "largest" or "smallest".
        previous: earlier answer to start from, of other vehicles too.
        tol: residual asked for, relative to max(1, lambda_max).
        nonzero: leave out the null space.

    Returns:
        The pairs, certified; ``note`` tells of a fallback.

    Raises:
        InputError: for an argument out of range.

    Examples:
        >>> road = [(i, i + 1) for i in range(99)]
        >>> first = solve(TrafficGraph.from_edges(range(100), road), 3)
        >>> exact = 2 - 2 * np.cos(np.pi * np.arange(99, 96, -1) / 100)
        >>> bool(abs(first.eigenvalues - exact).max() < 1e-12), first.certified
        (True, True)
        >>> closed = TrafficGraph.from_edges(range(100), [*road, (99, 0)])
        >>> solve(closed, 3, previous=first).eigenvalues.round(6).tolist()
        [4.0, 3.996053, 3.996053]
    """
    check_arguments(num_pairs, end, tol, previous)
    d = graph.ids.size
    if d < DENSE_BELOW:
        values, vectors = dense_pairs(graph, null_space(graph) if nonzero else None)
        chosen = pick(values, num_pairs, end)
        kept = vectors[:, chosen]
        return answer(graph, Pairs(values[chosen], kept, True, "", Carried(kept)), end, tol)
    if DENSE_SHARE * num_pairs >= d:
        return _dense(graph, num_pairs, end, tol, nonzero, "")
    warm = previous if previous is not None and previous.end == end else None
    found = _track(graph, num_pairs, end, warm, tol, nonzero)
    if found is None and warm is not None:
        again = _track(graph, num_pairs, end, None, tol, nonzero)
        if again is not None:
            found = replace(again, note="started again without the earlier vectors")
    if found is None:
        found = _fall_back(graph, num_pairs, end, tol, nonzero)
    return found


def _track(
    graph: TrafficGraph,
    num_pairs: int,
    end: End,
    previous: Spectrum | None,
    tol: float,
    nonzero: bool,
) -> Spectrum | None:
    """Analyse a Laplacian, track its pairs, and put the answer together; None if given up."""
    d = graph.ids.size
    start = _start(graph, previous)
    smallest = end == "smallest"
    matrix = analysis.analyse(graph, start.order, -1.0 if smallest else 1.0, start.product)
    zeros, k = 0, num_pairs
    if smallest and not nonzero:
        zeros = min(matrix.components, num_pairs)
        k = num_pairs - zeros
    elif smallest or nonzero:
        k = min(k, d - matrix.components)
    if DENSE_SHARE * k >= d - matrix.components:
        return _dense(graph, num_pairs, end, tol, nonzero, "")
    if matrix.work > MAX_WORK:
        return None
    if k == 0:
        null, carried = null_space(graph)[:, :zeros], Carried(np.empty((d, 0)))
        return answer(graph, Pairs(np.zeros(zeros), null, True, "", carried), end, tol)
    fill = (matrix.factor_entries + 1.0) / (0.5 * (graph.indices.size - d) + 1.0)
    first_fill = fill if start.order is None else start.fill
    scale = matrix.scale
    low, high = -1.0, 2.0 * scale + 1.0  # Gershgorin: at most twice the largest degree
    if smallest:
        low, high = -high, 0.0
    sweeps = MAX_SWEEPS_COLD if previous is None else MAX_SWEEPS
    goal = Goal(int(k), EXTRA, smallest, scale, float(tol), low, high, sweeps)
    vectors = start.vectors
    workspace = analysis.workspace_for(matrix, start.workspace)
    if not smallest and d >= ACTIVE_FROM and vectors.shape[1] >= k:
        vectors = active_rows.track_active(graph, matrix, goal, vectors, workspace)
    certified, pairs, found, departure = tracking.track(matrix, goal, vectors, workspace)
    if not certified:
        return None
    values, residuals = pairs[0, :k].copy(), pairs[1, :k].copy()
    if smallest:
        values = -values
    if departure > 1e-12:
        # Newton's step to the nearest orthonormal block squares the departure
        found = 1.5 * found - 0.5 * found @ (found.T @ found)
        residuals = np.linalg.norm(graph.laplacian @ found[:, :k] - found[:, :k] * values, axis=0)
        if residuals.max() > tol * scale or departure > 1e-5:
            return None
    if zeros:
        null = null_space(graph)[:, :zeros]
        values = np.concatenate((np.zeros(zeros), values))
        residuals = np.concatenate((np.zeros(zeros), residuals))
        vectors = np.concatenate((null, found[:, :k]), axis=1)
    else:
        vectors = found[:, :k].copy()
    order = matrix.order if fill <= STALE * first_fill else None
    carried = Carried(found, order, first_fill, matrix.product, workspace)
    return Spectrum(graph.ids, values, vectors, residuals, True, graph, end, "", carried)


def _start(graph: TrafficGraph, previous: Spectrum | None) -> Carried:
    """What is known of this graph from the earlier answer; vectors by row of this graph."""
    if previous is None:
        return Carried(np.empty((graph.ids.size, 0)))
    found = previous.carried
    if not isinstance(found, Carried):
        found = Carried(previous.eigenvectors)
    if previous.ids is not graph.ids and not np.array_equal(previous.ids, graph.ids):
        vectors, product = carry_rows(previous, graph, found.vectors), found.product
        if product is not None:
            product = np.append(product, np.inf)[previous.graph.rows_of(graph.ids)]
        found = found._replace(vectors=vectors, order=None, product=product)
    if not found.vectors.flags.writeable:  # for another type the kernel would be compiled anew
        found = found._replace(vectors=found.vectors.copy())
    return found


def _dense(
    graph: TrafficGraph, num_pairs: int, end: End, tol: float, nonzero: bool, note: str
) -> Spectrum:
    values, vectors, null = pairs_by_component(graph)
    if not nonzero:
        values = np.concatenate([np.zeros(null.shape[1]), values])
        vectors = np.hstack([null, vectors])
    if end == "largest":
        values, vectors = values[::-1], vectors[:, ::-1]
    values, vectors = values[:num_pairs].copy(), vectors[:, :num_pairs].copy()
    return answer(graph, Pairs(values, vectors, True, note, Carried(vectors)), end, tol)


def _fall_back(
    graph: TrafficGraph, num_pairs: int, end: End, tol: float, nonzero: bool
) -> Spectrum:
    if graph.ids.size <= DENSE_UP_TO:
        return _dense(graph, num_pairs, end, tol, nonzero, "fell back on a dense solution")
    found = arpack.solve(graph, num_pairs, end, None, tol, nonzero)
    carried = Carried(found.eigenvectors)
    return certify(replace(found, note="fell back on ARPACK", carried=carried), tol)
