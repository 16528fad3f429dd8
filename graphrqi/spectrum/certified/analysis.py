"""A Laplacian prepared for factorisations."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from graphrqi.graph.ordering import order_rows
from graphrqi.spectrum.certified.factorization import PatternArrays, factor_pattern

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]
Bools: TypeAlias = NDArray[np.bool_]


class Analysis(NamedTuple):
    """A matrix M = L or -L prepared for factorisation; places are those of the elimination order.

    Attributes:
        order: (d,) row at each place, perhaps not of all n rows.
        pattern: the arrays of M's `Pattern`, as a plain tuple: kernels take one in 1 us, a named
            one in 3.
        label: (d,) connected component of each place.
        components: how many there are.
        work: multiplications a factorisation takes.
        scale: largest entry of the diagonal, at least 1.
        product: (n,) L times noise that depends on the ids only: equal products, equal rows.
        changed: (n,) rows in which L differs from an earlier one.
    """

    order: Ints
    pattern: PatternArrays
    label: Ints
    components: int
    work: float
    scale: float
    product: Floats
    changed: Bools

    @property
    def factor_entries(self) -> int:
        """Number of the factor's entries below its diagonal."""
        return self.pattern[1].size


def analyse(
    graph: TrafficGraph,
    order: Ints | None = None,
    sign: float = 1.0,
    earlier: Floats | None = None,
) -> Analysis:
    """Prepare a Laplacian, or its negative, for factorisations.

    Args:
        graph: its Laplacian is the matrix.
        order: elimination order, perhaps not of all rows; a new one of all if not given.
        sign: 1, or -1 for its negative.
        earlier: (d,) the product of the matrix before, by row; infinite where there was none.

    Returns:
        Its pattern.
    """
    if order is None:
        order = order_rows(graph.indptr, graph.indices)[0][::-1].copy()
    if earlier is None:
        earlier = np.full(graph.ids.size, np.inf)
    matrix = (graph.ids, graph.indptr, graph.indices, graph.values)
    return Analysis(order, *factor_pattern(*matrix, sign, order, earlier))


def workspace_for(analysis: Analysis, workspace: Floats | None) -> Floats:
    """Memory that a factor fits into: the one given, or more.

    A factor's memory asked for anew at every step is given back to the system at every step, and
    touching it the first time costs as much as the factorisation.

    Args:
        analysis: the matrix.
        workspace: (r, 8) memory of an earlier step, if there is any.

    Returns:
        (m, 8) memory, m > number of the factor's entries.
    """
    entries = analysis.factor_entries
    if workspace is not None and len(workspace) > entries:
        return workspace
    return np.empty((entries + entries // 4 + 1, 8))
