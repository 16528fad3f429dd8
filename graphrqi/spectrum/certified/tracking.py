"""Kernel of the certified tracker: Rayleigh-quotient iterations that share their factorisations.

All vectors are in elimination order, and M is L at the largest end and -L at the smallest, so that
the wanted eigenvalues are always the largest of M. See `graphrqi.spectrum.certified.solver`.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph
from graphrqi.graph.ordering import order_rows
from graphrqi.spectrum.certified.factorization import (
    ABOVE,
    GROWTH,
    SHIFT,
    factor_and_solve,
    factor_pattern,
)
from graphrqi.spectrum.certified.simd import aligned, less, load, more, plus, spread, store
from sim.compiled import compiled, inner

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]
Bools: TypeAlias = NDArray[np.bool_]

ROUNDING = 2.220446049250313e-16
INDEPENDENT_SQUARED = 1e-6
"""A column is kept if the thousandth part of it is outside the span of the others (our choice:
orthogonality is then lost by a factor 1000 at most, and won back at the end)."""
MAX_AGE = 2
"""Tries with one vector at an eigenvalue that its Rayleigh quotient does not come near (our
choice)."""
SPARK = 0.05
"""Size of a start's noise outside the rows that changed: an eigenvector of the new matrix has a
part in those rows, unless it was one of the old matrix already (our choice)."""
MAX_WARM = 32
"""Vectors to start from that are used (our choice)."""
NEGLIGIBLE = 1e-9
"""Size of a vector's entries that do not matter for residuals of 1e-8 (our choice)."""
AROUND = 12
"""Edges around a vertex that may have a new vector (our choice; smaller by some 5 an edge)."""
MAX_LIVELY_SWEEPS = 12
"""Factorisations of the part before it is left to the whole (our choice)."""
DEAR = 8.0
"""Multiplications per entry of the factor from which on applying the same factors a third and a
fourth time is cheaper than new ones (measured)."""
MAX_POINTS = 400
CHUNK = 128
"""Rows of eight numbers treated at a time: 8 kB, a quarter of a small first-level cache."""
ZONE = 4.0
"""How far down an interval wanted eigenvalues are looked for: so many times the share they would
fill, were all evenly spread (our choice)."""
SPARE = 24
"""Vectors kept beyond twice the wanted number (our choice: three factorisations' worth)."""

# rows of `number`: Ritz value, residual, shift it came from, what it is, tries, whether in a lane
THETA, RES, HOME, STATUS, AGE, USE = 0, 1, 2, 3, 4, 5
FREE, CANDIDATE, FOUND, NEW = 0.0, 1.0, 2.0, 3.0  # values of STATUS
COUNT, IDLE = -1, -2  # values of `lane` that are no vector
VALUE, RESIDUAL = 3, 4  # further rows of `lanes`


@inner
def jacobi(h: Floats, w: Floats) -> None:
    """Diagonalise a symmetric (8, 8) matrix by cyclic Jacobi rotations.

    Args:
        h: overwritten by its diagonal form.
        w: (8, 8), whose rows are turned along.
    """
    nothing = spread(0.0)
    for _ in range(12):
        off = total = 0.0
        for a in range(8):
            total += h[a, a] * h[a, a]
            for b in range(a):
                off += h[a, b] * h[a, b]
        if off <= 1e-26 * total:
            break
        for a in range(7):
            for b in range(a + 1, 8):
                if h[a, b] * h[a, b] <= 1e-30 * total:
                    continue
                tau = (h[b, b] - h[a, a]) / (2.0 * h[a, b])
                r = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
                if tau < 0.0:
                    r = -r
                c = 1.0 / math.sqrt(1.0 + r * r)
                s = r * c
                for i in range(8):
                    u, v = h[i, a], h[i, b]
                    h[i, a], h[i, b] = c * u - s * v, s * u + c * v
                y, z = load(h, a), load(h, b)
                store(h, a, plus(plus(nothing, c, y), -s, z))
                store(h, b, plus(plus(nothing, s, y), c, z))
                y, z = load(w, a), load(w, b)
                store(w, a, plus(plus(nothing, c, y), -s, z))
                store(w, b, plus(plus(nothing, s, y), c, z))


