"""What every eigenvalue solver takes and returns.

A solver answers: of the Laplacian of this traffic graph, the ``num_pairs`` eigenpairs at the
largest or the smallest end, perhaps starting from an earlier answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.graph import TrafficGraph

End: TypeAlias = Literal["largest", "smallest"]
ENDS = get_args(End)
Floats: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
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
        note: what the solver has to say about this answer, such as that it fell back; or "".
        carried: what the same solver needs for its next step; None for most.
    """

    ids: NDArray[np.int64]
    eigenvalues: Floats
    eigenvectors: Floats
    residuals: Floats
    certified: bool
    graph: TrafficGraph = field(repr=False)
    end: End = "largest"
    note: str = ""
    carried: object = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.eigenvalues, self.eigenvectors, self.residuals):
            array.setflags(write=False)


class Solver(Protocol):
    """The one contract of all solvers."""

    def __call__(
        self,
        graph: TrafficGraph,
        num_pairs: int = 8,
        end: End = "largest",
        previous: Spectrum | None = None,
        tol: float = 1e-8,
        nonzero: bool = False,
    ) -> Spectrum:
        """Compute eigenpairs at one end of the spectrum.

        Args:
            graph: d vehicles.
            num_pairs: how many, at least 1; all there are where fewer exist.
            end: "largest" or "smallest".
            previous: any earlier answer, of other vehicles too, to start from.
            tol: residuals up to tol * max(1, lambda_max) are asked for.
            nonzero: leave out the null space (one pair per connected component).

        Returns:
            The pairs, with their residuals.

        Raises:
            InputError: for an argument out of range.
        """
        ...


def check_arguments(num_pairs: int, end: str, tol: float) -> None:
    """Refuse arguments no solver can serve.

    Args:
        num_pairs: pairs asked for.
        end: end asked for.
        tol: tolerance asked for.

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


def null_space(graph: TrafficGraph) -> Floats:
    """Exact orthonormal basis of the Laplacian's null space.

    Args:
        graph: d vehicles in c connected components.

    Returns:
        (d, c) indicator of each component over the square root of its size.

    Examples:
        >>> null_space(TrafficGraph.from_edges([1, 2, 3], [(1, 2)])).round(3).tolist()
        [[0.707, 0.0], [0.707, 0.0], [0.0, 1.0]]
    """
    labels = components(graph)
    sizes = np.bincount(labels)
    basis = np.zeros((labels.size, sizes.size))
    basis[np.arange(labels.size), labels] = 1.0 / np.sqrt(sizes[labels])
    return basis


def components(graph: TrafficGraph) -> NDArray[np.int32]:
    """Number of the connected component of every vehicle.

    Args:
        graph: d vehicles.

    Returns:
        (d,) from 0, in the order of each component's first row.
    """
    from graphrqi.spectrum.certified import factorization

    return factorization.order_rows(graph.indptr, graph.indices)[1]


def carry_rows(previous: Spectrum, graph: TrafficGraph, vectors: Floats | None = None) -> Floats:
    """Eigenvectors of an earlier answer with the rows of a later graph, by vehicle id.

    Args:
        previous: the earlier answer.
        graph: d vehicles.
        vectors: (c, m) other columns over the earlier answer's vehicles; its eigenvectors if
            not given.

    Returns:
        (d, m) the columns; rows of new vehicles are 0.
    """
    old = previous.eigenvectors if vectors is None else vectors
    rows = np.zeros((graph.ids.size, old.shape[1]))
    place = previous.graph.rows_of(graph.ids)
    rows[place >= 0] = old[place[place >= 0]]
    return rows


def starting_block(
    graph: TrafficGraph, size: int, previous: Spectrum | None, outside: Floats | None
) -> Floats:
    """Orthonormal columns to start an iteration from.

    Args:
        graph: d vehicles.
        size: number of columns, at most d less the columns of ``outside``.
        previous: earlier answer whose eigenvectors come first.
        outside: (d, c) orthonormal columns the block must be orthogonal to.

    Returns:
        (d, size) the earlier eigenvectors by vehicle id, filled up with normal noise (of a fixed
        seed: the same call gives the same block).
    """
    noise = np.random.default_rng(graph.ids.size).normal(size=(graph.ids.size, size))
    if previous is not None:
        known = carry_rows(previous, graph)[:, :size]
        noise[:, : known.shape[1]] = known + 1e-9 * noise[:, : known.shape[1]]
    if outside is not None:
        noise -= outside @ (outside.T @ noise)
    block, _ = np.linalg.qr(noise)
    return block


def rayleigh_ritz(graph: TrafficGraph, basis: Floats, end: End) -> tuple[Floats, Floats]:
    """Best approximations to eigenpairs from a subspace.

    Args:
        graph: d vehicles.
        basis: (d, m) orthonormal columns.
        end: order of the answer.

    Returns:
        (m,) Ritz values and (d, m) Ritz vectors, in the order of the end.
    """
    values, turn = np.linalg.eigh(basis.T @ (graph.laplacian @ basis))
    order = pick(values, values.size, end)
    return values[order], basis @ turn[:, order]


def answer(
    graph: TrafficGraph,
    eigenvalues: Floats,
    eigenvectors: Floats,
    end: End,
    tol: float,
    complete: bool,
    note: str = "",
    carried: object = None,
) -> Spectrum:
    """Measure residuals and orthogonality and make a Spectrum of them.

    Args:
        graph: d vehicles.
        eigenvalues: (k,) in the order of the end.
        eigenvectors: (d, k).
        end: which end they are from.
        tol: residuals up to tol * max(1, lambda_max) count as converged.
        complete: it is known that no eigenvalue was missed, provided the pairs are converged
            and orthonormal.
        note: remark of the solver.
        carried: what the solver needs for its next step.

    Returns:
        The answer, certified if converged, orthonormal and complete.
    """
    applied = graph.laplacian @ eigenvectors
    residuals = np.linalg.norm(applied - eigenvectors * eigenvalues, axis=0)
    gram = eigenvectors.T @ eigenvectors
    orthonormal = bool(np.abs(gram - np.eye(eigenvalues.size)).max(initial=0.0) <= 1e-10)
    converged = bool(residuals.max(initial=0.0) <= tol * max(1.0, lambda_max_floor(graph)))
    return Spectrum(
        graph.ids,
        eigenvalues,
        eigenvectors,
        residuals,
        complete and orthonormal and converged,
        graph,
        end,
        note,
        carried,
    )


def lambda_max_floor(graph: TrafficGraph) -> float:
    """A lower bound on the largest eigenvalue, within a factor 2 of it.

    Args:
        graph: d vehicles.

    Returns:
        The largest vertex degree (x^T L x of that vertex), 0 without vehicles. The largest
        eigenvalue is at most twice that (Gershgorin).
    """
    return float(graph.values.max(initial=0.0))  # every other entry is negative


def pick(values: Floats, num_pairs: int, end: End) -> NDArray[np.intp]:
    """Positions of the pairs asked for, in the order they are answered in.

    Args:
        values: (d,) eigenvalues in any order.
        num_pairs: how many.
        end: which end.

    Returns:
        (min(num_pairs, d),) positions.
    """
    order = np.argsort(values, kind="stable")
    return (order[::-1] if end == "largest" else order)[:num_pairs]
