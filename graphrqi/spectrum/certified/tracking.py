"""Kernel of the certified tracker: Rayleigh-quotient iterations that share their factorisations.

All vectors are in elimination order. M is L at the largest end and -L at the smallest: the wanted
eigenvalues are always M's largest. The steps are those of `graphrqi.spectrum.certified.solver`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from graphrqi.spectrum.certified.factorization import Counts, Factor, factor_and_solve
from graphrqi.spectrum.certified.prepared import Floats, Ints, Prepared
from graphrqi.spectrum.certified.rayleigh_ritz import Pool, keep_pairs, new_pool, ritz_pairs
from graphrqi.spectrum.certified.shifts import (
    NOISE,
    add_counts,
    choose_shifts,
    find_reliable,
    new_ledger,
)
from sim.compiled import inner, vectorised

MAX_START = 32
"""Vectors to start from that are used."""


class Goal(NamedTuple):
    """The search for the k largest eigenpairs of M.

    Attributes:
        k: wanted pairs, at least 1.
        deflate: keep out of the null space, the indicators of the components; M is then -L, and k
            counts pairs outside it.
        scale: lower bound on the norm of M, at least 1.
        tol: residuals up to tol * scale count as converged.
        low: below all eigenvalues.
        high: above all eigenvalues that count; 0 with ``deflate``.
        max_sweeps: factorisations to give up after.
    """

    k: int
    deflate: bool
    scale: float
    tol: float
    low: float
    high: float
    max_sweeps: int


@vectorised
def track(matrix: Prepared, goal: Goal, start: Floats) -> tuple[bool, Floats, Floats, Floats]:
    """Find and certify the k largest eigenpairs of M.

    Args:
        matrix: M.
        goal: what is searched for.
        start: (d, m) vectors to start from, by row; m may be 0.

    Returns:
        Whether none of the k was missed; (m,) eigenvalues of M, descending, (m,) residuals and
        (d, m) vectors by row, m >= k if certified.
    """
    d = matrix.order.size
    ignored = matrix.components if goal.deflate else 0
    pool = new_pool(goal.k, d)
    counts = Counts(np.empty((1, 8)), np.empty((1, 8)), np.empty((1, 8)))
    ledger = new_ledger(goal.low, goal.high, d - ignored)
    x, ax = np.empty((d, 8)), np.empty((d, 8))
    factor = Factor(np.empty((matrix.entries.size, 8)), np.empty((d, 8)), ax)
    source = np.empty(8, np.int32)
    columns = min(start.shape[1], MAX_START)
    for first in range(0, columns, 8):  # Rayleigh-Ritz in the span of the given vectors
        for j in range(d):
            for q in range(8):
                x[j, q] = start[matrix.order[j], first + q] if first + q < columns else 0.0
        keep_pairs(pool, ritz_pairs(matrix, goal.deflate, pool, x, ax), goal.scale, goal.tol)
    seed = np.uint64(88172645463325252)
    wanted = goal.k  # raised where eigenvalues equal to the k-th have to be found too
    certified = stuck = False
    for _ in range(goal.max_sweeps):
        delta = goal.tol * goal.scale
        if goal.deflate:
            kth = pool.value[goal.k - 1] if pool.size[0] >= goal.k else -math.inf
            delta = min(delta, max(1e-2 * abs(kth), 1e-13 * goal.scale))
        certified = find_reliable(ledger, pool, goal.k, delta)
        if certified:
            break
        solving, beyond = choose_shifts(ledger, pool, counts, source, wanted, delta, goal)
        if solving == 0 and stuck:  # equal eigenvalues follow the k-th: find them all
            if beyond == wanted or beyond > len(pool.vectors) - 12:
                break
            wanted = beyond
            stuck = False
            continue
        stuck = solving == 0
        seed = fill_columns(pool, source, x, seed)
        solves = 2 if solving > 0 else 0
        factor_and_solve(matrix, counts, 1e-15 * goal.scale, solves, factor, x)
        add_counts(ledger, counts, source, ignored, goal.scale)
        if solving > 0:
            keep_pairs(pool, ritz_pairs(matrix, goal.deflate, pool, x, ax), goal.scale, goal.tol)
    values, residuals, vectors = answered(pool, goal.k, goal.scale, matrix.order)
    return certified, values, residuals, vectors


@inner
def fill_columns(pool: Pool, source: Ints, x: Floats, seed: np.uint64) -> np.uint64:
    """Fill the eight columns with candidates, which leave the pool, or with noise, or with 0.

    Noise is from a xorshift generator (Marsaglia 2003, J. Stat. Software 8 (14)), whose next seed
    is returned.
    """
    for q in range(8):
        if source[q] >= 0:
            x[:, q] = pool.candidates[source[q]]
        elif source[q] == NOISE:
            for j in range(len(x)):
                seed ^= seed << np.uint64(13)
                seed ^= seed >> np.uint64(7)
                seed ^= seed << np.uint64(17)
                x[j, q] = float(seed >> np.uint64(11)) * 2.0**-52 - 1.0
        else:
            x[:, q] = 0.0
    for q in range(8):
        if source[q] >= 0:
            pool.candidate_residual[source[q]] = math.inf
    return seed


@inner
def answered(pool: Pool, k: int, scale: float, order: Ints) -> tuple[Floats, Floats, Floats]:
    """The largest k pairs found, and up to eight more that equal the k-th, by row."""
    kept = min(pool.size[0], k)
    while kept < min(pool.size[0], k + 8) and pool.value[kept] >= pool.value[k - 1] - 1e-6 * scale:
        kept += 1
    vectors = np.empty((order.size, kept))
    for c in range(kept):
        vectors[order, c] = pool.vectors[c]
    return pool.value[:kept].copy(), pool.residual[:kept].copy(), vectors
