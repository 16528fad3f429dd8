"""What a search for eigenpairs asks, and the memory that it works on.

All vectors are in elimination order, and M is L at the largest end and -L at the smallest, so that
the wanted eigenvalues are always the largest of M. See `graphrqi.spectrum.certified.solver`.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.spectrum.certified.simd import aligned
from sim.compiled import inner

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]

GoalValues: TypeAlias = tuple[int, int, bool, float, float, float, float, int]

MAX_COUNTS = 400
"""Shifts whose counts are kept."""
SPARE = 24
"""Vectors kept beyond twice the wanted number: those of three factorisations."""

# Rows of `record`: Ritz value, residual, the shift it came from, what it is, how often it was
# tried in vain, whether it is in use in this round.
RITZ, RESIDUAL, ORIGIN, STATUS, AGE, USED = 0, 1, 2, 3, 4, 5
FREE, CANDIDATE, FOUND, NEW = 0.0, 1.0, 2.0, 3.0  # values of STATUS
COUNT, IDLE = -1, -2  # values of `vector` where a shift has no vector
BATCH_RITZ, BATCH_RESIDUAL = 3, 4  # rows of `batch` beyond those of `factorization`


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
        record: (6, n) what is known of each: RITZ to USED.
        batch: (5, 8) the eight: shift, count above it, largest pivot, Ritz value, residual.
        vector: (8,) the vector in the pool of each of the eight, COUNT or IDLE.
        source: (8,) of the eight, the column with the largest part in each Ritz vector; -1 if
            there is no Ritz vector.
        x: (d, 8) the eight as columns.
        ax: (d, 8) M times them, or memory of a factorisation.
        shifts: (2, m) shifts that were counted, descending, and their uncertainties.
        above: (m,) eigenvalues above each.
        reliable: (m,) the counts that no rounding error can have spoilt.
    """

    pool: Floats
    record: Floats
    batch: Floats
    vector: Ints
    source: Ints
    x: Floats
    ax: Floats
    shifts: Floats
    above: Ints
    reliable: Ints


@inner
def new_search(goal: Goal, d: int, ignored: int) -> Search:
    """Memory for d rows; two shifts are counted already: all eigenvalues are between low and high.

    Args:
        goal: what is searched for.
        d: rows.
        ignored: eigenvalues that do not count.

    Returns:
        The memory, without a vector.
    """
    slots = 2 * goal.k + SPARE
    record = np.empty((6, slots), np.float64)
    for b in range(slots):
        record[STATUS, b] = FREE
        record[USED, b] = 0
    shifts, above = np.empty((2, MAX_COUNTS), np.float64), np.empty(MAX_COUNTS, np.int32)
    shifts[0, 0], shifts[1, 0], above[0] = goal.high, 0.0, 0
    shifts[0, 1], shifts[1, 1], above[1] = goal.low, 0.0, d - ignored
    return Search(
        np.empty((slots, d), np.float64),
        record,
        np.empty((5, 8), np.float64),
        np.empty(8, np.int32),
        np.empty(8, np.int32),
        # Aligned to cache lines it is a quarter quicker; one spare row lets the data start on one.
        aligned(np.empty((d + 1, 8), np.float64)),
        aligned(np.empty((d + 1, 8), np.float64)),
        shifts,
        above,
        np.empty(MAX_COUNTS, np.int32),
    )
