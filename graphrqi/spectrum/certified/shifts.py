"""Kernels: where to factorise next, and what the counts of factorisations say.

The number of negative pivots of M - s I is the number of eigenvalues below s (Sylvester's law of
inertia). The counts at all shifts so far say between which of them an eigenvalue is missing.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

import math

import numpy as np

from graphrqi.spectrum.certified.search import (
    CANDIDATE,
    COUNT,
    FOUND,
    FREE,
    IDLE,
    MAX_COUNTS,
    NEW,
    Goal,
    Search,
)
from sim.compiled import inner

ROUNDING = 2.220446049250313e-16
MAX_AGE = 2
"""Attempts per vector before it is dropped as not converging."""
ZONE = 4.0
"""Wanted eigenvalues are searched in this many times the share of an interval that they would fill
if all were evenly spread."""


@inner
def add_counts(search: Search, ignored: int, scale: float, n: int) -> int:
    """Enter the counts of a factorisation among the n so far; return how many there are now.

    A count that contradicts its neighbours is left out. ``ignored`` eigenvalues are zero and do
    not count.
    """
    counted, doubt, above = search.counted, search.doubt, search.above
    for q in range(8):
        s = search.counts.shift[0, q]
        count = int(search.counts.above[0, q]) - ignored
        uncertain = 4.0 * ROUNDING * search.counts.growth[0, q]
        if search.vector[q] == IDLE or n == MAX_COUNTS or uncertain > 1e-4 * scale:
            continue
        if not counted[n - 1] < s < counted[0]:
            continue
        i = n
        while counted[i - 1] < s:
            i -= 1
        if counted[i - 1] == s or above[i - 1] > count or above[i] < count:
            continue
        for b in range(n, i, -1):
            counted[b], doubt[b], above[b] = counted[b - 1], doubt[b - 1], above[b - 1]
        counted[i], doubt[i], above[i] = s, uncertain, count
        n += 1
    return n


@inner
def find_reliable(search: Search, n: int, k: int, delta: float) -> tuple[int, bool]:
    """Find the counts that no rounding error can have spoilt; one may be the certificate.

    Values up to ``delta`` from the k-th count as equal to it. Returns how many of the n counts are
    reliable, and whether k pairs are certified.
    """
    kth = kth_largest(search, k)
    n_reliable = 0
    certified = False
    for i in range(n):
        s, error = search.counted[i], search.doubt[i]
        near = False
        found = 0
        for b in range(search.status.size):
            if search.status[b] == FOUND:
                near = near or abs(search.ritz[b] - s) <= error + search.residual[b]
                found += search.ritz[b] > s
        if not near or i == 0 or i == n - 1:
            search.reliable[n_reliable] = i
            n_reliable += 1
        if not near and found == search.above[i] and s + error <= kth + delta:
            certified = True
    return n_reliable, certified


@inner
def kth_largest(search: Search, k: int) -> float:
    """Return the k-th largest Ritz value of those found and in use, or -inf if there are fewer."""
    bound = math.inf
    left = k
    while left > 0:
        best = -math.inf
        for b in range(search.status.size):
            if search.status[b] == FOUND or search.used[b]:
                v = search.ritz[b]
                if best < v < bound:
                    best = v
        if best == -math.inf:
            return best
        for b in range(search.status.size):
            if search.status[b] == FOUND or search.used[b]:
                left -= search.ritz[b] == best
        bound = best
    return bound


@inner
def choose_shifts(
    search: Search, n_reliable: int, wanted: int, delta: float, first: bool, goal: Goal
) -> tuple[int, int]:
    """Decide at which eight shifts to factorise next, and with which vectors.

    ``first`` says whether this is the first factorisation after a change. Returns how many shifts
    have a vector, and the count at the first reliable shift that is not below ``wanted``.
    """
    shift, vector = search.counts.shift, search.vector
    used = int(np.int64(0))  # for a literal callees would be compiled once more
    beyond = wanted
    open_top = open_bottom = middle = deep_top = deep_bottom = 0.0
    for i in range(n_reliable - 1):
        here, below = search.reliable[i], search.reliable[i + 1]
        top, bottom = search.counted[here], search.counted[below]
        n, n_below = search.above[here], search.above[below]
        if n >= wanted:
            break
        if n_below >= wanted:
            beyond, deep_top, deep_bottom = n_below, top, bottom
        missing = (wanted if n_below > wanted else n_below) - n
        for b in range(search.status.size):
            if search.status[b] == FOUND:
                missing -= bottom < search.ritz[b] < top
        if missing > 0 and n_below > wanted and bottom > goal.low:
            missing += 1  # one that is not wanted may be among the candidates here
        half = 0.5 * (top + bottom)
        # Of n_below - n eigenvalues in between, those wanted are at the top.
        if not goal.deflate and here > 0 and bottom > goal.low:
            part = min(1.0, ZONE * missing / max(n_below - n, 1))
            bottom = top - part * (top - bottom)
        if missing <= 0:
            continue
        unmet, used = use_candidates(search, used, missing, bottom, top, n_below > wanted)
        if unmet > 0:
            if open_bottom == open_top:
                open_top, open_bottom, middle = top, bottom, half
            used = spread_shifts(search, used, min(unmet, 8 - used), bottom, top)
    solving = used
    last = kth_largest(search, wanted)
    if last > -math.inf:  # spare shifts: new starts after a change, counts below the k-th value
        doubt = 0.0
        for b in range(search.status.size):
            residual = search.residual[b]
            if search.used[b] and search.ritz[b] == last and residual < math.inf:
                doubt = min(1.5 * residual, 50.0 * residual**2 / goal.scale)
        if first and solving > 0:
            highest = last
            for b in range(search.status.size):
                if search.status[b] == FOUND or search.used[b]:
                    highest = max(highest, search.ritz[b])
            free = 8 - used if doubt > 0.0 else 7 - used  # a count below the k-th is worth one
            used = solving = spread_shifts(search, used, free, last, highest)
        elif open_top > open_bottom:  # what is missing is sooner found from several places
            free = 8 - used if goal.deflate else 7 - used
            used = solving = spread_shifts(search, used, free, open_bottom, open_top)
            if not goal.deflate and used < 8:  # should it be far down: halve the interval at least
                shift[0, used], vector[used] = middle, COUNT
                used += 1
        used = count_below(search, used, last, doubt, delta, goal)
    if beyond > wanted:  # spare shifts divide the interval of the eigenvalues beyond
        for r in range(8 - used):
            shift[0, used], vector[used] = deep_bottom * math.exp(-1.0 - r), COUNT
            if deep_top != 0.0:
                shift[0, used] = deep_top - (deep_top - deep_bottom) * (r + 1.0) / 8.0
            used += 1
    for q in range(used, 8):
        shift[0, q], vector[q] = goal.low - goal.scale, IDLE
    return solving, beyond


@inner
def use_candidates(
    search: Search, used: int, missing: int, bottom: float, top: float, largest: bool
) -> tuple[int, int]:
    """Use candidates inside an interval, each with a shift at its Ritz value while there is one.

    Those with the ``largest`` Ritz values come first, else the most accurate. Returns how many are
    still missing, and the shifts in use now.
    """
    unmet = missing
    for _ in range(missing):
        best = -1
        for b in range(search.status.size):
            inside = bottom < search.ritz[b] < top
            if inside and search.status[b] == CANDIDATE and not search.used[b]:
                better = best < 0
                if best >= 0 and largest:
                    better = search.ritz[b] > search.ritz[best]
                elif best >= 0:
                    better = search.residual[b] < search.residual[best]
                if better:
                    best = b
        if best < 0:
            break
        search.used[best] = True
        unmet -= 1
        if used < 8:
            search.counts.shift[0, used], search.vector[used] = search.ritz[best], best
            used += 1
    return unmet, used


@inner
def count_below(
    search: Search, used: int, last: float, doubt: float, delta: float, goal: Goal
) -> int:
    """Use spare shifts to count just below the k-th value, and just above it; return those in use.

    The k-th value ``last`` may be up to ``doubt`` from the eigenvalue.
    """
    shift, vector = search.counts.shift, search.vector
    unit = min(goal.scale, 100.0 * abs(last)) if goal.deflate else goal.scale
    margin = max(doubt, 1e-4 * unit)
    while used < 8 and margin >= doubt and margin >= 1e-9 * unit:
        shift[0, used], vector[used] = last - margin, COUNT
        used += 1
        margin *= 0.03
    if doubt < 0.5 * delta and used < 8:
        shift[0, used], vector[used] = last + 0.5 * delta, COUNT
        used += 1
    return used


@inner
def spread_shifts(search: Search, used: int, n: int, bottom: float, top: float) -> int:
    """Spread n shifts over an interval, geometrically where it ends at 0; return those in use.

    Each gets the best candidate that came from the interval before, or a new vector.
    """
    for r in range(n):
        s = bottom + (top - bottom) * (n - r) / (n + 1.0)
        if top == 0.0:
            s = bottom * math.exp(-1.0 - r)
        best = take_vector(search, bottom, top)
        if best < 0:
            break
        search.ritz[best], search.residual[best], search.used[best] = s, math.inf, True
        search.counts.shift[0, used], search.vector[used] = s, best
        used += 1
    return used


@inner
def take_vector(search: Search, bottom: float, top: float) -> int:
    """Return the best vector that came from an interval, else a free place, or -1 if none."""
    best = free = -1
    for b in range(search.status.size - 1, -1, -1):
        if search.status[b] == FREE:
            free = b
        elif search.status[b] == CANDIDATE and not search.used[b] and search.age[b] < MAX_AGE:
            inside = bottom < search.origin[b] < top
            if inside and (best < 0 or search.residual[b] < search.residual[best]):
                best = b
    if best >= 0:
        search.age[best] += 1
    elif free >= 0:
        best = free
        search.status[best], search.age[best] = NEW, 0
    return best
