"""The edges in which two traffic graphs differ, for the algorithms that update pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.spectrum import Floats, Spectrum


@dataclass(frozen=True, eq=False)
class GraphChange:
    """The edges in which a graph differs from an earlier one.

    Attributes:
        edges: (m, 2) ids of the edges that only one of them has.
        signs: (m,) 1 for a new edge, -1 for one that is gone.
    """

    edges: NDArray[np.int64]
    signs: Floats

    def rows(self, graph: TrafficGraph) -> NDArray[np.int64]:
        """(m, 2) rows of a graph that the edges join, which has all their vehicles."""
        order = np.argsort(graph.ids)
        rows: NDArray[np.int64] = order[np.searchsorted(graph.ids[order], self.edges)]
        return rows


def change_between(before: TrafficGraph, after: TrafficGraph) -> GraphChange:
    """Compare two graphs by vehicle id; their rows may be in different orders.

    Examples:
        >>> a = TrafficGraph.from_edges([1, 2, 3], [(1, 2)])
        >>> change = change_between(a, TrafficGraph.from_edges([3, 2, 4], [(3, 2)]))
        >>> change.edges.tolist(), change.signs.tolist()
        ([[1, 2], [2, 3]], [-1.0, 1.0])
    """
    edges = np.sort(np.concatenate([before.edges, after.edges]), axis=1)
    signs = np.repeat([-1.0, 1.0], [len(before.edges), len(after.edges)])
    found, place = np.unique(edges, axis=0, return_inverse=True)
    total = np.bincount(place.ravel(), weights=signs, minlength=len(found))
    return GraphChange(found[total != 0.0], total[total != 0.0])


@dataclass(frozen=True, eq=False)
class AllPairs:
    """Every eigenpair of a graph, as an algorithm that updates all of them carries it on.

    Attributes:
        values: (d,) all eigenvalues.
        vectors: (d, d) all eigenvectors.
    """

    values: Floats
    vectors: Floats


def all_pairs_before(previous: Spectrum | None, graph: TrafficGraph) -> AllPairs | None:
    """All pairs of an earlier answer, if its vehicles are the first rows of a graph."""
    if previous is None or not isinstance(previous.carried, AllPairs):
        return None
    before = previous.graph.ids
    return previous.carried if np.array_equal(graph.ids[: before.size], before) else None