@inner
def rayleigh_ritz(
    starts: Ints,
    rows: Ints,
    entries: Floats,
    diagonal: Floats,
    pool: Floats,
    number: Floats,
    x: Floats,
    ax: Floats,
    lanes: Floats,
    source: Ints,
) -> None:
    """Ritz pairs of M in the span of eight columns, outside the span of given vectors.

    Args:
        starts: (d + 1,) column starts of M's strict lower triangle.
        rows: its rows.
        entries: its values.
        diagonal: (d,) of M.
        pool: (n, d) vectors; those found are orthonormal.
        number: which are found, to stay orthogonal to.
        x: (d, 8) columns, some perhaps 0; overwritten by the Ritz vectors.
        ax: (d, 8) room.
        lanes: VALUE is overwritten by the Ritz values theta, RESIDUAL by the norms of
            M x - theta x.
        source: (8,) overwritten by the column that has the largest part in each Ritz vector; -1
            where the columns had a smaller span and there is none.
    """
    d, slots = diagonal.size, number.shape[1]
    g, h = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    w, t = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    nothing = spread(0.0)
    yy = nothing
    for j in range(d):
        y = load(x, j)
        yy = more(yy, y, y)
    store(t, 0, yy)
    share = np.empty((slots, 8), np.float64)
    for _ in range(2):  # Gram-Schmidt, in chunks that stay in the cache
        for b in range(slots):
            store(share, b, nothing)
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if number[STATUS, b] == FOUND:
                    part = load(share, b)
                    for j in range(start, min(start + CHUNK, d)):
                        part = plus(part, -pool[b, j], load(x, j))
                    store(share, b, part)
        yy = nothing
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if number[STATUS, b] == FOUND:
                    part = load(share, b)
                    for j in range(start, min(start + CHUNK, d)):
                        store(x, j, plus(load(x, j), pool[b, j], part))
            for j in range(start, min(start + CHUNK, d)):
                y = load(x, j)
                yy = more(yy, y, y)
        store(t, 1, yy)
        again = False
        for q in range(8):
            again = again or t[1, q] < 0.25 * t[0, q]
        if not again:
            break
    for j in range(d):
        store(ax, j, plus(nothing, diagonal[j], load(x, j)))
    for j in range(d):
        y, sum_j = load(x, j), load(ax, j)
        for p in range(starts[j], starts[j + 1]):
            v, i = entries[p], rows[p]
            sum_j = plus(sum_j, v, load(x, i))
            store(ax, i, plus(load(ax, i), v, y))
        store(ax, j, sum_j)
    for a in range(8):
        store(g, a, nothing)
        store(h, a, nothing)
        store(w, a, nothing)
        w[a, a] = 1.0
    for start in range(0, d, CHUNK):
        for a in range(8):
            ga, ha = load(g, a), load(h, a)
            for j in range(start, min(start + CHUNK, d)):
                v = x[j, a]
                ga = plus(ga, v, load(x, j))
                ha = plus(ha, v, load(ax, j))
            store(g, a, ga)
            store(h, a, ha)
    # Elimination turns the identity into rows w with w g w^T = I, and h into w h; a column with
    # too little outside the span of the others gets a row of zeros.
    for a in range(8):
        s = g[a, a]
        kept = 0.0 < t[0, a] < math.inf and t[1, a] >= INDEPENDENT_SQUARED * t[0, a]
        r = 0.0
        if kept and s > INDEPENDENT_SQUARED * t[1, a]:
            r = 1.0 / math.sqrt(s)
        source[a] = 0 if r > 0.0 else -1
        row_g, row_h = plus(nothing, r, load(g, a)), plus(nothing, r, load(h, a))
        row_w = plus(nothing, r, load(w, a))
        store(h, a, row_h)
        store(w, a, row_w)
        for b in range(a + 1, 8):
            v = -r * g[a, b]
            store(g, b, plus(load(g, b), v, row_g))
            store(h, b, plus(load(h, b), v, row_h))
            store(w, b, plus(load(w, b), v, row_w))
    for a in range(8):
        for b in range(8):
            s = 0.0
            for i in range(8):
                s += h[a, i] * w[b, i]
            g[a, b] = s
    jacobi(g, w)
    for c in range(8):
        lanes[VALUE, c] = g[c, c]
        for b in range(8):
            t[b, c] = w[c, b]
            if source[c] >= 0 and abs(w[c, b]) > abs(w[c, source[c]]):
                source[c] = b
    value = load(lanes, VALUE)
    yy = nothing
    for j in range(d):
        y = z = nothing
        for a in range(8):
            turned = load(t, a)
            y = plus(y, x[j, a], turned)
            z = plus(z, ax[j, a], turned)
        store(x, j, y)
        z = less(z, value, y)
        yy = more(yy, z, z)
    store(lanes, RESIDUAL, yy)
    for c in range(8):
        lanes[RESIDUAL, c] = math.sqrt(lanes[RESIDUAL, c])


