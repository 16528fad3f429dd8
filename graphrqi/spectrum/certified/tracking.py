"""Kernel of the certified tracker: Rayleigh-quotient iterations that share their factorisations.

All vectors are in elimination order. M is L at the largest end and -L at the smallest: the wanted
eigenvalues are always M's largest. The steps are those of `graphrqi.spectrum.certified.solver`.
The number of negative pivots of M - s I is the number of eigenvalues below s. The counts at all
shifts so far say between which of them an eigenvalue is missing.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from graphrqi.spectrum.certified.factorization import (
    Bools,
    Counts,
    Factor,
    Floats,
    Ints,
    Prepared,
    factor_and_solve,
    load,
    more,
    plus,
    spread,
    store,
    times,
)
from sim.compiled import inner, vectorised

MAX_START = 32
"""Vectors to start from that are used."""
ROUNDING = 2.220446049250313e-16
MAX_COUNTS = 400
"""Shifts whose counts are kept."""
NOISE, COUNT, IDLE = -1, -2, -3
"""Instead of a candidate: a new vector of noise, a shift that only counts, one not in use."""
ZONE = 4.0
"""Wanted eigenvalues are searched in this many times the share of an interval that they would fill
if all were evenly spread."""
INDEPENDENT = 1e-3
"""A column is kept if this part of it is outside the span of the others; orthogonality is restored
at the end."""
SPARE = 24
"""Vectors kept beyond the wanted number: those of three factorisations."""

Ritz: TypeAlias = tuple[Floats, Floats, Floats]
"""(r,) Ritz values, (r,) residuals, and (r, d) unit vectors."""


class Pool(NamedTuple):
    """The pairs found so far, and candidates that have not converged.

    Attributes:
        size: (1,) how many are found.
        vectors: (n, d) orthonormal vectors of those found,
        value: (n,) their eigenvalues, descending,
        residual: (n,) and residuals.
        candidates: (c, d) Ritz vectors that have not converged,
        candidate_value: (c,) their Ritz values,
        candidate_residual: (c,) and residuals; infinite where there is none.
        used: (c,) whether a candidate is used in this round.
    """

    size: Ints
    vectors: Floats
    value: Floats
    residual: Floats
    candidates: Floats
    candidate_value: Floats
    candidate_residual: Floats
    used: Bools


@inner
def new_pool(k: int, d: int) -> Pool:
    """Memory for the search of k pairs of d rows."""
    n = min(2 * k + SPARE, d + SPARE)
    return Pool(
        np.zeros(1, np.int32), np.empty((n, d)), np.empty(n), np.empty(n),
        np.empty((n, d)), np.empty(n), np.full(n, math.inf), np.zeros(n, np.bool_),
    )  # fmt: skip


@inner
def ritz_pairs(matrix: Prepared, deflate: bool, pool: Pool, x: Floats, ax: Floats) -> Ritz:
    """Ritz pairs of M in the span of the eight columns, outside the span of the vectors found.

    With ``deflate``, also outside the null space. The columns are overwritten.
    """
    scale_columns(x, 0.0)
    if deflate:
        take_means(x, matrix.label, matrix.components)
        scale_columns(x, INDEPENDENT)
    found = pool.vectors[: pool.size[0]]
    shortest = 0.0
    while pool.size[0] > 0 and shortest < 0.5:  # Gram-Schmidt, twice if need be
        x -= np.dot(found.T, np.dot(found, x))
        shortest = scale_columns(x, INDEPENDENT)
    multiply(matrix, x, ax)
    size, turn = np.linalg.eigh(np.dot(x.T, x))
    rank = 0
    for q in range(8):
        if size[q] > INDEPENDENT**2:
            turn[:, rank] = turn[:, q] / math.sqrt(size[q])
            rank += 1
    basis = np.ascontiguousarray(turn[:, :rank])
    if rank == 0:
        return np.empty(0), np.empty(0), np.empty((0, len(x)))
    theta, inner_turn = np.linalg.eigh(np.dot(basis.T, np.dot(np.dot(x.T, ax), basis)))
    turned = np.dot(basis, np.ascontiguousarray(inner_turn))
    vectors, products = np.dot(turned.T, x.T), np.dot(turned.T, ax.T)
    residual = np.empty(rank)
    for r in range(rank):
        total = 0.0
        for j in range(len(x)):
            total += (products[r, j] - theta[r] * vectors[r, j]) ** 2
        residual[r] = math.sqrt(total)
    return theta, residual, vectors


@inner
def keep_pairs(pool: Pool, ritz: Ritz, scale: float, tol: float) -> None:
    """Put Ritz pairs among those found, if they have converged, or among the candidates.

    Values near 0 need smaller residuals: M's are all negative there, or far larger than this.
    """
    theta, residual, vectors = ritz
    floor = 1e-13 * scale
    for r in range(theta.size - 1, -1, -1):
        goal = 0.9 * tol * scale
        goal = min(goal, max(1e-3 * abs(theta[r]), floor)) if theta[r] < 0.0 else goal
        n = pool.size[0]
        if residual[r] <= goal and n < len(pool.vectors):
            while n > 0 and pool.value[n - 1] < theta[r]:
                pool.value[n], pool.residual[n] = pool.value[n - 1], pool.residual[n - 1]
                pool.vectors[n] = pool.vectors[n - 1]
                n -= 1
            pool.value[n], pool.residual[n], pool.vectors[n] = theta[r], residual[r], vectors[r]
            pool.size[0] += 1
        elif residual[r] > goal:
            c = np.argmax(pool.candidate_residual)
            pool.candidate_value[c], pool.candidate_residual[c] = theta[r], residual[r]
            pool.candidates[c] = vectors[r]


@inner
def scale_columns(x: Floats, least: float) -> float:
    """Scale the eight columns to unit length; those no longer than ``least`` become 0.

    Returns the length of the shortest of the others, or 1 if all are longer.
    """
    square, shortest = spread(0.0), 1.0
    for j in range(len(x)):
        y = load(x, j)
        square = more(square, y, y)
    factor = np.empty((1, 8))
    store(factor, 0, square)
    for q in range(8):
        length = math.sqrt(factor[0, q])
        usable = least < length < math.inf
        factor[0, q] = 1.0 / length if usable else 0.0
        shortest = min(shortest, length) if usable else shortest
        if not usable:
            x[:, q] = 0.0
    scale = load(factor, 0)
    for j in range(len(x)):
        store(x, j, times(load(x, j), scale))
    return shortest


@inner
def take_means(x: Floats, label: Ints, components: int) -> None:
    """Make the eight columns orthogonal to the indicators of the components, -L's null space."""
    mean, size = np.zeros((components, 8)), np.zeros(components)
    for j in range(label.size):
        size[label[j]] += 1.0
        for q in range(8):
            mean[label[j], q] += x[j, q]
    for j in range(label.size):
        for q in range(8):
            x[j, q] -= mean[label[j], q] / size[label[j]]


