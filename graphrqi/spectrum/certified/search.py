"""What a search for eigenpairs asks, and the memory that it works on.

All vectors are in elimination order, and M is L at the largest end and -L at the smallest, so that
the wanted eigenvalues are always the largest of M. See `graphrqi.spectrum.certified.solver`.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.spectrum.certified.eight import new_rows
from graphrqi.spectrum.certified.factorization import Counts
from sim.compiled import inner

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]
Bools: TypeAlias = NDArray[np.bool_]

MAX_COUNTS = 400
"""Shifts whose counts are kept."""
SPARE = 24
"""Vectors kept beyond twice the wanted number: those of three factorisations."""
FREE, NEW, CANDIDATE, FOUND = 0, 1, 2, 3
"""Status of a vector: none, to be filled with noise, not converged, converged."""
COUNT, IDLE = -1, -2
"""Instead of a vector: the shift only counts, or is not in use."""


class Goal(NamedTuple):
    """What is searched for: the k largest eigenpairs of M.

    Attributes:
        k: wanted pairs, at least 1.
        extra: pairs beyond the k-th that are answered too where they equal it.
        deflate: keep out of the null space, the indicators of the components; M is then -L, and k
            counts pairs outside it.
        scale: lower bound on the norm of M, at least 1.
        tol: residuals up to tol * scale count as converged.
        low: below all eigenvalues.
        high: above all eigenvalues that count; 0 with ``deflate``.
        max_sweeps: factorisations to give up after.
    """

    k: int
    extra: int
    deflate: bool
    scale: float
    tol: float
    low: float
    high: float
    max_sweeps: int


class Search(NamedTuple):
    """Memory of a search. "The eight" are the shifts and vectors that are treated at once.

    Attributes:
        pool: (n, d) vectors; those found are orthonormal.
        ritz: (n,) the Ritz value of each.
        residual: (n,) its residual.
        origin: (n,) the shift that it came from.
        status: (n,) `FREE` to `FOUND`.
        age: (n,) how often it was tried in vain.
        used: (n,) whether it is in use in this round.
        counts: shifts of the eight, and what was counted.
        vector: (8,) the vector in the pool of each of the eight, `COUNT` or `IDLE`.
        theta: (1, 8) Ritz values of the eight.
        norm: (1, 8) their residuals.
        source: (8,) of the eight, the column with the largest part in each Ritz vector; -1 if
            there is no Ritz vector.
        x: (d, 8) the eight as columns.
        ax: (d, 8) M times them, or memory of a factorisation.
        counted: (m,) shifts that were counted, descending.
        doubt: (m,) their uncertainties.
        above: (m,) eigenvalues above each.
        reliable: (m,) the counts that no rounding error can have spoilt.
    """

    pool: Floats
    ritz: Floats
    residual: Floats
    origin: Floats
    status: Ints
    age: Ints
    used: Bools
    counts: Counts
    vector: Ints
    theta: Floats
    norm: Floats
    source: Ints
    x: Floats
    ax: Floats
    counted: Floats
    doubt: Floats
    above: Ints
    reliable: Ints


@inner
def new_search(goal: Goal, d: int, ignored: int) -> Search:
    """Memory for d rows; two shifts are counted already: all eigenvalues are between low and high.

    ``ignored`` eigenvalues do not count.
    """
    n = 2 * goal.k + SPARE
    counted, doubt = np.empty(MAX_COUNTS, np.float64), np.empty(MAX_COUNTS, np.float64)
    above = np.empty(MAX_COUNTS, np.int32)
    counted[0], doubt[0], above[0] = goal.high, 0.0, 0
    counted[1], doubt[1], above[1] = goal.low, 0.0, d - ignored
    eight = np.empty((5, 8), np.float64)
    return Search(
        np.empty((n, d), np.float64),
        np.zeros(n, np.float64),
        np.zeros(n, np.float64),
        np.zeros(n, np.float64),
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.bool_),
        Counts(eight[0:1], eight[1:2], eight[2:3]),
        np.empty(8, np.int32),
        eight[3:4],
        eight[4:5],
        np.empty(8, np.int32),
        new_rows(d),
        new_rows(d),
        counted,
        doubt,
        above,
        np.empty(MAX_COUNTS, np.int32),
    )
