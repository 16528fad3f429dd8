"""Traffic graphs: vehicles are the nodes, nearness makes the edges.

Each vehicle is joined to its k nearest, and edges of all frames since the last reset are kept.
Source: Chandra et al., GraphRQI: Classifying driver behaviors using graph spectrums (ICRA 2020),
section III. Differs from the paper: the Laplacian is D - A throughout. The paper's recurrence does
not give a Laplacian, see docs/spectrum.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from behaviors.errors import InputError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Kind: TypeAlias = Literal["accumulated", "instantaneous"]

MAX_COORDINATE_M = 1e9
"""Positions beyond this are refused: doubles there are 0.1 um apart."""


def find_nearest(ids: NDArray[np.int64], xy: NDArray[np.float64], k: int) -> NDArray[np.int32]:
    """(n, k) rows of the nearest others of every vehicle, by distance, then by id.

    There are n - 1 columns where fewer exist.

    Examples:
        >>> find_nearest(np.array([3, 1, 2]), np.array([[0.0, 0], [1, 0], [9, 0]]), 1).ravel()
        array([1, 0, 1], dtype=int32)
    """
    from graphrqi.graph.kernels import nearest_neighbors

    return nearest_neighbors(ids, xy, max(min(k, ids.size - 1), 0))


def _checked(ids: ArrayLike, xy: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Ids (n,) and positions (n, 2); `InputError` for repeated ids, gaps or wrong shapes."""
    new_ids = _different(checked_ids(ids))
    try:
        positions = np.asarray(xy, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"xy: found {xy!r:.60}, expected numbers ({error})") from error
    if positions.size == 0 and new_ids.size == 0:
        positions = np.empty((0, 2))
    if positions.shape != (new_ids.size, 2):
        raise InputError(f"xy: found shape {positions.shape}, expected ({new_ids.size}, 2)")
    near = np.abs(positions) <= MAX_COORDINATE_M
    if not near.all():
        row = int(np.flatnonzero(~near.all(axis=1))[0])
        raise InputError(
            f"xy: found {positions[row].tolist()} for vehicle {new_ids[row]}, "
            f"expected finite metres below {MAX_COORDINATE_M:g}"
        )
    return new_ids, positions


