"""The edges in which two traffic graphs differ, for the algorithms that update pairs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.spectrum import Floats, Spectrum


def change_between(before: TrafficGraph, after: TrafficGraph) -> tuple[NDArray[np.int64], Floats]:
    """Compare two graphs by vehicle id; their rows may be in different orders.

    Returns:
        (m, 2) ids of the edges that only one of them has; (m,) 1 for a new edge, -1 for one that is
        gone.

    Examples:
        >>> a = TrafficGraph.from_edges([1, 2, 3], [(1, 2)])
        >>> edges, signs = change_between(a, TrafficGraph.from_edges([3, 2, 4], [(3, 2)]))
        >>> edges.tolist(), signs.tolist()
        ([[1, 2], [2, 3]], [-1.0, 1.0])
    """
    edges = np.sort(np.concatenate([before.edges, after.edges]), axis=1)
    signs = np.repeat([-1.0, 1.0], [len(before.edges), len(after.edges)])
    found, place = np.unique(edges, axis=0, return_inverse=True)
    total = np.bincount(place.ravel(), weights=signs, minlength=len(found))
    return found[total != 0.0], total[total != 0.0]


def rows_of(graph: TrafficGraph, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 2) rows of a graph that edges (m, 2) of ids join."""
    return graph.rows_of(edges.ravel()).reshape(-1, 2)


class AllPairs(NamedTuple):
    """Every eigenvalue (d,) and eigenvector (d, d) of a graph, carried from step to step."""

    values: Floats
    vectors: Floats


def all_pairs_before(previous: Spectrum | None, graph: TrafficGraph) -> AllPairs | None:
    """All pairs of an earlier answer, if its vehicles are the first rows of a graph."""
    if previous is None or not isinstance(previous.carried, AllPairs):
        return None
    before = previous.graph.ids
    return previous.carried if np.array_equal(graph.ids[: before.size], before) else None
