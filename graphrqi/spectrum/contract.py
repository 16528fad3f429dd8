"""The arguments and results of every eigenvalue solver.

A solver answers: of the Laplacian of this traffic graph, the ``num_pairs`` eigenpairs at the
largest or the smallest end, perhaps starting from an earlier answer. `eigensolver` makes one of a
function that only has to find the pairs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np

from behaviors.errors import InputError
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.spectrum import End, Floats, Spectrum
from graphrqi.spectrum.subspaces import all_pairs, carry_rows, laplacian_scale, pick

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