@inner
def multiply(matrix: Prepared, x: Floats, ax: Floats) -> None:
    """Overwrite ``ax`` (d, 8) by M x."""
    starts, rows, entries, diagonal = matrix.starts, matrix.rows, matrix.entries, matrix.diagonal
    d = diagonal.size
    for j in range(d):
        store(ax, j, plus(spread(0.0), diagonal[j], load(x, j)))
    for j in range(d):
        y, total = load(x, j), load(ax, j)
        for p in range(starts[j], starts[j + 1]):
            v, i = entries[p], rows[p]
            total = plus(total, v, load(x, i))
            store(ax, i, plus(load(ax, i), v, y))
        store(ax, j, total)


class Ledger(NamedTuple):
    """The counts so far.

    Attributes:
        size: (1,) how many.
        shift: (m,) where eigenvalues were counted, descending,
        doubt: (m,) uncertainty of these shifts,
        above: (m,) and eigenvalues above each.
        reliable: (m,) whether no rounding error can have spoilt the count.
    """

    size: Ints
    shift: Floats
    doubt: Floats
    above: Ints
    reliable: Bools


@inner
def new_ledger(low: float, high: float, count: int) -> Ledger:
    """Two shifts are counted already: all eigenvalues are between low and high."""
    ledger = Ledger(
        np.full(1, 2, np.int32), np.empty(MAX_COUNTS), np.zeros(MAX_COUNTS),
        np.zeros(MAX_COUNTS, np.int32), np.ones(MAX_COUNTS, np.bool_),
    )  # fmt: skip
    ledger.shift[0], ledger.shift[1], ledger.above[1] = high, low, count
    return ledger


