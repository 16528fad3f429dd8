"""Kernel of the certified tracker: Rayleigh-quotient iterations that share their factorisations.

The steps are those of `graphrqi.spectrum.certified.solver`.
"""

from __future__ import annotations

import math

import numpy as np

from graphrqi.spectrum.certified.eight import load, new_rows, plus, spread, store
from graphrqi.spectrum.certified.factorization import Factor, factor_and_solve
from graphrqi.spectrum.certified.prepared import Bools, Floats, Ints, Prepared
from graphrqi.spectrum.certified.rayleigh_ritz import CHUNK, deflate_constants, rayleigh_ritz
from graphrqi.spectrum.certified.search import (
    CANDIDATE,
    FOUND,
    FREE,
    IDLE,
    NEW,
    Goal,
    Search,
    new_search,
)
from graphrqi.spectrum.certified.shifts import (
    add_counts,
    choose_shifts,
    find_reliable,
    kth_largest,
    take_vector,
)
from sim.compiled import inner, vectorised

NOISE = 0.05
"""Size of a new vector's noise outside the rows that changed: an eigenvector of the new matrix has
a part in those rows, unless it was one of the old matrix already."""
MAX_START = 32
"""Vectors to start from that are used."""


@vectorised
def track(
    matrix: Prepared, goal: Goal, start: Floats, lower: Floats
) -> tuple[bool, Floats, Floats, float]:
    """Find and certify the k largest eigenpairs of M.

    Args:
        matrix: M.
        goal: what is searched for.
        start: (d, m) vectors to start from, by row; m may be 0.
        lower: (r, 8) memory for the factor, r at least the number of its entries; overwritten.

    Returns:
        Whether none of the k was missed; (2, m) eigenvalues of M, descending, and residuals; (d, m)
        vectors by row; m >= k if certified; and how far their inner products are from those of
        orthonormal vectors at most.
    """
    d = matrix.order.size
    ignored = matrix.components if goal.deflate else 0
    search = new_search(goal, d, ignored)
    factor = Factor(lower, new_rows(d), search.ax)
    size = component_sizes(matrix.label, matrix.components)
    ages = np.empty(8, np.int32)
    narrow = start.shape[1] > 0
    first = narrow
    seed = np.uint64(88172645463325252)
    delta0, floor = goal.tol * goal.scale, 1e-13 * goal.scale
    n_shifts = int(np.int64(2))  # a literal would be compiled for once more
    sweeps = started = 0
    certified = stuck = False
    wanted = goal.k  # raised where eigenvalues equal to the k-th have to be found too
    start_columns = min(start.shape[1], MAX_START)
    while True:
        if started < start_columns:  # first, Rayleigh-Ritz in the span of the given vectors
            for q in range(8):
                search.counts.shift[0, q], ages[q] = math.inf, 0
            for j in range(d):
                for q in range(8):
                    c = started + q
                    search.x[j, q] = start[matrix.order[j], c] if c < start_columns else 0.0
            started += 8
        else:
            for b in range(search.used.size):
                search.used[b] = False
            delta = delta0
            if goal.deflate:
                delta = min(delta0, max(1e-2 * abs(kth_largest(search, goal.k)), floor))
            n_reliable, certified = find_reliable(search, n_shifts, goal.k, delta)
            if certified or sweeps >= goal.max_sweeps:
                break
            solving, beyond = choose_shifts(search, n_reliable, wanted, delta, first, goal)
            if solving == 0 and stuck:  # equal eigenvalues follow the k-th: find them all
                if beyond == wanted or beyond > search.used.size - 12:
                    break
                wanted = beyond
                stuck = False
                continue
            stuck = solving == 0
            first = False
            if solving > 0:
                seed = load_vectors(search, matrix, narrow, seed)
            tiny, solves = 1e-15 * goal.scale, 2 * (solving > 0)
            factor_and_solve(matrix, search.counts, tiny, solves, factor, search.x)
            sweeps += 1
            n_shifts = add_counts(search, ignored, goal.scale, n_shifts)
            if solving == 0:
                continue
            release_vectors(search, ages)
        if goal.deflate:
            deflate_constants(search.x, matrix.label, size)
        rayleigh_ritz(matrix, search)
        keep_pairs(search, goal, ages)
    pairs, vectors, departure = largest_pairs(search, goal, matrix.order)
    return certified, pairs, vectors, departure


@inner
def component_sizes(label: Ints, components: int) -> Floats:
    """(c,) number of rows of each component."""
    size = np.zeros(components, np.float64)
    for j in range(label.size):
        size[label[j]] += 1.0
    return size


