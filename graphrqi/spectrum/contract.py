"""The contract of every eigenvalue solver: its arguments, its answer, and pieces to make one of.

A solver answers: of the Laplacian of this traffic graph, the ``num_pairs`` eigenpairs at the
largest or the smallest end, perhaps starting from an earlier answer. `eigensolver` makes one of a
function that only has to find the pairs. The pieces are the exact null space, the dense solution,
starting vectors and the Rayleigh-Ritz step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.registry import loaded
from graphrqi.graph import TrafficGraph

End: TypeAlias = Literal["largest", "smallest"]
Floats: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum:
    """Eigenpairs of a traffic graph's Laplacian.

    Attributes:
        ids: (d,) the vehicle of each row of ``eigenvectors``.
        eigenvalues: (k,) descending for the largest end, ascending for the smallest.
        eigenvectors: (d, k) orthonormal columns.
        residuals: (k,) norms of L u - lambda u, as computed from the answer.
        certified: every residual is at most tol * max(1, lambda_max), the columns are
            orthonormal, and a count of the eigenvalues beyond the last one (Sylvester's law of
            inertia, or having them all) says that none was missed. False says only that this
            was not shown.
        graph: the graph the pairs belong to.
        end: which end of the spectrum.
        note: the solver's remark on this answer, such as that it fell back; or "".
        carried: what the same solver needs for its next step; None for most.
    """

    ids: NDArray[np.int64]
    eigenvalues: Floats
    eigenvectors: Floats
    residuals: Floats
    certified: bool
    graph: TrafficGraph
    end: End = "largest"
    note: str = ""
    carried: object = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.eigenvalues, self.eigenvectors, self.residuals):
            array.setflags(write=False)

    def __repr__(self) -> str:
        """How many pairs of how many vehicles, from where, and how far they can be trusted."""
        k, d = self.eigenvalues.size, self.ids.size
        parts = [f"{k} pair{'s' * (k != 1)} at the {self.end} end"]
        if k:
            parts[0] += f", eigenvalues {self.eigenvalues[0]:.6g} to {self.eigenvalues[-1]:.6g}"
        parts.append(f"{d} vehicle{'s' * (d != 1)}")
        if d:
            parts[-1] += f" with ids {self.ids.min()} to {self.ids.max()}"
        parts.append("certified" if self.certified else "not certified")
        if k:
            parts.append(f"residuals up to {self.residuals.max():.0e}")
        if self.note:
            parts.append(f"note: {self.note:.120}")
        return f"Spectrum({', '.join(parts)})"


def laplacian_scale(graph: TrafficGraph) -> float:
    """Size of a Laplacian: its largest vertex degree, at least 1.

    The largest eigenvalue is between the largest degree (x^T L x of that vertex) and twice that
    (Gershgorin).
    """
    return max(1.0, float(graph.values.max(initial=0.0)))  # entries off the diagonal are negative


def pick(values: Floats, num_pairs: int, end: End) -> NDArray[np.intp]:
    """Positions (min(num_pairs, d),) of the pairs asked for, in the order of an end."""
    order = np.argsort(values, kind="stable")
    return (order[::-1] if end == "largest" else order)[:num_pairs]


def components(graph: TrafficGraph) -> NDArray[np.int32]:
    """Number (d,) of each vehicle's connected component, in the order of their first rows."""
    from scipy.sparse.csgraph import connected_components

    labels: NDArray[np.int32] = connected_components(graph.laplacian, directed=False)[1]
    return labels


def null_space(graph: TrafficGraph) -> Floats:
    """(d, c) exact basis of the null space: each component's indicator over its norm."""
    labels = components(graph)
    sizes = np.bincount(labels)
    basis = np.zeros((labels.size, sizes.size))
    basis[np.arange(labels.size), labels] = 1.0 / np.sqrt(sizes[labels])
    return basis


