"""Kernels: where to factorise next, and what the counts of factorisations say.

The number of negative pivots of M - s I is the number of eigenvalues below s (Sylvester's law of
inertia). The counts at all shifts so far say between which of them an eigenvalue is missing.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from graphrqi.spectrum.certified.factorization import Counts
from graphrqi.spectrum.certified.prepared import Bools, Floats, Ints
from graphrqi.spectrum.certified.rayleigh_ritz import Pool
from sim.compiled import inner

ROUNDING = 2.220446049250313e-16
MAX_COUNTS = 400
"""Shifts whose counts are kept."""
NOISE, COUNT, IDLE = -1, -2, -3
"""Instead of a candidate: a new vector of noise, a shift that only counts, one not in use."""
ZONE = 4.0
"""Wanted eigenvalues are searched in this many times the share of an interval that they would fill
if all were evenly spread."""


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
