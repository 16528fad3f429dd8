"""Kernels: where to factorise next, and what the counts of factorisations say.

The number of negative pivots of M - s I is the number of eigenvalues below s (Sylvester's law of
inertia). The counts at all shifts so far say between which of them an eigenvalue is missing.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (spectrum slicing).
"""

from __future__ import annotations

import math

import numpy as np

from graphrqi.spectrum.certified.factorization import ABOVE, GROWTH, SHIFT
from graphrqi.spectrum.certified.search import (
    AGE,
    CANDIDATE,
    COUNT,
    FOUND,
    FREE,
    IDLE,
    MAX_COUNTS,
    NEW,
    ORIGIN,
    RESIDUAL,
    RITZ,
    STATUS,
    USED,
    Floats,
    Goal,
    Ints,
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
    """Enter the counts of a factorisation among the others.

    Args:
        search: ``batch`` holds shifts, counts and largest pivots of `factor_and_solve`.
        ignored: zero eigenvalues, which do not count.
        scale: lower bound on the norm of M.
        n: how many shifts were counted before.

    Returns:
        How many there are now. A count that contradicts its neighbours is left out.
    """
    batch, vector, shifts, above = search.batch, search.vector, search.shifts, search.above
    for q in range(8):
        s = batch[SHIFT, q]
        count = int(batch[ABOVE, q]) - ignored
        uncertain = 4.0 * ROUNDING * batch[GROWTH, q]
        if vector[q] == IDLE or n == MAX_COUNTS or uncertain > 1e-4 * scale:
            continue
        if not shifts[0, n - 1] < s < shifts[0, 0]:
            continue
        i = n
        while shifts[0, i - 1] < s:
            i -= 1
        if shifts[0, i - 1] == s or above[i - 1] > count or above[i] < count:
            continue
        for b in range(n, i, -1):
            shifts[0, b], shifts[1, b], above[b] = shifts[0, b - 1], shifts[1, b - 1], above[b - 1]
        shifts[0, i], shifts[1, i], above[i] = s, uncertain, count
        n += 1
    return n


@inner
def find_reliable(
    record: Floats, shifts: Floats, above: Ints, reliable: Ints, n: int, k: int, delta: float
) -> tuple[int, bool]:
    """Find the counts that no rounding error can have spoilt; one may be the certificate.

    Args:
        record: what is known of each vector.
        shifts: (2, m) shifts that were counted, descending, and their uncertainties.
        above: (m,) their counts.
        reliable: (m,) overwritten.
        n: how many shifts were counted.
        k: wanted pairs.
        delta: values this close to the k-th count as equal to it.

    Returns:
        How many are reliable, and whether k pairs are certified.
    """
    kth = kth_largest(record, k)
    n_reliable = 0
    certified = False
    for i in range(n):
        s, error = shifts[0, i], shifts[1, i]
        near = False
        found = 0
        for b in range(record.shape[1]):
            if record[STATUS, b] == FOUND:
                near = near or abs(record[RITZ, b] - s) <= error + record[RESIDUAL, b]
                found += record[RITZ, b] > s
        if not near or i == 0 or i == n - 1:
            reliable[n_reliable] = i
            n_reliable += 1
        if not near and found == above[i] and s + error <= kth + delta:
            certified = True
    return n_reliable, certified


@inner
def kth_largest(record: Floats, k: int) -> float:
    """Return the k-th largest Ritz value of those found and in use, or -inf if there are fewer."""
    slots = record.shape[1]
    bound = math.inf
    left = k
    while left > 0:
        best = -math.inf
        for b in range(slots):
            if record[STATUS, b] == FOUND or record[USED, b] > 0:
                v = record[RITZ, b]
                if best < v < bound:
                    best = v
        if best == -math.inf:
            return best
        for b in range(slots):
            if record[STATUS, b] == FOUND or record[USED, b] > 0:
                left -= record[RITZ, b] == best
        bound = best
    return bound


@inner
def choose_shifts(
    search: Search, n_reliable: int, wanted: int, delta: float, first: bool, goal: Goal
) -> tuple[int, int]:
    """Decide where to factorise next, and with which vectors.

    Args:
        search: ``batch`` is overwritten by the shifts, ``vector`` by their vectors; a new vector,
            to be filled with noise, is marked NEW.
        n_reliable: how many of the counts are reliable.
        wanted: eigenvalues to find.
        delta: values this close count as equal.
        first: whether this is the first factorisation after a change.
        goal: what is searched for.

    Returns:
        Shifts that have a vector, and the count at the first reliable shift that is not below
        ``wanted``.
    """
    record, batch, vector = search.record, search.batch, search.vector
    shifts, above, reliable = search.shifts, search.above, search.reliable
    used = int(np.int64(0))  # for a literal callees would be compiled once more
    beyond = wanted
    open_top = open_bottom = middle = deep_top = deep_bottom = 0.0
    for i in range(n_reliable - 1):
        here, below = reliable[i], reliable[i + 1]
        top, bottom = shifts[0, here], shifts[0, below]
        n, n_below = above[here], above[below]
        if n >= wanted:
            break
        if n_below >= wanted:
            beyond, deep_top, deep_bottom = n_below, top, bottom
        missing = (wanted if n_below > wanted else n_below) - n
        for b in range(record.shape[1]):
            if record[STATUS, b] == FOUND:
                missing -= bottom < record[RITZ, b] < top
        if missing > 0 and n_below > wanted and bottom > goal.low:
            missing += 1  # one that is not wanted may be among the candidates here
        half = 0.5 * (top + bottom)
        # Of n_below - n eigenvalues in between, those wanted are at the top.
        if not goal.deflate and here > 0 and bottom > goal.low:
            part = min(1.0, ZONE * missing / max(n_below - n, 1))
            bottom = top - part * (top - bottom)
        if missing <= 0:
            continue
        unmet, used = use_candidates(
            record, batch, vector, used, missing, bottom, top, n_below > wanted
        )
        if unmet > 0:
            if open_bottom == open_top:
                open_top, open_bottom, middle = top, bottom, half
            used = spread_shifts(record, batch, vector, used, min(unmet, 8 - used), bottom, top)
    solving = used
    last = kth_largest(record, wanted)
    if last > -math.inf:  # spare shifts: new starts after a change, counts below the k-th value
        doubt = 0.0
        for b in range(record.shape[1]):
            if record[USED, b] > 0 and record[RITZ, b] == last and record[RESIDUAL, b] < math.inf:
                doubt = min(1.5 * record[RESIDUAL, b], 50.0 * record[RESIDUAL, b] ** 2 / goal.scale)
        if first and solving > 0:
            highest = last
            for b in range(record.shape[1]):
                if record[STATUS, b] == FOUND or record[USED, b] > 0:
                    highest = max(highest, record[RITZ, b])
            free = 8 - used if doubt > 0.0 else 7 - used  # a count below the k-th is worth one
            used = solving = spread_shifts(record, batch, vector, used, free, last, highest)
        elif open_top > open_bottom:  # what is missing is sooner found from several places
            free = 8 - used if goal.deflate else 7 - used
            used = solving = spread_shifts(record, batch, vector, used, free, open_bottom, open_top)
            if not goal.deflate and used < 8:  # should it be far down: halve the interval at least
                batch[SHIFT, used], vector[used] = middle, COUNT
                used += 1
        used = count_below(batch, vector, used, last, doubt, delta, goal)
    if beyond > wanted:  # spare shifts divide the interval of the eigenvalues beyond
        for r in range(8 - used):
            batch[SHIFT, used], vector[used] = deep_bottom * math.exp(-1.0 - r), COUNT
            if deep_top != 0.0:
                batch[SHIFT, used] = deep_top - (deep_top - deep_bottom) * (r + 1.0) / 8.0
            used += 1
    for q in range(used, 8):
        batch[SHIFT, q], vector[q] = goal.low - goal.scale, IDLE
    return solving, beyond


@inner
def use_candidates(
    record: Floats,
    batch: Floats,
    vector: Ints,
    used: int,
    missing: int,
    bottom: float,
    top: float,
    largest: bool,
) -> tuple[int, int]:
    """Use candidates inside an interval, each with a shift at its Ritz value while there is one.

    Args:
        record: what is known of each vector.
        batch: the shifts are written here,
        vector: and their vectors here.
        used: shifts in use.
        missing: candidates wanted.
        bottom: lower end of the interval.
        top: upper end of the interval.
        largest: whether those with the largest Ritz values come first, else the most accurate.

    Returns:
        How many are still missing, and the shifts in use now.
    """
    unmet = missing
    for _ in range(missing):
        best = -1
        for b in range(record.shape[1]):
            inside = bottom < record[RITZ, b] < top
            if inside and record[STATUS, b] == CANDIDATE and record[USED, b] == 0:
                rank = RITZ if largest else RESIDUAL
                sign = 1.0 if largest else -1.0
                if best < 0 or sign * record[rank, b] > sign * record[rank, best]:
                    best = b
        if best < 0:
            break
        record[USED, best] = 1
        unmet -= 1
        if used < 8:
            batch[SHIFT, used], vector[used] = record[RITZ, best], best
            used += 1
    return unmet, used


@inner
def count_below(
    batch: Floats, vector: Ints, used: int, last: float, doubt: float, delta: float, goal: Goal
) -> int:
    """Use spare shifts to count just below the k-th value, and just above it; return those in use.

    Args:
        batch: the shifts are written here,
        vector: and that they have no vector here.
        used: how many are in use.
        last: the k-th value.
        doubt: how far it may be from the eigenvalue.
        delta: values this close count as equal.
        goal: what is searched for.
    """
    unit = min(goal.scale, 100.0 * abs(last)) if goal.deflate else goal.scale
    margin = max(doubt, 1e-4 * unit)
    while used < 8 and margin >= doubt and margin >= 1e-9 * unit:
        batch[SHIFT, used], vector[used] = last - margin, COUNT
        used += 1
        margin *= 0.03
    if doubt < 0.5 * delta and used < 8:
        batch[SHIFT, used], vector[used] = last + 0.5 * delta, COUNT
        used += 1
    return used


@inner
def spread_shifts(
    record: Floats, batch: Floats, vector: Ints, used: int, n: int, bottom: float, top: float
) -> int:
    """Spread shifts over an interval, geometrically where it ends at 0; return those in use.

    Each gets the best candidate that came from the interval before, or a new vector.

    Args:
        record: what is known of each vector.
        batch: the shifts are written here,
        vector: and their vectors here.
        used: how many shifts are in use.
        n: shifts wanted.
        bottom: lower end of the interval.
        top: upper end of the interval.
    """
    for r in range(n):
        shift = bottom + (top - bottom) * (n - r) / (n + 1.0)
        if top == 0.0:
            shift = bottom * math.exp(-1.0 - r)
        best = take_vector(record, bottom, top)
        if best < 0:
            break
        record[RITZ, best], record[RESIDUAL, best], record[USED, best] = shift, math.inf, 1.0
        batch[SHIFT, used], vector[used] = shift, best
        used += 1
    return used


@inner
def take_vector(record: Floats, bottom: float, top: float) -> int:
    """Return the best vector that came from an interval, else a free place, or -1 if none."""
    best = free = -1
    for b in range(record.shape[1] - 1, -1, -1):
        if record[STATUS, b] == FREE:
            free = b
        elif record[STATUS, b] == CANDIDATE and record[USED, b] == 0 and record[AGE, b] < MAX_AGE:
            inside = bottom < record[ORIGIN, b] < top
            if inside and (best < 0 or record[RESIDUAL, b] < record[RESIDUAL, best]):
                best = b
    if best >= 0:
        record[AGE, best] += 1
    elif free >= 0:
        best = free
        record[STATUS, best], record[AGE, best] = NEW, 0
    return best