def all_pairs(graph: TrafficGraph) -> tuple[Floats, Floats]:
    """Every eigenpair of d vehicles: (d,) eigenvalues, ascending, and (d, d) eigenvectors.

    The Laplacian of a graph in pieces is block diagonal. The null space comes out exactly, as the
    indicators of the components. Costs the sum of the cubes of the component sizes.
    """
    null, laplacian, d = null_space(graph), graph.laplacian, graph.ids.size
    labels, above, zeros = components(graph), 4.0 * laplacian_scale(graph), null.shape[1]
    values, vectors = np.zeros(zeros), np.zeros((d, d))
    vectors[:, :zeros] = null
    for c in range(zeros):
        rows = np.flatnonzero(labels == c)
        block: Floats = (laplacian if zeros == 1 else laplacian[rows][:, rows]).toarray()
        inner, turn = np.linalg.eigh(block + above / rows.size)  # moves 0 above all the rest
        vectors[np.ix_(rows, values.size + np.arange(rows.size - 1))] = turn[:, :-1]
        values = np.append(values, inner[:-1])
    sort = np.argsort(values, kind="stable")
    return values[sort], vectors[:, sort]


def carry_rows(previous: Spectrum, graph: TrafficGraph, vectors: Floats | None = None) -> Floats:
    """Columns over an earlier answer's vehicles with the rows of a later graph, by vehicle id.

    They are the earlier eigenvectors unless given; rows of new vehicles are 0.
    """
    old = previous.eigenvectors if vectors is None else vectors
    rows = np.zeros((graph.ids.size, old.shape[1]))
    place = previous.graph.rows_of(graph.ids)
    rows[place >= 0] = old[place[place >= 0]]
    return rows


def rayleigh_ritz(graph: TrafficGraph, basis: Floats, end: End) -> tuple[Floats, Floats]:
    """(m,) Ritz values and (d, m) Ritz vectors in a basis (d, m), in the order of the end."""
    values, turn = np.linalg.eigh(basis.T @ (graph.laplacian @ basis))
    order = pick(values, values.size, end)
    return values[order], basis @ turn[:, order]


ENDS = get_args(End)


def check_arguments(num_pairs: int, end: str, tol: float, previous: object = None) -> None:
    """Refuse arguments that no solver can serve; they are those of `Solver`.

    Raises:
        InputError: naming the argument.
    """
    if isinstance(num_pairs, bool) or not isinstance(num_pairs, (int, np.integer)):
        raise InputError(f"num_pairs: found {num_pairs!r}, expected a whole number")
    if num_pairs < 1:
        raise InputError(f"num_pairs: found {num_pairs}, expected at least 1")
    if end not in ENDS:
        raise InputError(f"end: found {end!r}, expected one of {', '.join(ENDS)}")
    if not isinstance(tol, (int, float, np.number)) or not 0.0 < tol < math.inf:
        raise InputError(f"tol: found {tol!r}, expected a positive number")
    if previous is not None and not isinstance(previous, Spectrum):
        raise InputError(f"previous: found {previous!r:.60}, expected a Spectrum or None")