@inner
def random_start(
    v: Floats, order: Ints, changed: Bools, narrow: bool, seed: np.uint64
) -> np.uint64:
    """Fill a vector with uniform noise, mostly where the matrix changed.

    Args:
        v: (d,) overwritten.
        order: (d,) row at each place.
        changed: rows where the matrix changed.
        narrow: whether to look at them.
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
            v[j] *= SPARK
    return seed


@inner
def find_clear(
    number: Floats,
    points: Floats,
    above: Ints,
    n: int,
    k: int,
    delta: float,
    clear: Ints,
) -> tuple[int, bool]:
    """Find the counts that no rounding error can have spoilt; one may be the certificate.

    Args:
        number: Ritz values, residuals, and which vectors are found.
        points: (2, m) shifts, descending, and their uncertainties.
        above: (m,) eigenvalues above each.
        n: how many points.
        k: wanted pairs.
        delta: values this close to the k-th count as equal to it.
        clear: (m,) overwritten by the clear points.

    Returns:
        How many are clear, and whether k pairs are certified.
    """
    slots = number.shape[1]
    kth = kth_largest(number, k)
    n_clear = 0
    certified = False
    for i in range(n):
        s, error = points[0, i], points[1, i]
        near = False
        found = 0
        for b in range(slots):
            if number[STATUS, b] == FOUND:
                near = near or abs(number[THETA, b] - s) <= error + number[RES, b]
                found += number[THETA, b] > s
        if not near or i == 0 or i == n - 1:
            clear[n_clear] = i
            n_clear += 1
        if not near and found == above[i] and s + error <= kth + delta:
            certified = True
    return n_clear, certified


@inner
def kth_largest(number: Floats, k: int) -> float:
    """Return the k-th largest Ritz value of those found and in use, or -inf if there are fewer.

    Args:
        number: Ritz values, and which are found, or in use as candidates.
        k: which.
    """
    slots = number.shape[1]
    bound = math.inf
    left = k
    while left > 0:
        best = -math.inf
        for b in range(slots):
            if number[STATUS, b] == FOUND or number[USE, b] > 0:
                v = number[THETA, b]
                if best < v < bound:
                    best = v
        if best == -math.inf:
            return best
        for b in range(slots):
            if number[STATUS, b] == FOUND or number[USE, b] > 0:
                left -= number[THETA, b] == best
        bound = best
    return bound


@inner
def choose_lanes(
    number: Floats,
    points: Floats,
    above: Ints,
    clear: Ints,
    n_clear: int,
    wanted: int,
    deflate: bool,
    scale: float,
    delta: float,
    first: bool,
    low: float,
    lanes: Floats,
    lane: Ints,
) -> tuple[int, int]:
    """Decide where to factorise next.

    Args:
        number: what is known of each vector; a new one to be filled with noise is marked NEW.
        points: (2, m) shifts that were counted, descending.
        above: (m,) their counts.
        clear: the reliable ones among them.
        n_clear: how many those are.
        wanted: eigenvalues to find.
        deflate: whether M is -L outside its null space.
        scale: lower bound on the norm of M.
        delta: values this close count as equal.
        first: whether this is the first factorisation after a change.
        low: below all eigenvalues.
        lanes: the row SHIFT is overwritten.
        lane: (8,) overwritten by the vector of each lane, COUNT or IDLE.

    Returns:
        Lanes that have a vector, and the count at the first clear point that is not below
        ``wanted``.
    """
    slots = number.shape[1]
    used = int(np.int64(0))  # for a literal callees would be compiled once more
    beyond = wanted
    open_top = open_bottom = middle = deep_top = deep_bottom = 0.0
    for i in range(n_clear - 1):
        top, bottom = points[0, clear[i]], points[0, clear[i + 1]]
        n, n_below = above[clear[i]], above[clear[i + 1]]
        if n >= wanted:
            break
        if n_below >= wanted:
            beyond, deep_top, deep_bottom = n_below, top, bottom
        missing = (wanted if n_below > wanted else n_below) - n
        for b in range(slots):
            if number[STATUS, b] == FOUND:
                missing -= bottom < number[THETA, b] < top
        if missing > 0 and n_below > wanted and points[0, clear[i + 1]] > low:
            missing += 1  # one that is not wanted may be among the candidates here
        half = 0.5 * (top + bottom)
        # Of n_below - n eigenvalues in between, those wanted are at the top.
        if not deflate and clear[i] > 0 and points[0, clear[i + 1]] > low:
            part = min(1.0, ZONE * missing / max(n_below - n, 1))
            bottom = top - part * (top - bottom)
        unmet = missing
        for _ in range(missing):  # candidates inside
            best = -1
            for b in range(slots):
                inside = bottom < number[THETA, b] < top
                if inside and number[STATUS, b] == CANDIDATE and number[USE, b] == 0:
                    rank = THETA if n_below > wanted else RES
                    sign = 1.0 if n_below > wanted else -1.0
                    if best < 0 or sign * number[rank, b] > sign * number[rank, best]:
                        best = b
            if best < 0:
                break
            number[USE, best] = 1
            unmet -= 1
            if used < 8:
                lanes[SHIFT, used], lane[used] = number[THETA, best], best
                used += 1
        if unmet > 0 and open_bottom == open_top:
            open_top, open_bottom, middle = top, bottom, half
        used = aim(number, lanes, lane, used, min(unmet, 8 - used), bottom, top)
    solving = used

    # Spare lanes: new starts after a change, counts below the k-th value, division.
    last = kth_largest(number, wanted)
    if last > -math.inf:
        doubt = 0.0
        for b in range(slots):
            if number[USE, b] > 0 and number[THETA, b] == last and number[RES, b] < math.inf:
                doubt = min(1.5 * number[RES, b], 50.0 * number[RES, b] ** 2 / scale)
        if first and solving > 0:
            highest = last
            for b in range(slots):
                if number[STATUS, b] == FOUND or number[USE, b] > 0:
                    highest = max(highest, number[THETA, b])
            free = 8 - used if doubt > 0.0 else 7 - used  # a count below the k-th is worth one
            used = solving = aim(number, lanes, lane, used, free, last, highest)
        elif open_top > open_bottom:  # what is missing is sooner found from several places
            free = 8 - used if deflate else 7 - used
            used = solving = aim(number, lanes, lane, used, free, open_bottom, open_top)
            if not deflate and used < 8:  # should it be far down: halve the interval at least
                lanes[SHIFT, used], lane[used] = middle, COUNT
                used += 1
        unit = min(scale, 100.0 * abs(last)) if deflate else scale
        margin = max(doubt, 1e-4 * unit)
        while used < 8 and margin >= doubt and margin >= 1e-9 * unit:
            lanes[SHIFT, used], lane[used] = last - margin, COUNT
            used += 1
            margin *= 0.03
        if doubt < 0.5 * delta and used < 8:
            lanes[SHIFT, used], lane[used] = last + 0.5 * delta, COUNT
            used += 1
    if beyond > wanted:
        for r in range(8 - used):
            lanes[SHIFT, used], lane[used] = deep_bottom * math.exp(-1.0 - r), COUNT
            if deep_top != 0.0:
                lanes[SHIFT, used] = deep_top - (deep_top - deep_bottom) * (r + 1.0) / 8.0
            used += 1
    for q in range(used, 8):
        lanes[SHIFT, q], lane[q] = low - scale, IDLE
    return solving, beyond


@inner
def aim(
    number: Floats,
    lanes: Floats,
    lane: Ints,
    used: int,
    n: int,
    bottom: float,
    top: float,
) -> int:
    """Spread shifts over an interval, geometrically where it ends at 0.

    Each gets the best candidate that was aimed at the interval before, or a new vector.

    Args:
        number: what is known of each vector.
        lanes: shifts.
        lane: the vector of each.
        used: how many lanes are in use.
        n: shifts wanted.
        bottom: the interval from here
        top: to here.

    Returns:
        How many lanes are in use now.
    """
    for r in range(n):
        shift = bottom + (top - bottom) * (n - r) / (n + 1.0)
        if top == 0.0:
            shift = bottom * math.exp(-1.0 - r)
        best = new_vector(number, bottom, top)
        if best < 0:
            break
        number[THETA, best], number[RES, best], number[USE, best] = shift, math.inf, 1.0
        lanes[SHIFT, used], lane[used] = shift, best
        used += 1
    return used


@inner
def new_vector(number: Floats, bottom: float, top: float) -> int:
    """Return the best vector that was aimed at an interval, else a free place, or -1 if none."""
    best = free = -1
    for b in range(number.shape[1] - 1, -1, -1):
        if number[STATUS, b] == FREE:
            free = b
        elif number[STATUS, b] == CANDIDATE and number[USE, b] == 0 and number[AGE, b] < MAX_AGE:
            aimed = bottom < number[HOME, b] < top
            if aimed and (best < 0 or number[RES, b] < number[RES, best]):
                best = b
    if best >= 0:
        number[AGE, best] += 1
    elif free >= 0:
        best = free
        number[STATUS, best], number[AGE, best] = NEW, 0
    return best


@inner
def add_points(
    lanes: Floats,
    lane: Ints,
    ignored: int,
    scale: float,
    points: Floats,
    above: Ints,
    n: int,
) -> int:
    """Enter the counts of a factorisation among the others.

    Args:
        lanes: shifts, counts and largest pivots, as of `factor_and_solve`.
        lane: (8,) which lanes were used.
        ignored: zero eigenvalues, which do not count.
        scale: lower bound on the norm of M.
        points: (2, m) shifts, descending, and uncertainties.
        above: (m,) counts.
        n: how many there are.

    Returns:
        How many there are now. A count that contradicts its neighbours is left out.
    """
    for q in range(8):
        s = lanes[SHIFT, q]
        count = int(lanes[ABOVE, q]) - ignored
        uncertain = 4.0 * ROUNDING * lanes[GROWTH, q]
        if lane[q] == IDLE or n == MAX_POINTS or uncertain > 1e-4 * scale:
            continue
        if not points[0, n - 1] < s < points[0, 0]:
            continue
        i = n
        while points[0, i - 1] < s:
            i -= 1
        if points[0, i - 1] == s or above[i - 1] > count or above[i] < count:
            continue
        for b in range(n, i, -1):
            points[0, b], points[1, b], above[b] = points[0, b - 1], points[1, b - 1], above[b - 1]
        points[0, i], points[1, i], above[i] = s, uncertain, count
        n += 1
    return n


@inner
def take_out_means(x: Floats, part: Ints, size: Floats, mean: Floats, before: Floats) -> None:
    """Make every column of an (d, 8) block orthogonal to the indicators of the components.

    Args:
        x: (d, 8); a column of which nothing is left becomes 0.
        part: (d,) component of each place.
        size: (c,) their sizes.
        mean: (c, 8) room.
        before: (2, 8) room.
    """
    total = rest = spread(0.0)
    for c in range(size.size):
        store(mean, c, total)
    for j in range(part.size):
        y = load(x, j)
        total = more(total, y, y)
        store(mean, part[j], plus(load(mean, part[j]), 1.0, y))
    for j in range(part.size):
        y = plus(load(x, j), -1.0 / size[part[j]], load(mean, part[j]))
        rest = more(rest, y, y)
        store(x, j, y)
    store(before, 0, total)
    store(before, 1, rest)
    for q in range(8):
        if before[1, q] < 1e-12 * before[0, q]:
            for j in range(part.size):
                x[j, q] = 0.0


@compiled
def track(
    order: Ints,
    starts: Ints,
    rows: Ints,
    row_starts: Ints,
    columns: Ints,
    spots: Ints,
    entries: Floats,
    diagonal: Floats,
    label: Ints,
    components: int,
    work: float,
    deflate: bool,
    warm: Floats,
    changed: Bools,
    k: int,
    scale: float,
    tol: float,
    low: float,
    high: float,
    max_sweeps: int,
    extra: int,
    room: Floats,
) -> tuple[bool, Floats, Floats, float]:
    """Find and certify the k largest eigenpairs of M.

    Args:
        order: (d,) row at each place of the elimination order, perhaps not of all n rows.
        starts: (d + 1,) column starts of the factor.
        rows: its rows.
        row_starts: (d + 1,) row starts of the factor.
        columns: its columns, by row.
        spots: where those are by column.
        entries: M in the factor's pattern.
        diagonal: (d,) of M.
        label: (d,) component of each place.
        components: how many.
        work: multiplications a factorisation takes.
        deflate: keep out of the null space, the indicators of the components; M is then -L, and k
            counts pairs outside it.
        warm: (n, m) vectors to start from, by row; m may be 0.
        changed: (n,) rows in which M differs from the matrix ``warm`` is from.
        k: wanted pairs, at least 1.
        scale: lower bound on the norm of M, at least 1.
        tol: residuals up to tol * scale count as converged.
        low: below all eigenvalues.
        high: above all eigenvalues that count; 0 with ``deflate``.
        max_sweeps: factorisations to give up after.
        extra: pairs found beyond the k-th that are answered too where they equal it.
        room: (r, 8) memory for the factor, r > number of its entries; overwritten.

    Returns:
        Whether none of the k was missed; (2, m) eigenvalues of M, descending, and residuals; (n, m)
        vectors by row; m >= k if certified; and how far their inner products are from those of
        orthonormal vectors at most.
    """
    d = order.size
    ignored = components if deflate else 0
    slots = 2 * k + SPARE
    pool = np.empty((slots, d), np.float64)
    number = np.empty((6, slots), np.float64)
    for b in range(slots):
        number[STATUS, b] = FREE
        number[USE, b] = 0
    points = np.empty((2, MAX_POINTS), np.float64)
    above, clear = np.empty(MAX_POINTS, np.int32), np.empty(MAX_POINTS, np.int32)
    points[0, 0], points[1, 0], above[0] = high, 0.0, 0
    points[0, 1], points[1, 1], above[1] = low, 0.0, d - ignored
    n_points = int(np.int64(2))  # a literal would be compiled for once more
    # in cache lines of their own, a quarter quicker; there is a row too many
    factor = aligned(room)
    pivots = aligned(np.empty((d + 1, 8), np.float64))
    x, ax = aligned(np.empty((d + 1, 8), np.float64)), aligned(np.empty((d + 1, 8), np.float64))
    lanes = np.empty((5, 8), np.float64)
    lane, source, ages = np.empty(8, np.int32), np.empty(8, np.int32), np.empty(8, np.int32)
    size, mean = np.empty(components, np.float64), np.empty((components, 8), np.float64)
    for c in range(components):
        size[c] = 0.0
    for j in range(d):
        size[label[j]] += 1.0
    narrow = warm.shape[1] > 0
    first = narrow
    seed = np.uint64(88172645463325252)
    goal0, delta0, floor = 0.9 * tol * scale, tol * scale, 1e-13 * scale
    sweeps = 0
    before, again = np.empty(8, np.float64), np.empty(8, np.int32)
    factorise = sweeps == 0  # no literal: see above
    most_reuses = 2 if work > DEAR * rows.size else 1
    reuses = most_reuses
    certified = stuck = False
    wanted = k  # raised where eigenvalues equal to the k-th have to be found too
    warm_done = 0
    warm_columns = min(warm.shape[1], MAX_WARM)
    while True:
        warming = warm_done < warm_columns
        if warming:  # first, Rayleigh-Ritz in the span of the given vectors
            for q in range(8):
                lanes[SHIFT, q], before[q], ages[q] = math.inf, math.inf, 0
            for j in range(d):
                for q in range(8):
                    c = warm_done + q
                    x[j, q] = warm[order[j], c] if c < warm_columns else 0.0
            warm_done += 8
        else:
            for b in range(slots):
                number[USE, b] = 0
            delta = delta0
            if deflate:
                kth = kth_largest(number, k)
                delta = min(delta0, max(1e-2 * abs(kth), floor))
            n_clear, certified = find_clear(number, points, above, n_points, k, delta, clear)
            if certified or sweeps >= max_sweeps:
                break
            if factorise:
                solving, beyond = choose_lanes(
                    number, points, above, clear, n_clear, wanted,
                    deflate, scale, delta, first, low, lanes, lane,
                )  # fmt: skip
            else:
                for b in range(slots):
                    number[USE, b] = number[STATUS, b] == CANDIDATE
            if solving == 0 and stuck:  # equal eigenvalues follow the k-th: find them all
                if beyond == wanted or beyond > slots - 12:
                    break
                wanted = beyond
                stuck = False
                continue
            stuck = solving == 0
            first = False
            if solving > 0:
                for q in range(8):
                    if lane[q] >= 0 and number[STATUS, lane[q]] == NEW:
                        seed = random_start(pool[lane[q]], order, changed, narrow, seed)
                    before[q] = number[RES, lane[q]] if lane[q] >= 0 else math.inf
                for start in range(0, d, CHUNK):
                    for q in range(8):
                        for j in range(start, min(start + CHUNK, d)):
                            x[j, q] = pool[lane[q], j] if lane[q] >= 0 else 0.0
            factor_and_solve(
                starts, rows, row_starts, columns, spots, entries, diagonal, lanes,
                1e-15 * scale, factorise, 2 * (solving > 0), factor, pivots, ax, x,
            )  # fmt: skip
            if factorise:
                sweeps += 1
                n_points = add_points(lanes, lane, ignored, scale, points, above, n_points)
            if solving == 0:
                continue
            for q in range(8):  # the Ritz pairs will take the place of the vectors in the lanes
                ages[q] = 0
                if lane[q] >= 0:
                    ages[q] = number[AGE, lane[q]]
                    number[USE, lane[q]] = 0
            for b in range(slots):
                if number[STATUS, b] != FOUND and number[USE, b] == 0:
                    number[STATUS, b] = FREE
        if deflate:
            take_out_means(x, label, size, mean, ax)
        rayleigh_ritz(starts, rows, entries, diagonal, pool, number, x, ax, lanes, source)
        for c in range(8):
            lane[c] = IDLE  # from here on, the place of each Ritz vector
            again[c] = IDLE
        in_sight = 0  # pairs found, and those that these factors will do for
        for c in range(8):
            value, residual = lanes[VALUE, c], lanes[RESIDUAL, c]
            if source[c] < 0 or (deflate and value > -0.1 * floor):
                continue
            b = new_vector(number, high, high)
            if b < 0:
                break
            goal = min(goal0, max(1e-3 * abs(value), floor)) if deflate else goal0
            number[STATUS, b] = FOUND if residual <= goal else CANDIDATE
            number[AGE, b], number[USE, b] = ages[source[c]], 0
            number[THETA, b], number[RES, b] = value, residual
            number[HOME, b] = lanes[SHIFT, source[c]]
            lane[c] = b
            earlier = before[source[c]]
            if again[source[c]] == IDLE and residual > goal:
                step = residual / earlier  # what these factors did, and would do again
                if residual * (step if reuses == 1 else step * step) < goal:
                    again[source[c]] = b
                    in_sight += earlier < math.inf
        for start in range(0, d, CHUNK):
            for c in range(8):
                if lane[c] >= 0:
                    for j in range(start, min(start + CHUNK, d)):
                        pool[lane[c], j] = x[j, c]
        sought = in_sight
        for b in range(slots):
            in_sight += number[STATUS, b] == FOUND
        if warming or sought == 0 or in_sight < wanted or reuses == 0:
            factorise, reuses = True, most_reuses
        else:
            factorise = False
            reuses -= 1
            for q in range(8):
                lane[q] = again[q]

    # Answer with the largest.
    found = 0
    for b in range(slots):
        found += number[STATUS, b] == FOUND
    found = min(found, k + extra)
    pairs, chosen = np.empty((2, found), np.float64), np.empty(found, np.int32)
    kept = 0
    for c in range(found):
        best = -1
        for b in range(slots):
            if number[STATUS, b] == FOUND and (best < 0 or number[THETA, b] > number[THETA, best]):
                best = b
        number[STATUS, best] = FREE
        pairs[0, c], pairs[1, c], chosen[c] = number[THETA, best], number[RES, best], best
        if c < k or pairs[0, c] >= pairs[0, k - 1] - 1e-6 * scale:
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
            store(lanes, VALUE, gram)
            for q in range(8):
                departure = max(departure, abs(lanes[VALUE, q] - (start + q == c)))
    answer = np.empty((changed.size, kept), np.float64)
    for i in range(changed.size if d < changed.size else 0):
        for c in range(kept):
            answer[i, c] = 0.0
    for j in range(d):
        for c in range(kept):
            answer[order[j], c] = pool[chosen[c], j]
    return certified, pairs, answer, departure


@compiled
def lively_rows(
    order: Ints,
    diagonal: Floats,
    indptr: Ints,
    indices: Ints,
    values: Floats,
    vectors: Floats,
    k: int,
    changed: Bools,
    most: int,
) -> Bools:
    """Rows in which eigenvectors of the largest eigenvalues are not negligible, probably.

    Those of vertices of high degree are localised there. These are the rows that matter in the
    earlier vectors, and those around changed rows that may have one now: the largest eigenvalue
    of a vertex i and its neighbours is about degree_i + sum_j 1 / (lambda - degree_j), which is
    compared with that of the vertices that have one.

    Args:
        order: (d,) row at each place of the elimination order.
        diagonal: (d,) of the Laplacian, by place.
        indptr: (d + 1,) the Laplacian in CSR: row starts,
        indices: columns,
        values: and values.
        vectors: (d, m) earlier eigenvectors.
        k: how many of them matter.
        changed: (d,) rows that are not as they were.
        most: stop when there are more rows.

    Returns:
        (d,) whether a row is one of them.
    """
    d = changed.size
    degree, steps = np.empty(d, np.float64), np.empty(d, np.int32)
    queue, peak = np.empty(d + 1, np.int32), np.empty(k, np.int32)
    height, lively = np.empty(k, np.float64), np.empty(d, np.bool_)
    for c in range(k):
        peak[c], height[c] = 0, 0.0
    n = 0
    for j in range(d):
        degree[order[j]] = diagonal[j]
    for i in range(d):
        largest = 0.0
        for c in range(k):
            size = abs(vectors[i, c])
            largest = max(largest, size)
            if size > height[c]:
                peak[c], height[c] = i, size
        lively[i] = largest > NEGLIGIBLE
        steps[i] = 1
        queue[n] = i
        n += lively[i]
    level = least = math.inf
    for c in range(k):
        level = min(level, degree[peak[c]] + 1.0)
    for t in range(k + d):
        i = peak[t] if t < k else t - k
        if t >= k and (not changed[i] or degree[i] + 1.0 < 0.5 * level):
            continue
        value = degree[i]
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] != i:
                value += values[p] * values[p] / max(level - degree[indices[p]], 1.0)
        if t < k:
            least = min(least, value)
        elif value >= least:
            steps[i] = AROUND
            queue[n] = i
            n += not lively[i]
            lively[i] = True
    head = 0
    while head < n and n <= most:
        i = queue[head]
        head += 1
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            if steps[i] > 0 and not lively[j]:
                lively[j] = True
                steps[j] = steps[i] - 1
                queue[n] = j
                n += 1
    return lively


class Analysis(NamedTuple):
    """A matrix prepared for factorisation.

    Attributes:
        order: (d,) row at each place of the elimination order; then as of
            `factor_pattern`.
    """

    order: Ints
    starts: Ints
    rows: Ints
    row_starts: Ints
    columns: Ints
    spots: Ints
    entries: Floats
    diagonal: Floats
    label: Ints
    components: int
    work: float
    scale: float
    product: Floats
    changed: Bools

    @property
    def pattern(
        self,
    ) -> tuple[Ints, Ints, Ints, Ints, Ints, Ints, Floats, Floats, Ints, int, float]:
        """What `track` takes first: all up to ``work``."""
        return self[:11]


def analyse(
    graph: TrafficGraph,
    order: Ints | None = None,
    sign: float = 1.0,
    earlier: Floats | None = None,
) -> Analysis:
    """Prepare a Laplacian, or its negative, for factorisations.

    Args:
        graph: its Laplacian is the matrix.
        order: elimination order, perhaps not of all rows; a new one of all if not given.
        sign: 1, or -1 for its negative.
        earlier: (d,) the product of the matrix before, by row; infinite where there was none.

    Returns:
        Its pattern.
    """
    if order is None:
        order = order_rows(graph.indptr, graph.indices)[0][::-1].copy()
    if earlier is None:
        earlier = np.full(graph.ids.size, np.inf)
    matrix = (graph.ids, graph.indptr, graph.indices, graph.values)
    return Analysis(order, *factor_pattern(*matrix, sign, order, earlier))


def room_for(analysis: Analysis, room: Floats | None) -> Floats:
    """Memory that a factor fits into: the one given, or more.

    A factor's memory asked for anew at every step is given back to the system at every step, and
    touching it the first time costs as much as the factorisation.

    Args:
        analysis: the matrix.
        room: (r, 8) memory of an earlier step, if there is any.

    Returns:
        (m, 8) memory, m > number of the factor's entries.
    """
    entries = analysis.rows.size
    if room is not None and len(room) > entries:
        return room
    return np.empty((entries + entries // 4 + 1, 8))


def track_lively(
    graph: TrafficGraph,
    whole: Analysis,
    warm: Floats,
    k: int,
    tol: float,
    extra: int,
    room: Floats,
) -> Floats:
    """Better vectors to start from: those of the part of the matrix where they are.

    Args:
        graph: d vehicles.
        whole: of its Laplacian.
        warm: (d, m) vectors to start from.
        k: wanted pairs.
        tol: residuals up to tol * scale will count as converged.
        extra: pairs beyond the k-th that are kept.
        room: memory for the factor, as of `room_for` the whole matrix.

    Returns:
        (d, m) the part's eigenvectors, 0 in the other rows; ``warm`` if they were not found.
    """
    order, changed, scale = whole.order, whole.changed, whole.scale
    matrix = (graph.indptr, graph.indices, graph.values)
    lively = lively_rows(order, whole.diagonal, *matrix, warm, k, changed, order.size // 2)
    lively_order = order[lively[order]]
    if not 8 * k <= lively_order.size <= order.size // 2:
        return warm
    part = analyse(graph, lively_order)
    certified, _, vectors, _ = track(
        *part.pattern, False, warm, changed, k, scale, 0.5 * tol, -1.0, 2.0 * scale + 1.0,
        MAX_LIVELY_SWEEPS, extra, room_for(part, room),
    )  # fmt: skip
    return vectors if certified else warm