@inner
def add_counts(ledger: Ledger, counts: Counts, source: Ints, ignored: int, scale: float) -> None:
    """Enter the counts of a factorisation; ``ignored`` eigenvalues are zero and do not count.

    A count that contradicts its neighbours is left out.
    """
    shift, doubt, above = ledger.shift, ledger.doubt, ledger.above
    for q in range(8):
        n, s = ledger.size[0], counts.shift[0, q]
        count = int(counts.above[0, q]) - ignored
        uncertain = 4.0 * ROUNDING * counts.growth[0, q]
        if source[q] == IDLE or n == MAX_COUNTS or uncertain > 1e-4 * scale:
            continue
        if not shift[n - 1] < s < shift[0]:
            continue
        i = n
        while shift[i - 1] < s:
            i -= 1
        if shift[i - 1] == s or above[i - 1] > count or above[i] < count:
            continue
        for b in range(n, i, -1):
            shift[b], doubt[b], above[b] = shift[b - 1], doubt[b - 1], above[b - 1]
        shift[i], doubt[i], above[i] = s, uncertain, count
        ledger.size[0] += 1


@inner
def find_reliable(ledger: Ledger, pool: Pool, k: int, delta: float) -> bool:
    """Find the counts that no rounding error can have spoilt; say whether one certifies k pairs.

    Values up to ``delta`` from the k-th count as equal to it.
    """
    found, n = pool.size[0], ledger.size[0]
    certified = False
    for i in range(n):
        s, error = ledger.shift[i], ledger.doubt[i]
        near = False
        larger = 0
        for b in range(found):
            near = near or abs(pool.value[b] - s) <= error + pool.residual[b]
            larger += pool.value[b] > s
        ledger.reliable[i] = not near or i == 0 or i == n - 1
        if not near and found >= k and larger == ledger.above[i]:
            certified = certified or s + error <= pool.value[k - 1] + delta
    return certified


@inner
def choose_shifts(
    ledger: Ledger, pool: Pool, counts: Counts, source: Ints, wanted: int, delta: float, goal: Any
) -> tuple[int, int]:
    """Decide at which eight shifts to factorise next, and with which vectors.

    Returns how many shifts have a vector, and the count at the first reliable shift that is not
    below ``wanted``.
    """
    shift = counts.shift[0]
    used, here = int(np.int64(0)), 0  # for a literal callees would be compiled once more
    beyond = wanted
    open_top = open_bottom = middle = deep_top = deep_bottom = 0.0
    for below in range(1, ledger.size[0]):
        if not ledger.reliable[below]:
            continue
        top, bottom = ledger.shift[here], ledger.shift[below]
        n, n_below = ledger.above[here], ledger.above[below]
        first, here = here == 0, below
        if n >= wanted:
            break
        if n_below >= wanted:
            beyond, deep_top, deep_bottom = n_below, top, bottom
        missing = min(wanted, n_below) - n
        for b in range(pool.size[0]):
            missing -= bottom < pool.value[b] < top
        if missing <= 0:
            continue
        if n_below > wanted and bottom > goal.low:
            missing += 1  # one that is not wanted may be among the candidates here
        half = 0.5 * (top + bottom)
        if not goal.deflate and not first and bottom > goal.low:  # those wanted are at the top
            bottom = top - min(1.0, ZONE * missing / max(n_below - n, 1)) * (top - bottom)
        for _ in range(missing):
            best = best_candidate(pool, bottom, top, n_below > wanted)
            if best < 0:
                break
            pool.used[best] = True
            missing -= 1
            if used < 8:
                shift[used], source[used] = pool.candidate_value[best], best
                used += 1
        if missing > 0:
            if open_bottom == open_top:
                open_top, open_bottom, middle = top, bottom, half
            used = spread_shifts(counts, source, used, min(missing, 8 - used), bottom, top)
    solving = used
    if used < 8 and open_top > open_bottom:  # what is missing is sooner found from several places
        free = 8 - used if goal.deflate else 7 - used
        used = solving = spread_shifts(counts, source, used, free, open_bottom, open_top)
        if used < 8:  # should it be far down: halve the interval at least
            shift[used], source[used] = middle, COUNT
            used += 1
    used = count_below(pool, counts, source, used, wanted, delta, goal)
    if beyond > wanted:  # spare shifts divide the interval of the eigenvalues beyond
        for r in range(8 - used):
            shift[used], source[used] = deep_bottom * math.exp(-1.0 - r), COUNT
            if deep_top != 0.0:
                shift[used] = deep_top - (deep_top - deep_bottom) * (r + 1.0) / 8.0
            used += 1
    for q in range(used, 8):
        shift[q], source[q] = goal.low - goal.scale, IDLE
    for c in range(pool.used.size):
        pool.used[c] = False
    return solving, beyond