@dataclass(frozen=True, eq=False)
class Pairs:
    """The result of an algorithm.

    Attributes:
        values: (k,) in the order of the end.
        vectors: (d, k).
        complete: it is known that no eigenvalue was missed, provided the pairs are converged
            and orthonormal.
        note: remark on this answer.
        carried: what the algorithm needs for its next step.
        residuals: (k,) where the columns are known to be orthonormal and converged; else None.
    """

    values: Floats
    vectors: Floats
    complete: bool = False
    note: str = ""
    carried: object = None
    residuals: Floats | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """A request for eigenpairs whose arguments are right.

    Attributes:
        graph: d vehicles.
        asked: how many pairs are asked for, perhaps more than exist.
        end: "largest" or "smallest".
        previous: an earlier answer to start from, perhaps of other vehicles.
        tol: residual asked for, relative to ``scale``.
    """

    graph: TrafficGraph
    asked: int
    end: End
    previous: Spectrum | None
    tol: float

    @property
    def scale(self) -> float:
        """Size of the Laplacian: max(1, largest degree), at least half of lambda_max."""
        return laplacian_scale(self.graph)

    @property
    def num_pairs(self) -> int:
        """How many pairs are wanted; so many exist."""
        return int(min(self.asked, self.graph.ids.size))

    def starting_block(self, size: int | None = None) -> Floats:
        """(d, k) orthonormal columns to start from: the earlier vectors, or noise of a fixed seed.

        There are as many as pairs are wanted, or ``size``.
        """
        d = self.graph.ids.size
        noise = np.random.default_rng(d).normal(size=(d, size or self.num_pairs))
        if self.previous is not None:
            known = carry_rows(self.previous, self.graph)[:, : noise.shape[1]]
            noise[:, : known.shape[1]] = known + 1e-9 * noise[:, : known.shape[1]]
        return np.linalg.qr(noise)[0]

    def chosen(self, values: Floats, vectors: Floats) -> tuple[Floats, Floats]:
        """Those of the given pairs that are wanted, in the order of the end."""
        wanted = pick(values, self.num_pairs, self.end)
        return values[wanted], vectors[:, wanted]

    def dense(self, note: str = "") -> Pairs:
        """The answer of LAPACK's dense symmetric solver, component by component."""
        return Pairs(*self.chosen(*all_pairs(self.graph)), complete=True, note=note)


@dataclass(frozen=True)
class Solver:
    """A solver: a function that finds the pairs of a `Problem`, which checks and measures.

    Attributes:
        find: the function.
        dense_share: a dense solution answers where this many times the pairs wanted reach d; None
            for never.
    """

    find: Callable[[Problem], Pairs]
    dense_share: int | None = None

    def __call__(
        self,
        graph: TrafficGraph,
        num_pairs: int = 8,
        end: End = "largest",
        previous: Spectrum | None = None,
        tol: float = 1e-8,
    ) -> Spectrum:
        """Compute eigenpairs at one end of the spectrum.

        Args:
            graph: d vehicles.
            num_pairs: how many, at least 1; all there are where fewer exist.
            end: "largest" or "smallest".
            previous: any earlier answer, of other vehicles too, to start from.
            tol: residuals up to tol * max(1, lambda_max) are asked for.

        Returns:
            The pairs, with their residuals.

        Raises:
            InputError: for an argument out of range.
        """
        check_arguments(num_pairs, end, tol, previous)
        problem = Problem(graph, num_pairs, end, previous, tol)
        if self.dense_share is not None:
            k = problem.num_pairs
            if k < 1 or self.dense_share * k >= graph.ids.size:
                return answer(graph, problem.dense(), end, tol)
        return answer(graph, self.find(problem), end, tol)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by name: the function's name is the solver's."""
        return loaded, (f"{self.find.__module__}:{self.find.__name__}",)


def eigensolver(dense_share: int | None = None) -> Callable[[Callable[[Problem], Pairs]], Solver]:
    """Decorator that makes a `Solver` of a function that finds the pairs of a `Problem`."""
    return lambda find: Solver(find, dense_share)


def answer(graph: TrafficGraph, pairs: Pairs, end: End, tol: float) -> Spectrum:
    """Measure residuals and orthogonality, where they are not known, and make a Spectrum of pairs.

    It is certified if the pairs are complete, orthonormal, and have residuals up to ``tol`` times
    the graph's scale.
    """
    values, vectors, residuals = pairs.values, pairs.vectors, pairs.residuals
    certified = pairs.complete
    if residuals is None:
        residuals = np.linalg.norm(graph.laplacian @ vectors - vectors * values, axis=0)
        departure = np.abs(vectors.T @ vectors - np.eye(values.size))
        orthonormal = bool(departure.max(initial=0.0) <= 1e-10)
        converged = bool(residuals.max(initial=0.0) <= tol * laplacian_scale(graph))
        certified = certified and orthonormal and converged
    return Spectrum(
        graph.ids, values, vectors, residuals, certified, graph, end, pairs.note, pairs.carried
    )
