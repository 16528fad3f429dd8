"""The traffic graph and the rule by which observations of positions extend it.

Each vehicle is joined to its k nearest, and edges of all frames since the last reset are kept.
Source: Chandra et al., GraphRQI: Classifying driver behaviors using graph spectrums (ICRA 2020),
section III. Differs from the paper: the Laplacian is D - A throughout. The paper's recurrence does
not give a Laplacian, see docs/spectrum.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from behaviors.errors import InputError
from graphrqi.graph.sighting import Sighting, checked_ids

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Kind: TypeAlias = Literal["accumulated", "instantaneous"]


@dataclass(frozen=True)
class ObservationRule:
    """How positions become edges.

    Attributes:
        neighbors: nearest vehicles that each vehicle is joined to.
        reset: observations between resets of an accumulated graph.
        kind: "accumulated" keeps every vehicle and edge since the reset, "instantaneous" none.
    """

    neighbors: int = 4
    reset: int = 100
    kind: Kind = "accumulated"

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InputError: naming the field.
        """
        for name, value in (("neighbors", self.neighbors), ("reset", self.reset)):
            whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
            if not whole or value < 1:
                raise InputError(f"{name}: found {value!r}, expected a whole number from 1 on")
        if self.kind not in get_args(Kind):
            raise InputError(f"kind: found {self.kind!r}, expected {' or '.join(get_args(Kind))}")


