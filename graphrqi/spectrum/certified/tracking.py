"""Kernel of the certified tracker: Rayleigh-quotient iterations that share their factorisations.

The steps are those of `graphrqi.spectrum.certified.solver`.
"""

from __future__ import annotations

import math

import numpy as np

from graphrqi.spectrum.certified.analysis import Analysis, Bools
from graphrqi.spectrum.certified.factorization import (
    SHIFT,
    FactorMemory,
    Pattern,
    PatternArrays,
    factor_and_solve,
)
from graphrqi.spectrum.certified.rayleigh_ritz import CHUNK, deflate_constants, rayleigh_ritz
from graphrqi.spectrum.certified.search import (
    AGE,
    BATCH_RESIDUAL,
    BATCH_RITZ,
    CANDIDATE,
    FOUND,
    FREE,
    IDLE,
    NEW,
    ORIGIN,
    RESIDUAL,
    RITZ,
    STATUS,
    USED,
    Floats,
    Goal,
    GoalValues,
    Ints,
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
from graphrqi.spectrum.certified.simd import aligned, load, plus, spread, store
from sim.compiled import compiled, inner

NOISE = 0.05
"""Size of a new vector's noise outside the rows that changed: an eigenvector of the new matrix has
a part in those rows, unless it was one of the old matrix already."""
MAX_START = 32
"""Vectors to start from that are used."""
DENSE_FACTOR = 8.0
"""Multiplications per entry of the factor from which on applying the same factors a third and a
fourth time is cheaper than new ones (measured)."""


def track(
    matrix: Analysis, goal: Goal, start: Floats, workspace: Floats
) -> tuple[bool, Floats, Floats, float]:
    """Find and certify the k largest eigenpairs of M.

    Args:
        matrix: M, perhaps not of all n rows, and the (n,) rows in which it changed.
        goal: what is searched for.
        start: (n, m) vectors to start from, by row; m may be 0.
        workspace: (r, 8) memory for the factor, r > number of its entries; overwritten.

    Returns:
        Whether none of the k was missed; (2, m) eigenvalues of M, descending, and residuals; (n, m)
        vectors by row; m >= k if certified; and how far their inner products are from those of
        orthonormal vectors at most.
    """
    order, pattern, label, components, work, _, _, changed = matrix
    # A plain tuple: handing a named one to a kernel takes 3 us.
    return _track(order, pattern, label, components, work, changed, (*goal,), start, workspace)


@compiled
def _track(
    order: Ints,
    pattern_arrays: PatternArrays,
    label: Ints,
    components: int,
    work: float,
    changed: Bools,
    goal_values: GoalValues,
    start: Floats,
    workspace: Floats,
) -> tuple[bool, Floats, Floats, float]:
    """The kernel of `track`, with its named tuples as plain ones."""
    pattern, goal = Pattern(*pattern_arrays), Goal(*goal_values)
    d = order.size
    k, deflate, scale = goal.k, goal.deflate, goal.scale
    ignored = components if deflate else 0
    search = new_search(goal, d, ignored)
    record, batch, vector, x = search.record, search.batch, search.vector, search.x
    n_shifts = int(np.int64(2))  # a literal would be compiled for once more
    pivots = aligned(np.empty((d + 1, 8), np.float64))
    memory = FactorMemory(aligned(workspace), pivots, search.ax)
    size, mean = component_sizes(label, components), np.empty((components, 8), np.float64)
    narrow = start.shape[1] > 0
    first = narrow
    seed = np.uint64(88172645463325252)
    delta0, floor = goal.tol * scale, 1e-13 * scale
    sweeps = 0
    before, ages = np.empty(8, np.float64), np.empty(8, np.int32)
    again = np.empty(8, np.int32)
    factorise = sweeps == 0  # no literal: see above
    most_reuses = 2 if work > DENSE_FACTOR * pattern.rows.size else 1
    reuses = most_reuses
    certified = stuck = False
    wanted = k  # raised where eigenvalues equal to the k-th have to be found too
    started = 0
    start_columns = min(start.shape[1], MAX_START)
    while True:
        starting = started < start_columns
        if starting:  # first, Rayleigh-Ritz in the span of the given vectors
            for q in range(8):
                batch[SHIFT, q], before[q], ages[q] = math.inf, math.inf, 0
            for j in range(d):
                for q in range(8):
                    c = started + q
                    x[j, q] = start[order[j], c] if c < start_columns else 0.0
            started += 8
        else:
            for b in range(record.shape[1]):
                record[USED, b] = 0
            delta = delta0
            if deflate:
                kth = kth_largest(record, k)
                delta = min(delta0, max(1e-2 * abs(kth), floor))
            n_reliable, certified = find_reliable(
                record, search.shifts, search.above, search.reliable, n_shifts, k, delta
            )
            if certified or sweeps >= goal.max_sweeps:
                break
            if factorise:
                solving, beyond = choose_shifts(search, n_reliable, wanted, delta, first, goal)
            else:
                for b in range(record.shape[1]):
                    record[USED, b] = record[STATUS, b] == CANDIDATE
            if solving == 0 and stuck:  # equal eigenvalues follow the k-th: find them all
                if beyond == wanted or beyond > record.shape[1] - 12:
                    break
                wanted = beyond
                stuck = False
                continue
            stuck = solving == 0
            first = False
            if solving > 0:
                seed = load_vectors(search, order, changed, narrow, seed, before)
            factor_and_solve(
                pattern, batch, 1e-15 * scale, factorise, 2 * (solving > 0), memory, x
            )  # fmt: skip
            if factorise:
                sweeps += 1
                n_shifts = add_counts(search, ignored, scale, n_shifts)
            if solving == 0:
                continue
            release_vectors(record, vector, ages)
        if deflate:
            deflate_constants(x, label, size, mean, search.ax)
        rayleigh_ritz(pattern, search)
        expected = keep_pairs(search, goal, before, ages, again, reuses)
        within_reach = expected  # pairs found, and those that these factors will do for
        for b in range(record.shape[1]):
            within_reach += record[STATUS, b] == FOUND
        if starting or expected == 0 or within_reach < wanted or reuses == 0:
            factorise, reuses = True, most_reuses
        else:
            factorise = False
            reuses -= 1
            for q in range(8):
                vector[q] = again[q]
    pairs, vectors, departure = largest_pairs(search, goal, order, changed.size)
    return certified, pairs, vectors, departure


@inner
def component_sizes(label: Ints, components: int) -> Floats:
    """(c,) number of rows of each component."""
    size = np.empty(components, np.float64)
    for c in range(components):
        size[c] = 0.0
    for j in range(label.size):
        size[label[j]] += 1.0
    return size


@inner
def load_vectors(
    search: Search, order: Ints, changed: Bools, narrow: bool, seed: np.uint64, before: Floats
) -> np.uint64:
    """Fill the eight columns with the vectors of the eight shifts, new ones with noise.

    Args:
        search: ``x`` is overwritten; a column without a vector becomes 0.
        order: (d,) row at each place.
        changed: rows where the matrix changed.
        narrow: whether noise is mostly there.
        seed: state of the generator.
        before: (8,) overwritten by the vectors' residuals.

    Returns:
        The generator's next state.
    """
    record, pool, x, vector = search.record, search.pool, search.x, search.vector
    d = pool.shape[1]
    for q in range(8):
        if vector[q] >= 0 and record[STATUS, vector[q]] == NEW:
            seed = random_start(pool[vector[q]], order, changed, narrow, seed)
        before[q] = record[RESIDUAL, vector[q]] if vector[q] >= 0 else math.inf
    for start in range(0, d, CHUNK):
        for q in range(8):
            for j in range(start, min(start + CHUNK, d)):
                x[j, q] = pool[vector[q], j] if vector[q] >= 0 else 0.0
    return seed


@inner
def release_vectors(record: Floats, vector: Ints, ages: Ints) -> None:
    """Free the places of vectors that are not in use: Ritz vectors will take them.

    Args:
        record: what is known of each vector.
        vector: (8,) those of the eight, which are freed, too.
        ages: (8,) overwritten by how often each of the eight was tried.
    """
    for q in range(8):
        ages[q] = 0
        if vector[q] >= 0:
            ages[q] = record[AGE, vector[q]]
            record[USED, vector[q]] = 0
    for b in range(record.shape[1]):
        if record[STATUS, b] != FOUND and record[USED, b] == 0:
            record[STATUS, b] = FREE


@inner
def keep_pairs(
    search: Search, goal: Goal, before: Floats, ages: Ints, again: Ints, reuses: int
) -> int:
    """Put the Ritz pairs of the eight among the others, found or candidates.

    Args:
        search: its ``vector`` is overwritten by the place of each Ritz vector.
        goal: what is searched for.
        before: (8,) residuals of the columns before the factors were applied.
        ages: (8,) how often those were tried.
        again: (8,) overwritten by the vector, for each of the eight shifts, that the same factors
            may make converge; IDLE if there is none.
        reuses: how often the same factors may be applied again.

    Returns:
        How many vectors the same factors will probably make converge.
    """
    record, batch, vector, source = search.record, search.batch, search.vector, search.source
    pool, x = search.pool, search.x
    d = pool.shape[1]
    goal0, floor = 0.9 * goal.tol * goal.scale, 1e-13 * goal.scale
    for c in range(8):
        vector[c] = IDLE
        again[c] = IDLE
    expected = 0
    for c in range(8):
        value, residual = batch[BATCH_RITZ, c], batch[BATCH_RESIDUAL, c]
        if source[c] < 0 or (goal.deflate and value > -0.1 * floor):
            continue
        b = take_vector(record, goal.high, goal.high)
        if b < 0:
            break
        small = min(goal0, max(1e-3 * abs(value), floor)) if goal.deflate else goal0
        record[STATUS, b] = FOUND if residual <= small else CANDIDATE
        record[AGE, b], record[USED, b] = ages[source[c]], 0
        record[RITZ, b], record[RESIDUAL, b] = value, residual
        record[ORIGIN, b] = batch[SHIFT, source[c]]
        vector[c] = b
        earlier = before[source[c]]
        if again[source[c]] == IDLE and residual > small:
            gain = residual / earlier  # what these factors did, and would do again
            if residual * (gain if reuses == 1 else gain * gain) < small:
                again[source[c]] = b
                expected += earlier < math.inf
    for start in range(0, d, CHUNK):
        for c in range(8):
            if vector[c] >= 0:
                for j in range(start, min(start + CHUNK, d)):
                    pool[vector[c], j] = x[j, c]
    return expected


@inner
def random_start(
    v: Floats, order: Ints, changed: Bools, narrow: bool, seed: np.uint64
) -> np.uint64:
    """Fill a vector with uniform noise, mostly where the matrix changed.

    Args:
        v: (d,) overwritten.
        order: (d,) row at each place.
        changed: rows where the matrix changed.
        narrow: whether noise is mostly there.
        seed: state of a xorshift generator, not 0.

    Returns:
        Its next state.

    References:
        Marsaglia (2003), Xorshift RNGs, J. Stat. Software 8 (14).
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
def largest_pairs(search: Search, goal: Goal, order: Ints, n: int) -> tuple[Floats, Floats, float]:
    """The largest k pairs found, and more that equal the k-th.

    Args:
        search: where they are; overwritten.
        goal: what was searched for.
        order: (d,) row at each place.
        n: rows of the answer.

    Returns:
        (2, m) eigenvalues, descending, and residuals; (n, c) vectors by row, c <= m; and how far
        their inner products are from those of orthonormal vectors at most.
    """
    pool, record, x, batch = search.pool, search.record, search.x, search.batch
    slots, d = pool.shape
    found = 0
    for b in range(slots):
        found += record[STATUS, b] == FOUND
    found = min(found, goal.k + goal.extra)
    pairs, chosen = np.empty((2, found), np.float64), np.empty(found, np.int32)
    kept = 0
    for c in range(found):
        best = -1
        for b in range(slots):
            if record[STATUS, b] == FOUND and (best < 0 or record[RITZ, b] > record[RITZ, best]):
                best = b
        record[STATUS, best] = FREE
        pairs[0, c], pairs[1, c], chosen[c] = record[RITZ, best], record[RESIDUAL, best], best
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
            store(batch, BATCH_RITZ, gram)
            for q in range(8):
                departure = max(departure, abs(batch[BATCH_RITZ, q] - (start + q == c)))
    vectors = np.empty((n, kept), np.float64)
    for i in range(n if d < n else 0):
        for c in range(kept):
            vectors[i, c] = 0.0
    for j in range(d):
        for c in range(kept):
            vectors[order[j], c] = pool[chosen[c], j]
    return pairs, vectors, departure