@inner
def load_vectors(search: Search, matrix: Prepared, narrow: bool, seed: np.uint64) -> np.uint64:
    """Fill the eight columns with the vectors of the eight shifts, new ones with noise.

    A column without a vector becomes 0. Returns the next state of the generator of noise.
    """
    pool, x, vector = search.pool, search.x, search.vector
    d = pool.shape[1]
    for q in range(8):
        if vector[q] >= 0 and search.status[vector[q]] == NEW:
            seed = random_start(pool[vector[q]], matrix.order, matrix.changed, narrow, seed)
    for start in range(0, d, CHUNK):
        for q in range(8):
            for j in range(start, min(start + CHUNK, d)):
                x[j, q] = pool[vector[q], j] if vector[q] >= 0 else 0.0
    return seed


@inner
def release_vectors(search: Search, ages: Ints) -> None:
    """Free the places of the eight's vectors and of those not in use: Ritz vectors take them.

    ``ages`` is overwritten by how often each of the eight was tried.
    """
    for q in range(8):
        ages[q] = 0
        if search.vector[q] >= 0:
            ages[q] = search.age[search.vector[q]]
            search.used[search.vector[q]] = False
    for b in range(search.used.size):
        if search.status[b] != FOUND and not search.used[b]:
            search.status[b] = FREE


@inner
def keep_pairs(search: Search, goal: Goal, ages: Ints) -> None:
    """Put the Ritz pairs of the eight among the others, found or candidates."""
    vector, source, pool, x = search.vector, search.source, search.pool, search.x
    d = pool.shape[1]
    goal0, floor = 0.9 * goal.tol * goal.scale, 1e-13 * goal.scale
    for c in range(8):
        vector[c] = IDLE
    for c in range(8):
        value, residual = search.theta[0, c], search.norm[0, c]
        if source[c] < 0 or (goal.deflate and value > -0.1 * floor):
            continue
        b = take_vector(search, goal.high, goal.high)
        if b < 0:
            break
        small = min(goal0, max(1e-3 * abs(value), floor)) if goal.deflate else goal0
        search.status[b] = FOUND if residual <= small else CANDIDATE
        search.age[b], search.used[b] = ages[source[c]], False
        search.ritz[b], search.residual[b] = value, residual
        search.origin[b] = search.counts.shift[0, source[c]]
        vector[c] = b
    for start in range(0, d, CHUNK):
        for c in range(8):
            if vector[c] >= 0:
                for j in range(start, min(start + CHUNK, d)):
                    pool[vector[c], j] = x[j, c]


@inner
def random_start(
    v: Floats, order: Ints, changed: Bools, narrow: bool, seed: np.uint64
) -> np.uint64:
    """Fill a vector with uniform noise, mostly where the matrix changed; return the next seed.

    By a xorshift generator (Marsaglia 2003, J. Stat. Software 8 (14)), whose seed is not 0.
    """
    for j in range(v.size):
        seed ^= seed << np.uint64(13)
        seed ^= seed >> np.uint64(7)
        seed ^= seed << np.uint64(17)
        v[j] = float(seed >> np.uint64(11)) * 2.0**-52 - 1.0
        if narrow and not changed[order[j]]:
            v[j] *= NOISE
    return seed


@inner
def largest_pairs(search: Search, goal: Goal, order: Ints) -> tuple[Floats, Floats, float]:
    """The largest k pairs found, and more that equal the k-th; see `track`."""
    pool, x = search.pool, search.x
    slots, d = pool.shape
    found = 0
    for b in range(slots):
        found += search.status[b] == FOUND
    found = min(found, goal.k + goal.extra)
    pairs, chosen = np.empty((2, found), np.float64), np.empty(found, np.int32)
    kept = 0
    for c in range(found):
        best = -1
        for b in range(slots):
            if search.status[b] == FOUND and (best < 0 or search.ritz[b] > search.ritz[best]):
                best = b
        search.status[best] = FREE
        pairs[0, c], pairs[1, c], chosen[c] = search.ritz[best], search.residual[best], best
        if c < goal.k or pairs[0, c] >= pairs[0, goal.k - 1] - 1e-6 * goal.scale:
            kept += 1
    departure = 0.0
    for start in range(0, kept, 8):  # every eight against all
        for q in range(8):
            for j in range(d):
                x[j, q] = pool[chosen[start + q], j] if start + q < kept else 0.0
        for c in range(kept):
            gram = spread(0.0)
            for j in range(d):
                gram = plus(gram, pool[chosen[c], j], load(x, j))
            store(search.theta, 0, gram)
            for q in range(8):
                departure = max(departure, abs(search.theta[0, q] - (start + q == c)))
    vectors = np.empty((d, kept), np.float64)
    for j in range(d):
        for c in range(kept):
            vectors[order[j], c] = pool[chosen[c], j]
    return pairs, vectors, departure