@inner
def best_candidate(pool: Pool, bottom: float, top: float, largest: bool) -> int:
    """The candidate of an interval with the largest value, or the most accurate; -1 for none."""
    best = -1
    for c in range(pool.used.size):
        inside = bottom < pool.candidate_value[c] < top and not pool.used[c]
        if inside and pool.candidate_residual[c] < math.inf:
            better = best < 0
            if best >= 0 and largest:
                better = pool.candidate_value[c] > pool.candidate_value[best]
            elif best >= 0:
                better = pool.candidate_residual[c] < pool.candidate_residual[best]
            best = c if better else best
    return best


@inner
def count_below(
    pool: Pool, counts: Counts, source: Ints, used: int, wanted: int, delta: float, goal: Any
) -> int:
    """Use spare shifts to count just below the last wanted value, and just above it.

    Candidates count for as far as their eigenvalues may be from their Ritz values. Returns how many
    shifts are in use.
    """
    shift, values = counts.shift[0], np.empty(pool.value.size + 8)
    n = pool.size[0]
    values[:n] = pool.value[:n]
    for q in range(used):
        values[n] = shift[q]
        n += source[q] >= 0
    if n < wanted:
        return used
    last = np.sort(values[:n])[n - wanted]
    doubt = 0.0
    for q in range(used):
        if source[q] >= 0 and shift[q] == last:
            residual = pool.candidate_residual[source[q]]
            doubt = min(1.5 * residual, 50.0 * residual**2 / goal.scale)
    unit = min(goal.scale, 100.0 * abs(last)) if goal.deflate else goal.scale
    margin = max(doubt, 1e-4 * unit)
    while used < 8 and margin >= doubt and margin >= 1e-9 * unit:
        shift[used], source[used] = last - margin, COUNT
        used += 1
        margin *= 0.03
    if doubt < 0.5 * delta and used < 8:
        shift[used], source[used] = last + 0.5 * delta, COUNT
        used += 1
    return used


@inner
def spread_shifts(
    counts: Counts, source: Ints, used: int, n: int, bottom: float, top: float
) -> int:
    """Spread n shifts with new vectors over an interval, geometrically where it ends at 0.

    Returns how many shifts are in use.
    """
    for r in range(n):
        s = bottom + (top - bottom) * (n - r) / (n + 1.0)
        if top == 0.0:
            s = bottom * math.exp(-1.0 - r)
        counts.shift[0, used], source[used] = s, NOISE
        used += 1
    return used


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
    """Find and certify the k largest eigenpairs of M, from vectors ``start`` (d, any) by row.

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
