"""The traffic graph and the rule by which observations of positions extend it.

Source: Chandra et al., GraphRQI: Classifying driver behaviors using graph spectrums (ICRA 2020),
section III: each vehicle is joined to its k nearest; the adjacency of all frames since the last
reset is kept. Differs from the paper: the Laplacian is D - A throughout (the paper's recurrence
L_t = blk(L_{t-1}, 1) + delta delta^T is no Laplacian, see docs/spectrum.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from behaviors.errors import InputError
from graphrqi.graph.sighting import Sighting, as_array, checked_floats, checked_ids

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Kind: TypeAlias = Literal["accumulated", "instantaneous"]

MAX_WEIGHT = 1e100
"""Weights beyond this are refused: sums of their squares stay finite."""


@dataclass(frozen=True)
class ObservationRule:
    """How positions become edges.

    Attributes:
        neighbors: nearest vehicles each vehicle is joined to (the union: one of the two chose).
        reset: observations after which an accumulated graph begins anew.
        kind: "accumulated" keeps every vehicle and edge since the reset, "instantaneous" none.
        radius_m: if given, every vehicle within this distance is joined, and ``neighbors`` has
            no effect, m.
        scale_m: if given, an edge weighs exp(-distance / scale_m), else 1, m. An accumulated
            edge keeps the weight it had when last seen.
    """

    neighbors: int = 4
    reset: int = 100
    kind: Kind = "accumulated"
    radius_m: float | None = None
    scale_m: float | None = None

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InputError: naming the field.
        """
        for name, lowest in (("neighbors", 1), ("reset", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
                raise InputError(f"{name}: found {value!r}, expected a whole number")
            if value < lowest:
                raise InputError(f"{name}: found {value}, expected at least {lowest}")
        if self.kind not in get_args(Kind):
            kinds = " or ".join(get_args(Kind))
            raise InputError(f"kind: found {self.kind!r}, expected {kinds}")
        for name in ("radius_m", "scale_m"):
            value = getattr(self, name)
            if value is not None and not (
                isinstance(value, (int, float, np.number)) and 0.0 < value < math.inf
            ):
                raise InputError(f"{name}: found {value!r}, expected a positive length in metres")


@dataclass(frozen=True, eq=False)
class GraphChange:
    """What distinguishes a graph from an earlier one.

    Attributes:
        arrived: (a,) ids of the vehicles only the later graph has.
        departed: (b,) ids of the vehicles only the earlier graph has.
        edges: (m, 2) ids of the edges whose weight differs.
        weights: (m,) later minus earlier weight, 0 standing for no edge.
    """

    arrived: NDArray[np.int64]
    departed: NDArray[np.int64]
    edges: NDArray[np.int64]
    weights: NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class TrafficGraph:
    """An undirected weighted graph of vehicles, as its Laplacian D - A.

    Make one with `from_edges`, or with `empty` and then `observe`.

    Attributes:
        ids: (d,) the vehicle of each row.
        indptr: (d + 1,) row starts of the Laplacian in CSR form.
        indices: (z,) its columns, sorted in each row, every diagonal entry stored.
        values: (z,) its values.
        rule: how observations extend the graph; None for a graph made from edges.
        observations: observations since the last reset, this one included.
        earlier: the graph before the last observation, itself without one.

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
    earlier: TrafficGraph | None = None

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

    def _repr_html_(self) -> str:
        """A table of the vehicles with the largest degrees, for notebooks."""
        degree, shown = self.degree, 10
        most = np.argsort(-degree, kind="stable")[:shown]
        lines = "".join(f"<tr><td>{self.ids[i]}</td><td>{degree[i]:.4g}</td></tr>" for i in most)
        if self.ids.size > shown:
            lines += f"<tr><td colspan=2>and {self.ids.size - shown} more</td></tr>"
        head = "<tr><th>vehicle</th><th>degree</th></tr>"
        return f"<table><caption>{self!r}</caption>{head}{lines}</table>"

    @classmethod
    def from_edges(
        cls, ids: ArrayLike, edges: ArrayLike, weights: ArrayLike | None = None
    ) -> TrafficGraph:
        """Build a graph from a list of edges.

        Args:
            ids: (d,) different whole numbers, one per vehicle; the order of the rows.
            edges: (m, 2) ids of the joined vehicles, undirected. An edge given several times, in
                either direction, is one edge with the largest of its weights.
            weights: (m,) from 0 to `MAX_WEIGHT`; 1 where not given. An edge of weight 0 is none.

        Returns:
            The graph.

        Raises:
            InputError: for an id that is given twice, unknown or no whole number, an edge from
                a vehicle to itself, a weight out of range, or a wrong shape.
        """
        row_ids = checked_ids(ids)
        d = row_ids.size
        order = np.argsort(row_ids, kind="stable")
        ordered = row_ids[order]
        twice = np.flatnonzero(ordered[1:] == ordered[:-1])
        if twice.size:
            raise InputError(f"ids: found {ordered[twice[0]]} twice, expected each vehicle once")
        pairs = as_array(edges, "edges")
        if pairs.size == 0:
            pairs = np.empty((0, 2), np.int64)
        if pairs.ndim != 2 or pairs.shape[1] != 2:
            raise InputError(f"edges: found shape {pairs.shape}, expected (m, 2)")
        pairs = checked_ids(pairs.ravel(), "edges").reshape(-1, 2)
        m = len(pairs)
        weight = np.ones(m) if weights is None else checked_floats(weights, "weights")
        if weight.shape != (m,):
            raise InputError(f"weights: found shape {weight.shape}, expected ({m},), one per edge")
        wrong = np.flatnonzero(~((weight >= 0.0) & (weight <= MAX_WEIGHT)))
        if wrong.size:
            raise InputError(
                f"weights: found {weight[wrong[0]]}, expected numbers from 0 to {MAX_WEIGHT:g}"
            )
        place = np.searchsorted(ordered, pairs) if d else np.zeros_like(pairs)
        known = (place < d) if d else np.zeros(pairs.shape, bool)
        known[known] = ordered[place[known]] == pairs[known]
        if not known.all():
            raise InputError(f"edges: found vehicle {pairs[~known][0]}, expected one of ids")
        rows = order[place] if m else np.empty((0, 2), np.int64)
        itself = np.flatnonzero(rows[:, 0] == rows[:, 1])
        if itself.size:
            raise InputError(
                f"edges: found {pairs[itself[0], 0]} joined to itself, expected two vehicles"
            )
        rows, weight = np.sort(rows, axis=1)[weight > 0.0], weight[weight > 0.0]
        sort = np.lexsort((-weight, rows[:, 1], rows[:, 0]))
        rows, weight = rows[sort], weight[sort]
        first = np.ones(len(rows), bool)
        first[1:] = (rows[1:] != rows[:-1]).any(axis=1)
        rows, weight = rows[first], weight[first]
        degree = np.zeros(d)
        np.add.at(degree, rows.ravel(), np.repeat(weight, 2))
        line = np.concatenate([rows[:, 0], rows[:, 1], np.arange(d)])
        column = np.concatenate([rows[:, 1], rows[:, 0], np.arange(d)])
        value = np.concatenate([-weight, -weight, degree])
        sort = np.lexsort((column, line))
        indptr = np.searchsorted(line[sort], np.arange(d + 1)).astype(np.int32)
        return cls(row_ids, indptr, column[sort].astype(np.int32), value[sort])

    @classmethod
    def empty(
        cls,
        neighbors: int = 4,
        reset: int = 100,
        kind: Kind = "accumulated",
        radius_m: float | None = None,
        scale_m: float | None = None,
    ) -> TrafficGraph:
        """Return a graph without vehicles that knows how to grow, see `ObservationRule`.

        Args:
            neighbors: nearest vehicles each vehicle is joined to.
            reset: observations after which an accumulated graph begins anew.
            kind: "accumulated" or "instantaneous".
            radius_m: join all vehicles within this distance instead of the nearest, m.
            scale_m: weigh edges by exp(-distance / scale_m), m.

        Returns:
            The graph.

        Raises:
            InputError: naming the argument that is out of range.
        """
        return cls(
            np.empty(0, np.int64),
            np.zeros(1, np.int32),
            np.empty(0, np.int32),
            np.empty(0),
            ObservationRule(neighbors, reset, kind, radius_m, scale_m),
        )

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
        from graphrqi.graph import cell_grid

        rule = self.rule
        if rule is None:
            raise InputError("graph: found one made from edges, expected TrafficGraph.empty(...)")
        keep = rule.kind == "accumulated" and 0 < self.observations < rule.reset
        base = self if keep else _NOTHING
        if rule.radius_m is None:
            lists = seen.nearest(rule.neighbors)
        else:
            lists = seen.within(float(rule.radius_m))
        row_of, all_ids = np.arange(seen.ids.size), seen.ids
        if keep and not np.array_equal(self.ids, seen.ids):
            row_of = self.rows_of(seen.ids)
            unseen = row_of < 0
            row_of[unseen] = np.arange(unseen.sum()) + self.ids.size
            all_ids = np.concatenate([self.ids, seen.ids[unseen]])
        indptr, indices, values = cell_grid.join(
            row_of,
            all_ids.size,
            seen.xy,
            *lists,
            -1.0 if rule.scale_m is None else float(rule.scale_m),
            base.indptr,
            base.indices,
            base.values,
        )
        if np.array_equal(all_ids, self.ids):
            all_ids = self.ids  # one array for a sequence of the same vehicles
        size = indptr[-1]
        earlier = TrafficGraph(
            self.ids, self.indptr, self.indices, self.values, rule, self.observations
        )
        count = self.observations + 1 if keep else 1
        return TrafficGraph(
            all_ids, indptr, indices[:size].copy(), values[:size].copy(), rule, count, earlier
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
        """(d, d) symmetric edge weights A as a scipy CSR array, zero diagonal not stored."""
        from scipy.sparse import csr_array

        d = self.ids.size
        rows, off = self._rows_and_off_diagonal()
        counts = np.concatenate([[0], np.cumsum(np.bincount(rows[off], minlength=d))])
        return csr_array(
            (-self.values[off], self.indices[off], counts.astype(np.int32)), shape=(d, d)
        )

    @property
    def edges(self) -> NDArray[np.int64]:
        """(m, 2) ids of the joined vehicles, each edge once, in the order of the rows."""
        rows, _ = self._rows_and_off_diagonal()
        once = rows < self.indices
        return np.stack([self.ids[rows[once]], self.ids[self.indices[once]]], axis=1)

    @property
    def weights(self) -> NDArray[np.float64]:
        """(m,) weights of ``edges``."""
        rows, _ = self._rows_and_off_diagonal()
        return -self.values[rows < self.indices]

    @property
    def degree(self) -> NDArray[np.float64]:
        """(d,) summed edge weights of each vehicle, the diagonal of the Laplacian."""
        _, off = self._rows_and_off_diagonal()
        return self.values[~off]

    def change(self) -> GraphChange:
        """What the last observation changed; everything, for a first graph."""
        return change_between(_NOTHING if self.earlier is None else self.earlier, self)

    def _rows_and_off_diagonal(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        rows = np.repeat(np.arange(self.ids.size), np.diff(self.indptr))
        return rows, rows != self.indices


def change_between(before: TrafficGraph, after: TrafficGraph) -> GraphChange:
    """Compare two graphs by vehicle id.

    Args:
        before: the earlier graph.
        after: the later graph; its rows may be in another order.

    Returns:
        Vehicles and edges in which they differ.

    Examples:
        >>> a = TrafficGraph.from_edges([1, 2, 3], [(1, 2)])
        >>> change = change_between(a, TrafficGraph.from_edges([3, 2, 4], [(3, 2)]))
        >>> change.arrived.tolist(), change.departed.tolist()
        ([4], [1])
        >>> change.edges.tolist(), change.weights.tolist()
        ([[1, 2], [2, 3]], [-1.0, 1.0])
    """
    arrived = after.ids[~np.isin(after.ids, before.ids)]
    departed = before.ids[~np.isin(before.ids, after.ids)]
    edges = np.sort(np.concatenate([before.edges, after.edges]), axis=1)
    signed = np.concatenate([-before.weights, after.weights])
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, signed = edges[order], signed[order]
    first = np.ones(len(edges), bool)
    first[1:] = (edges[1:] != edges[:-1]).any(axis=1)
    total = np.add.reduceat(signed, np.flatnonzero(first)) if len(edges) else signed
    differs = total != 0.0
    return GraphChange(arrived, departed, edges[first][differs], total[differs])


_NOTHING = TrafficGraph(
    np.empty(0, np.int64), np.zeros(1, np.int32), np.empty(0, np.int32), np.empty(0)
)