def _different(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same ids; `InputError` if one is there twice."""
    ordered = np.sort(ids)
    twice = ordered[:-1][ordered[1:] == ordered[:-1]]
    if twice.size:
        raise InputError(f"ids: found {twice[0]} twice, expected each vehicle once")
    return ids


def checked_ids(ids: ArrayLike, what: str = "ids") -> NDArray[np.int64]:
    """A copy as (n,) whole numbers.

    Raises:
        InputError: naming ``what``, if it is anything else.
    """
    try:
        found = np.asarray(ids)
    except ValueError as error:  # lists of different lengths
        raise InputError(f"{what}: found {ids!r:.60}, expected an array ({error})") from error
    if found.ndim != 1:
        raise InputError(f"{what}: found shape {found.shape}, expected one id per vehicle")
    if found.size == 0:
        return np.empty(0, np.int64)
    if found.dtype.kind not in "iu":
        raise InputError(f"{what}: found {found.dtype} values, expected whole numbers")
    return found.astype(np.int64)


@dataclass(frozen=True, eq=False, repr=False)
class TrafficGraph:
    """An undirected graph of vehicles, as its Laplacian D - A.

    Make one with `from_edges`, or with `empty` and then `observe`.

    Attributes:
        ids: (d,) the vehicle of each row.
        indptr: (d + 1,) row starts of the Laplacian in CSR form.
        indices: (z,) its columns, sorted in each row.
        values: (z,) its values.
        observations: how many since the last reset.
        neighbors: nearest vehicles that `observe` joins each vehicle to; 0 if it does nothing.
        reset: observations between resets of an accumulated graph.
        kind: "accumulated" keeps every vehicle and edge since the reset, "instantaneous" none.

    Examples:
        >>> graph = TrafficGraph.empty(neighbors=1).observe([3, 1, 2], [[0, 0], [1, 0], [9, 0]])
        >>> graph.edges.tolist()
        [[3, 1], [1, 2]]
    """

    ids: NDArray[np.int64]
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    values: NDArray[np.float64]
    observations: int = 0
    neighbors: int = 0
    reset: int = 0
    kind: Kind = "accumulated"

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
        if self.neighbors:
            parts.append(f"{self.kind} over {self.observations} observations")
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
        row_ids = _different(checked_ids(ids))
        order = np.argsort(row_ids, kind="stable")
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
        rows = order[np.searchsorted(row_ids, pairs, sorter=order)] if len(pairs) else pairs
        line, column = np.concatenate([rows, rows[:, ::-1]]).T
        return cls(row_ids, *_laplacian(line, column, row_ids.size))

    @classmethod
    def empty(
        cls, neighbors: int = 4, reset: int = 100, kind: Kind = "accumulated"
    ) -> TrafficGraph:
        """Return a graph without vehicles that grows by observations.

        Args:
            neighbors: nearest vehicles each vehicle is joined to.
            reset: observations between resets of an accumulated graph.
            kind: "accumulated" or "instantaneous".

        Returns:
            The graph.

        Raises:
            InputError: naming the argument that is out of range.
        """
        for name, value in (("neighbors", neighbors), ("reset", reset)):
            whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
            if not whole or value < 1:
                raise InputError(f"{name}: found {value!r}, expected a whole number from 1 on")
        if kind not in get_args(Kind):
            raise InputError(f"kind: found {kind!r}, expected {' or '.join(get_args(Kind))}")
        none = np.empty(0, np.int64)
        return cls(none, *_laplacian(none, none, 0), 0, neighbors, reset, kind)

    def observe(
        self, ids: ArrayLike, xy: ArrayLike, nearest: NDArray[np.int32] | None = None
    ) -> TrafficGraph:
        """Return the next graph, after one look at all vehicles.

        Args:
            ids: (n,) different whole numbers.
            xy: (n, 2) finite positions, m.
            nearest: (n, k) from `find_nearest`, if that is known already.

        Returns:
            The graph of these vehicles; in an accumulated graph also of those seen since the
            reset. Rows follow the order in which vehicles were first seen since the reset, and
            ``ids`` among those new. Equally near neighbours are taken by the smaller id, so the
            edges do not depend on the order of the vehicles.

        Raises:
            InputError: for repeated ids, positions that are not finite, or wrong shapes; if the
                graph was made from edges.
        """
        if not self.neighbors:
            raise InputError("graph: found one made from edges, expected TrafficGraph.empty(...)")
        seen, positions = _checked(ids, xy)
        if nearest is None:
            nearest = find_nearest(seen, positions, self.neighbors)
        nearest = nearest[:, : self.neighbors]
        keep = self.kind == "accumulated" and 0 < self.observations < self.reset
        row_of, rows = np.arange(seen.size), seen
        if keep:
            row_of, rows = self.rows_of(seen), self.ids  # one array for the same vehicles
            unseen = row_of < 0
            if unseen.any():
                row_of[unseen] = np.arange(unseen.sum()) + self.ids.size
                rows = np.concatenate([self.ids, seen[unseen]])
        elif np.array_equal(self.ids, seen):
            rows = self.ids
        ends = np.repeat(row_of, nearest.shape[1]), row_of[nearest.ravel()]
        joined = [ends, ends[::-1], *([self.pairs] if keep else [])]
        line, column = (np.concatenate(part) for part in zip(*joined, strict=True))
        count = self.observations + 1 if keep else 1
        rule = self.neighbors, self.reset, self.kind
        return TrafficGraph(rows, *_laplacian(line, column, rows.size), count, *rule)

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

    @cached_property
    def pairs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows (2 m,) and (2 m,) of the joined vehicles, each edge both ways, in order."""
        rows = np.repeat(np.arange(self.ids.size), np.diff(self.indptr))
        apart = rows != self.indices
        return rows[apart], self.indices[apart].astype(np.int64)

    @property
    def edges(self) -> NDArray[np.int64]:
        """(m, 2) ids of the joined vehicles, each edge once, in the order of the rows."""
        rows, columns = self.pairs
        once = rows < columns
        return np.stack([self.ids[rows[once]], self.ids[columns[once]]], axis=1)

    @property
    def degree(self) -> NDArray[np.float64]:
        """(d,) number of edges of each vehicle, the diagonal of the Laplacian."""
        return np.diff(self.indptr) - 1.0  # every diagonal entry is stored


def _laplacian(
    line: NDArray[np.int64], column: NDArray[np.int64], d: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Row starts, columns and values in CSR form, from places of entries, repeated in any order."""
    place = np.concatenate([line * d + column, np.arange(d) * (d + 1)])
    place.sort()
    place = place[np.diff(place, prepend=-1) > 0]
    line = place // max(d, 1)
    column = place - line * d
    count = np.bincount(line, minlength=d)
    indptr = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
    values = np.where(line == column, count[line] - 1.0, -1.0)
    return indptr, column.astype(np.int32), values