@dataclass(frozen=True, eq=False, repr=False)
class TrafficGraph:
    """An undirected graph of vehicles, as its Laplacian D - A.

    Make one with `from_edges`, or with `empty` and then `observe`.

    Attributes:
        ids: (d,) the vehicle of each row.
        indptr: (d + 1,) row starts of the Laplacian in CSR form.
        indices: (z,) its columns, sorted in each row.
        values: (z,) its values.
        rule: how observations extend the graph, if they do.
        observations: how many since the last reset.

    Examples:
        >>> graph = TrafficGraph.empty(neighbors=1).observe([3, 1, 2], [[0, 0], [1, 0], [9, 0]])
        >>> graph.edges.tolist()
        [[3, 1], [1, 2]]
    """

    ids: NDArray[np.int64]
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    values: NDArray[np.float64]
    rule: ObservationRule | None = None
    observations: int = 0

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.ids, self.indptr, self.indices, self.values):
            array.setflags(write=False)

    def __repr__(self) -> str:
        """How many vehicles and edges, and how observations extend the graph.

        Examples:
            >>> TrafficGraph.from_edges([4, 5, 6], [(4, 5), (5, 6)])
            TrafficGraph(3 vehicles with ids 4 to 6, 2 edges)
        """
        d = self.ids.size
        edges = (self.indices.size - d) // 2
        parts = [f"{d} vehicle{'s' * (d != 1)}", f"{edges} edge{'s' * (edges != 1)}"]
        if d:
            parts[0] += f" with ids {self.ids.min()} to {self.ids.max()}"
        if self.rule is not None:
            parts.append(f"{self.rule.kind} over {self.observations} observations")
        return f"TrafficGraph({', '.join(parts)})"

    @classmethod
    def from_edges(cls, ids: ArrayLike, edges: ArrayLike) -> TrafficGraph:
        """Build a graph from a list of edges.

        Args:
            ids: (d,) different whole numbers, one per vehicle; the order of the rows.
            edges: (m, 2) ids of the joined vehicles, undirected; repeated ones count once.

        Returns:
            The graph.

        Raises:
            InputError: for an id that is given twice, unknown or no whole number, an edge from
                a vehicle to itself, or a wrong shape.
        """
        row_ids = checked_ids(ids)
        d = row_ids.size
        order = np.argsort(row_ids, kind="stable")
        ordered = row_ids[order]
        twice = np.flatnonzero(ordered[1:] == ordered[:-1])
        if twice.size:
            raise InputError(f"ids: found {ordered[twice[0]]} twice, expected each vehicle once")
        shape = np.shape(edges)
        if np.size(edges) and (len(shape) != 2 or shape[1] != 2):
            raise InputError(f"edges: found shape {shape}, expected (m, 2)")
        pairs = checked_ids(np.ravel(edges), "edges").reshape(-1, 2)
        known = np.isin(pairs, row_ids)
        if not known.all():
            raise InputError(f"edges: found vehicle {pairs[~known][0]}, expected one of ids")
        itself = np.flatnonzero(pairs[:, 0] == pairs[:, 1])
        if itself.size:
            raise InputError(
                f"edges: found {pairs[itself[0], 0]} joined to itself, expected two vehicles"
            )
        rows = order[np.searchsorted(ordered, pairs)] if len(pairs) else pairs
        both = np.concatenate([rows, rows[:, ::-1], np.arange(d)[:, None].repeat(2, axis=1)])
        line, column = np.unique(both, axis=0).T
        indptr = np.searchsorted(line, np.arange(d + 1)).astype(np.int32)
        value = np.where(line == column, np.diff(indptr)[line] - 1.0, -1.0)
        return cls(row_ids, indptr, column.astype(np.int32), value)

    @classmethod
    def empty(
        cls, neighbors: int = 4, reset: int = 100, kind: Kind = "accumulated"
    ) -> TrafficGraph:
        """Return a graph without vehicles that knows how to grow, see `ObservationRule`.

        Args:
            neighbors: nearest vehicles each vehicle is joined to.
            reset: observations between resets of an accumulated graph.
            kind: "accumulated" or "instantaneous".

        Returns:
            The graph.

        Raises:
            InputError: naming the argument that is out of range.
        """
        rule = ObservationRule(neighbors, reset, kind)
        none = np.empty(0, np.int32)
        return cls(np.empty(0, np.int64), np.zeros(1, np.int32), none, np.empty(0), rule)

    def observe(self, ids: ArrayLike, xy: ArrayLike) -> TrafficGraph:
        """Return the next graph, after one look at all vehicles.

        Args:
            ids: (n,) different whole numbers.
            xy: (n, 2) finite positions, m.

        Returns:
            The graph of these vehicles; in an accumulated graph also of those seen since the
            reset. Rows follow the order in which vehicles were first seen since the reset, and
            ``ids`` among those new. Equally near neighbours are taken by the smaller id, so the
            edges do not depend on the order of the vehicles.

        Raises:
            InputError: for repeated ids, positions that are not finite, or wrong shapes; if the
                graph was made from edges.
        """
        return self.extended(Sighting.of(ids, xy))

    def extended(self, seen: Sighting) -> TrafficGraph:
        """Return the next graph as `observe` does; several graphs may share one sighting.

        Args:
            seen: the vehicles, whose neighbours are searched once for all graphs.

        Raises:
            InputError: if the graph was made from edges.
        """
        from graphrqi.graph.kernels import join

        rule = self.rule
        if rule is None:
            raise InputError("graph: found one made from edges, expected TrafficGraph.empty(...)")
        keep = rule.kind == "accumulated" and 0 < self.observations < rule.reset
        row_of, all_ids = np.arange(seen.ids.size), seen.ids
        base = self if keep else TrafficGraph.empty()
        if keep and not np.array_equal(self.ids, seen.ids):
            row_of = self.rows_of(seen.ids)
            unseen = row_of < 0
            row_of[unseen] = np.arange(unseen.sum()) + self.ids.size
            all_ids = np.concatenate([self.ids, seen.ids[unseen]])
        neighbors = seen.nearest(rule.neighbors)
        indptr, indices, values = join(row_of, all_ids.size, neighbors, base.indptr, base.indices)
        if np.array_equal(all_ids, self.ids):
            all_ids = self.ids  # one array for a sequence of the same vehicles
        size = indptr[-1]
        count = self.observations + 1 if keep else 1
        return TrafficGraph(
            all_ids, indptr, indices[:size].copy(), values[:size].copy(), rule, count
        )

    def rows_of(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Rows (n,) of vehicles ``ids`` (n,), -1 for those that are not in the graph."""
        if not self.ids.size:
            return np.full(ids.size, -1)
        order = np.argsort(self.ids)  # rows are in order of first sight
        place = np.searchsorted(self.ids, ids, sorter=order)
        rows = order[np.minimum(place, order.size - 1)]
        return np.where(self.ids[rows] == ids, rows, -1)

    @property
    def laplacian(self) -> csr_array[Any, tuple[int, int]]:
        """(d, d) D - A as a scipy CSR array over this graph's (read-only) arrays."""
        from scipy.sparse import csr_array

        d = self.ids.size
        return csr_array((self.values, self.indices, self.indptr), shape=(d, d))

    @property
    def adjacency(self) -> csr_array[Any, tuple[int, int]]:
        """(d, d) symmetric adjacency A as a scipy CSR array, zero diagonal not stored."""
        found = -self.laplacian
        found.setdiag(0.0)
        found.eliminate_zeros()
        return found

    @property
    def edges(self) -> NDArray[np.int64]:
        """(m, 2) ids of the joined vehicles, each edge once, in the order of the rows."""
        rows = np.repeat(np.arange(self.ids.size), np.diff(self.indptr))
        once = rows < self.indices
        return np.stack([self.ids[rows[once]], self.ids[self.indices[once]]], axis=1)

    @property
    def degree(self) -> NDArray[np.float64]:
        """(d,) number of edges of each vehicle, the diagonal of the Laplacian."""
        return np.diff(self.indptr) - 1.0  # every diagonal entry is stored
