"""Kernel of the certified tracker: Rayleigh-quotient iterations that share their factorisations.

All vectors are in elimination order, and M is L at the largest end and -L at the smallest, so that
the wanted eigenvalues are always the largest of M. See `graphrqi.spectrum.certified`.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled
from graphrqi.spectrum.factorization import (
    factor_and_solve,
    factor_pattern,
    order_rows,
)
from graphrqi.spectrum.lanes import less, load, more, plus, spread, store

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int32]
Bools: TypeAlias = NDArray[np.bool_]

ROUNDING = 2.220446049250313e-16
INDEPENDENT = 1e-3
"""A column is kept if this much of it is outside the span of the others (our choice: orthogonality
is then lost by a factor 1000 at most, and won back at the end)."""
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

THETA, RES, HOME = 0, 1, 2  # rows of `number`: Ritz value, residual, shift it came from
STATUS, AGE, USE = 0, 1, 2  # rows of `mark`
FREE, CANDIDATE, FOUND, NEW = 0, 1, 2, 3  # values of STATUS
COUNT, IDLE = -1, -2  # values of `lane` that are no vector


@compiled
def eights(n: int) -> Floats:
    """Return an (n, 8) array, its rows in cache lines of their own (a quarter quicker)."""
    flat = np.empty(8 * n + 8, np.float64)
    skip = (64 - flat.ctypes.data % 64) % 64 // 8
    return flat[skip : skip + 8 * n].reshape(n, 8)


@compiled
def jacobi(h: Floats, t: Floats, m: int) -> None:
    """Diagonalise a small symmetric matrix by cyclic Jacobi rotations.

    Args:
        h: its leading (m, m) part is overwritten by its diagonal form.
        t: its leading (m, m) part is overwritten by the eigenvectors in columns.
        m: size.
    """
    for a in range(m):
        for b in range(m):
            t[a, b] = 1.0 if a == b else 0.0
    for _ in range(12):
        off = total = 0.0
        for a in range(m):
            total += h[a, a] * h[a, a]
            for b in range(a):
                off += h[a, b] * h[a, b]
        if off <= 1e-26 * total:
            break
        for a in range(m - 1):
            for b in range(a + 1, m):
                if h[a, b] * h[a, b] <= 1e-30 * total:
                    continue
                tau = (h[b, b] - h[a, a]) / (2.0 * h[a, b])
                r = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
                if tau < 0.0:
                    r = -r
                c = 1.0 / math.sqrt(1.0 + r * r)
                s = r * c
                for i in range(m):
                    u, v = h[i, a], h[i, b]
                    h[i, a], h[i, b] = c * u - s * v, s * u + c * v
                for i in range(m):
                    u, v = h[a, i], h[b, i]
                    h[a, i], h[b, i] = c * u - s * v, s * u + c * v
                    u, v = t[i, a], t[i, b]
                    t[i, a], t[i, b] = c * u - s * v, s * u + c * v


@compiled
def rayleigh_ritz(
    starts: Ints,
    rows: Ints,
    entries: Floats,
    diagonal: Floats,
    pool: Floats,
    mark: Ints,
    x: Floats,
    ax: Floats,
    ritz: Floats,
    source: Ints,
) -> int:
    """Ritz pairs of M in the span of eight columns, outside the span of given vectors.

    Args:
        starts: (d + 1,) column starts of M's strict lower triangle.
        rows: its rows.
        entries: its values.
        diagonal: (d,) of M.
        pool: (n, d) vectors; those found are orthonormal.
        mark: (3, n) which are found, to stay orthogonal to.
        x: (d, 8) columns, some perhaps 0; overwritten by the Ritz vectors.
        ax: (d, 8) room.
        ritz: (2, 8) overwritten by the Ritz values theta and the norms of M x - theta x.
        source: (8,) overwritten by the column that has the largest part in each Ritz vector.

    Returns:
        How many Ritz pairs there are.
    """
    d = diagonal.size
    g, h = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    w, t = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    nothing = spread(0.0)
    yy = nothing
    for j in range(d):
        y = load(x, j)
        yy = more(yy, y, y)
    store(t, 0, yy)
    slots = mark.shape[1]
    share = np.empty((slots, 8), np.float64)
    for _ in range(2):  # Gram-Schmidt, in chunks that stay in the cache
        for b in range(slots):
            store(share, b, nothing)
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if mark[STATUS, b] == FOUND:
                    part = load(share, b)
                    for j in range(start, min(start + CHUNK, d)):
                        part = plus(part, -pool[b, j], load(x, j))
                    store(share, b, part)
        yy = nothing
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if mark[STATUS, b] == FOUND:
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
            v = entries[p]
            if v != 0.0:
                i = rows[p]
                sum_j = plus(sum_j, v, load(x, i))
                store(ax, i, plus(load(ax, i), v, y))
        store(ax, j, sum_j)
    for a in range(8):
        store(g, a, nothing)
        store(h, a, nothing)
    for start in range(0, d, CHUNK):
        for a in range(8):
            ga, ha = load(g, a), load(h, a)
            for j in range(start, min(start + CHUNK, d)):
                v = x[j, a]
                ga = plus(ga, v, load(x, j))
                ha = plus(ha, v, load(ax, j))
            store(g, a, ga)
            store(h, a, ha)
    # Gram-Schmidt in coefficients: columns w with w^T g w = I, a Cholesky factorisation of g.
    rank = int(np.int64(0))  # a literal would be compiled for once more
    for a in range(8):
        before = t[0, a]
        if not (0.0 < before < math.inf) or g[a, a] < INDEPENDENT**2 * before:
            continue
        for i in range(8):
            w[i, rank] = 0.0
        for c in range(rank):
            s = 0.0
            for i in range(a):
                s += w[i, c] * g[i, a]
            for i in range(a):
                w[i, rank] -= s * w[i, c]
        s = g[a, a]
        for c in range(rank):
            inner = 0.0
            for i in range(a):
                inner += w[i, c] * g[i, a]
            s -= inner * inner
        if s > INDEPENDENT**2 * g[a, a]:
            w[a, rank] = 1.0
            r = 1.0 / math.sqrt(s)
            for i in range(a + 1):
                w[i, rank] *= r
            rank += 1
    for c in range(rank, 8):
        for i in range(8):
            w[i, c] = 0.0
    for i in range(8):
        for c in range(8):
            s = 0.0
            for b in range(8):
                s += h[i, b] * w[b, c]
            t[i, c] = s
    for a in range(8):
        for c in range(8):
            s = 0.0
            for i in range(8):
                s += w[i, a] * t[i, c]
            g[a, c] = s
    jacobi(g, t, rank)
    for i in range(8):
        for c in range(8):
            s = 0.0
            for b in range(rank):
                s += w[i, b] * t[b, c]
            h[i, c] = s if c < rank else 0.0
    for c in range(8):
        ritz[0, c] = g[c, c]
        source[c] = 0
        for b in range(8):
            if abs(h[b, c]) > abs(h[source[c], c]):
                source[c] = b
    value = load(ritz, 0)
    yy = nothing
    for j in range(d):
        y = z = nothing
        for a in range(8):
            turned = load(h, a)
            y = plus(y, x[j, a], turned)
            z = plus(z, ax[j, a], turned)
        store(x, j, y)
        z = less(z, value, y)
        yy = more(yy, z, z)
    store(ritz, 1, yy)
    for c in range(8):
        ritz[1, c] = math.sqrt(ritz[1, c])
    return rank


@compiled
def changed_rows(
    old_row: NDArray[np.int64],
    old_indptr: Ints,
    old_indices: Ints,
    old_values: Floats,
    indptr: Ints,
    indices: Ints,
    values: Floats,
    known: bool,
) -> Bools:
    """Find the rows in which two matrices differ.

    Args:
        old_row: (d,) row in the earlier matrix of every row, or -1; empty if they are the same.
        old_indptr: the earlier matrix in CSR: row starts,
        old_indices: columns,
        old_values: and values.
        indptr: (d + 1,) the matrix in CSR: row starts,
        indices: columns,
        values: and values.
        known: whether there is an earlier matrix at all.

    Returns:
        (d,) whether the row differs.
    """
    d = indptr.size - 1
    same_rows = old_row.size == 0
    differs = np.empty(d, np.bool_)
    for i in range(d):
        differs[i] = known
        if not known:
            continue
        r = i if same_rows else old_row[i]
        if r < 0 or old_indptr[r + 1] - old_indptr[r] != indptr[i + 1] - indptr[i]:
            continue
        same = True
        first, last = old_indptr[r], old_indptr[r + 1]
        for p in range(indptr[i], indptr[i + 1]):
            column = indices[p] if same_rows else old_row[indices[p]]
            q = first + p - indptr[i]
            if old_indices[q] != column:  # another order of the rows: search
                q = first
                while q < last and old_indices[q] != column:
                    q += 1
            if q == last or old_values[q] != values[p]:
                same = False
                break
        differs[i] = not same
    return differs


@compiled
def random_start(v: Floats, is_changed: Bools, narrow: bool, seed: np.uint64) -> np.uint64:
    """Fill a vector with uniform noise, mostly where the matrix changed.

    Args:
        v: (d,) overwritten.
        is_changed: (d,) places where the matrix changed.
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
        if narrow and not is_changed[j]:
            v[j] *= SPARK
    return seed


@compiled
def find_clear(
    number: Floats,
    mark: Ints,
    points: Floats,
    above: Ints,
    n: int,
    k: int,
    delta: float,
    clear: Ints,
) -> tuple[int, bool]:
    """Find the counts that no rounding error can have spoilt; one may be the certificate.

    Args:
        number: Ritz values and residuals.
        mark: which vectors are found.
        points: (2, m) shifts, descending, and their uncertainties.
        above: (m,) eigenvalues above each.
        n: how many points.
        k: wanted pairs.
        delta: values this close to the k-th count as equal to it.
        clear: (m,) overwritten by the clear points.

    Returns:
        How many are clear, and whether k pairs are certified.
    """
    slots = mark.shape[1]
    kth = kth_largest(number, mark, k)
    n_clear = 0
    certified = False
    for i in range(n):
        s, error = points[0, i], points[1, i]
        near = False
        found = 0
        for b in range(slots):
            if mark[STATUS, b] == FOUND:
                near = near or abs(number[THETA, b] - s) <= error + number[RES, b]
                found += number[THETA, b] > s
        if not near or i == 0 or i == n - 1:
            clear[n_clear] = i
            n_clear += 1
        if not near and found == above[i] and s + error <= kth + delta:
            certified = True
    return n_clear, certified


@compiled
def kth_largest(number: Floats, mark: Ints, k: int) -> float:
    """Return the k-th largest Ritz value of those found and in use, or -inf if there are fewer.

    Args:
        number: Ritz values.
        mark: which vectors are found, or in use as candidates.
        k: which.
    """
    slots = mark.shape[1]
    bound = math.inf
    left = k
    while left > 0:
        best = -math.inf
        for b in range(slots):
            if mark[STATUS, b] == FOUND or mark[USE, b] > 0:
                v = number[THETA, b]
                if best < v < bound:
                    best = v
        if best == -math.inf:
            return best
        for b in range(slots):
            if mark[STATUS, b] == FOUND or mark[USE, b] > 0:
                left -= number[THETA, b] == best
        bound = best
    return bound


@compiled
def choose_lanes(
    number: Floats,
    mark: Ints,
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
    shifts: Floats,
    lane: Ints,
) -> tuple[int, int]:
    """Decide where to factorise next.

    Args:
        number: Ritz values, residuals and where they came from.
        mark: what each vector is; a new vector to be filled with noise is marked NEW.
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
        shifts: (1, 8) overwritten.
        lane: (8,) overwritten by the vector of each lane, COUNT or IDLE.

    Returns:
        Lanes that have a vector, and the count at the first clear point that is not below
        ``wanted``.
    """
    slots = mark.shape[1]
    used = 0
    beyond = wanted
    holder = -1
    open_top = open_bottom = middle = 0.0
    for i in range(n_clear - 1):
        top, bottom = points[0, clear[i]], points[0, clear[i + 1]]
        n, n_below = above[clear[i]], above[clear[i + 1]]
        if n >= wanted:
            break
        if n_below >= wanted:
            beyond = n_below
            holder = i
        missing = min(n_below, wanted) - n
        for b in range(slots):
            if mark[STATUS, b] == FOUND:
                missing -= bottom < number[THETA, b] < top
        half = 0.5 * (top + bottom)
        # Of n_below - n eigenvalues in between, those wanted are at the top.
        if not deflate and clear[i] > 0 and points[0, clear[i + 1]] > low:
            part = min(1.0, ZONE * missing / max(n_below - n, 1))
            bottom = top - part * (top - bottom)
        unmet = missing
        for _ in range(missing):  # candidates inside; next vectors that were aimed here
            best = -1
            for b in range(slots):
                if mark[STATUS, b] != CANDIDATE or mark[USE, b] > 0:
                    continue
                if not bottom < number[THETA, b] < top:
                    continue
                better = best < 0
                if not better and n_below > wanted:
                    better = number[THETA, b] > number[THETA, best]
                elif not better:
                    better = number[RES, b] < number[RES, best]
                if better:
                    best = b
            if best < 0:
                break
            mark[USE, best] = 1
            unmet -= 1
            if used < 8:
                shifts[0, used], lane[used] = number[THETA, best], best
                used += 1
        if unmet > 0 and open_bottom == open_top:
            open_top, open_bottom, middle = top, bottom, half
        for r in range(unmet):
            if used == 8:
                break
            if deflate and top == 0.0:
                shift = bottom * math.exp(-1.2 * (r + 1))
            else:
                shift = bottom + (top - bottom) * (unmet - r) / (unmet + 1.0)
            best = -1
            for b in range(slots):
                if mark[STATUS, b] != CANDIDATE or mark[USE, b] > 0 or mark[AGE, b] >= MAX_AGE:
                    continue
                aimed = bottom < number[HOME, b] < top
                if aimed and (best < 0 or number[RES, b] < number[RES, best]):
                    best = b
            if best >= 0:
                mark[AGE, best] += 1
            else:
                best = new_vector(mark)
                if best < 0:
                    break
            number[THETA, best], number[RES, best], mark[USE, best] = shift, math.inf, 1
            shifts[0, used], lane[used] = shift, best
            used += 1
    solving = used

    # Spare lanes: new starts after a change, counts below the k-th value, division.
    last = kth_largest(number, mark, wanted)
    if last > -math.inf:
        doubt = 0.0
        for b in range(slots):
            if mark[USE, b] > 0 and number[THETA, b] == last and number[RES, b] < math.inf:
                doubt = min(1.5 * number[RES, b], 50.0 * number[RES, b] ** 2 / scale)
        if first and solving > 0:
            highest = last
            for b in range(slots):
                if mark[STATUS, b] == FOUND or mark[USE, b] > 0:
                    highest = max(highest, number[THETA, b])
            free = 8 - used if doubt > 0.0 else 7 - used  # a count below the k-th is worth one
            for r in range(free):
                best = new_vector(mark)
                if best >= 0:
                    shift = last + (highest - last) * (r + 0.5) / free
                    number[THETA, best], number[RES, best], mark[USE, best] = shift, math.inf, 1
                    shifts[0, used], lane[used] = shift, best
                    used += 1
            solving = used
        elif open_top > open_bottom:  # what is missing is sooner found from several places
            free = 8 - used if deflate else 7 - used
            for r in range(free):
                best = new_vector(mark)
                if best >= 0:
                    shift = open_bottom + (open_top - open_bottom) * (r + 0.5) / free
                    if deflate and open_top == 0.0:
                        shift = open_bottom * math.exp(-0.6 * (r + 1))
                    number[THETA, best], number[RES, best], mark[USE, best] = shift, math.inf, 1
                    shifts[0, used], lane[used] = shift, best
                    used += 1
            solving = used
            if not deflate and used < 8:  # should it be far down: halve the interval at least
                shifts[0, used], lane[used] = middle, COUNT
                used += 1
        unit = min(scale, 100.0 * abs(last)) if deflate else scale
        margin = max(doubt, 1e-4 * unit)
        while used < 8 and margin >= doubt and margin >= 1e-9 * unit:
            shifts[0, used], lane[used] = last - margin, COUNT
            used += 1
            margin *= 0.03
        if doubt < 0.5 * delta and used < 8:
            shifts[0, used], lane[used] = last + 0.5 * delta, COUNT
            used += 1
    if holder >= 0 and beyond > wanted:
        top, bottom = points[0, clear[holder]], points[0, clear[holder + 1]]
        free = 8 - used
        for r in range(free):
            if deflate and top == 0.0:
                shift = bottom * math.exp(-1.0 * (r + 1))
            else:
                shift = bottom + (top - bottom) * (free - r) / (free + 1.0)
            shifts[0, used], lane[used] = shift, COUNT
            used += 1
    for q in range(used, 8):
        shifts[0, q], lane[q] = low - scale, IDLE
    return solving, beyond


@compiled
def new_vector(mark: Ints) -> int:
    """Return a free place, marked NEW, or -1 if there is none."""
    for b in range(mark.shape[1]):
        if mark[STATUS, b] == FREE:
            mark[STATUS, b] = NEW
            mark[AGE, b] = 0
            return b
    return -1


@compiled
def add_points(
    shifts: Floats,
    lane: Ints,
    counts: Floats,
    growth: Floats,
    ignored: int,
    scale: float,
    points: Floats,
    above: Ints,
    n: int,
) -> int:
    """Enter the counts of a factorisation among the others.

    Args:
        shifts: (1, 8).
        lane: (8,) which lanes were used.
        counts: (1, 8) eigenvalues above each shift.
        growth: (1, 8) largest pivots.
        ignored: zero eigenvalues, which do not count.
        scale: lower bound on the norm of M.
        points: (2, m) shifts, descending, and uncertainties.
        above: (m,) counts.
        n: how many there are.

    Returns:
        How many there are now. A count that contradicts its neighbours is left out.
    """
    for q in range(8):
        s = shifts[0, q]
        count = int(counts[0, q]) - ignored
        uncertain = 4.0 * ROUNDING * growth[0, q]
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


@compiled
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
) -> tuple[bool, Floats, Floats, Floats]:
    """Find and certify the k largest eigenpairs of M.

    Args:
        order: (d,) row at each place of the elimination order.
        starts: (d + 1,) column starts of the factor.
        rows: its rows.
        row_starts: (d + 1,) row starts of the factor.
        columns: its columns, by row.
        spots: where those are by column.
        entries: M in the factor's pattern.
        diagonal: (d,) of M.
        label: (d,) component of each row (not place).
        components: how many.
        work: multiplications a factorisation takes.
        deflate: keep out of the null space, the indicators of the components; M is then -L, and k
            counts pairs outside it.
        warm: (d, m) vectors to start from, by row; m may be 0.
        changed: (d,) rows in which M differs from the matrix ``warm`` is from.
        k: wanted pairs, at least 1.
        scale: lower bound on the norm of M, at least 1.
        tol: residuals up to tol * scale count as converged.
        low: below all eigenvalues.
        high: above all eigenvalues that count; 0 with ``deflate``.
        max_sweeps: factorisations to give up after.
        extra: pairs found beyond the k-th that are answered too where they equal it.

    Returns:
        Whether none of the k was missed, (m,) eigenvalues of M, descending, (m,) residuals and (d,
        m) vectors by row; m >= k if certified.
    """
    d = order.size
    ignored = components if deflate else 0
    slots = 2 * k + SPARE
    pool = np.empty((slots, d), np.float64)
    number, mark = np.empty((3, slots), np.float64), np.empty((3, slots), np.int32)
    for b in range(slots):
        mark[STATUS, b] = FREE
        mark[USE, b] = 0
    points = np.empty((2, MAX_POINTS), np.float64)
    above, clear = np.empty(MAX_POINTS, np.int32), np.empty(MAX_POINTS, np.int32)
    points[0, 0], points[1, 0], above[0] = high, 0.0, 0
    points[0, 1], points[1, 1], above[1] = low, 0.0, d - ignored
    n_points = int(np.int64(2))  # a literal would be compiled for once more
    factor, pivots, x, ax = eights(rows.size), eights(d), eights(d), eights(d)
    shifts, growth = np.empty((1, 8), np.float64), np.empty((1, 8), np.float64)
    counts, ritz = np.empty((1, 8), np.float64), np.empty((2, 8), np.float64)
    lane, source, ages = np.empty(8, np.int32), np.empty(8, np.int32), np.empty(8, np.int32)
    size, mean = np.empty(components, np.float64), np.empty((components, 8), np.float64)
    part, is_changed = np.empty(d, np.int32), np.empty(d, np.bool_)
    for c in range(components):
        size[c] = 0.0
    for j in range(d):
        part[j] = label[order[j]]
        is_changed[j] = changed[order[j]]
        size[part[j]] += 1.0
    narrow = warm.shape[1] > 0
    first = narrow
    seed = np.uint64(88172645463325252)
    goal0, delta0, floor = 0.9 * tol * scale, tol * scale, 1e-13 * scale
    sweeps = 0
    before, again = np.empty(8, np.float64), np.empty(8, np.int32)
    factorise = True
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
                shifts[0, q], before[q], ages[q] = math.inf, math.inf, 0
            for j in range(d):
                for q in range(8):
                    c = warm_done + q
                    x[j, q] = warm[order[j], c] if c < warm_columns else 0.0
            warm_done += 8
        else:
            for b in range(slots):
                mark[USE, b] = 0
            delta = delta0
            if deflate:
                kth = kth_largest(number, mark, k)
                delta = min(delta0, max(1e-2 * abs(kth), floor))
            n_clear, certified = find_clear(number, mark, points, above, n_points, k, delta, clear)
            if certified or sweeps >= max_sweeps:
                break
            if factorise:
                solving, beyond = choose_lanes(
                    number, mark, points, above, clear, n_clear, wanted,
                    deflate, scale, delta, first, low, shifts, lane,
                )  # fmt: skip
            else:
                for b in range(slots):
                    mark[USE, b] = mark[STATUS, b] == CANDIDATE
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
                    if lane[q] >= 0 and mark[STATUS, lane[q]] == NEW:
                        seed = random_start(pool[lane[q]], is_changed, narrow, seed)
                    before[q] = number[RES, lane[q]] if lane[q] >= 0 else math.inf
                for start in range(0, d, CHUNK):
                    for q in range(8):
                        for j in range(start, min(start + CHUNK, d)):
                            x[j, q] = pool[lane[q], j] if lane[q] >= 0 else 0.0
            factor_and_solve(
                starts, rows, row_starts, columns, spots, entries, diagonal, shifts,
                1e-15 * scale, factorise, 2 if solving > 0 else 0, factor, pivots, ax, x, counts,
                growth,
            )  # fmt: skip
            if factorise:
                sweeps += 1
                n_points = add_points(
                    shifts, lane, counts, growth, ignored, scale, points, above, n_points
                )
            if solving == 0:
                continue
            for q in range(8):  # the Ritz pairs will take the place of the vectors in the lanes
                ages[q] = 0
                if lane[q] >= 0:
                    ages[q] = mark[AGE, lane[q]]
                    mark[USE, lane[q]] = 0
            for b in range(slots):
                if mark[STATUS, b] != FOUND and mark[USE, b] == 0:
                    mark[STATUS, b] = FREE
        if deflate:
            take_out_means(x, part, size, mean, ax)
        rank = rayleigh_ritz(starts, rows, entries, diagonal, pool, mark, x, ax, ritz, source)
        for c in range(8):
            lane[c] = IDLE  # from here on, the place of each Ritz vector
            again[c] = IDLE
        in_sight = 0  # pairs found, and those that these factors will do for
        for c in range(rank):
            value, residual = ritz[0, c], ritz[1, c]
            if deflate and value > -0.1 * floor:
                continue
            b = new_vector(mark)
            if b < 0:
                break
            goal = min(goal0, max(1e-3 * abs(value), floor)) if deflate else goal0
            mark[STATUS, b] = FOUND if residual <= goal else CANDIDATE
            mark[AGE, b], mark[USE, b] = ages[source[c]], 0
            number[THETA, b], number[RES, b] = value, residual
            number[HOME, b] = shifts[0, source[c]]
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
            in_sight += mark[STATUS, b] == FOUND
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
        found += mark[STATUS, b] == FOUND
    found = min(found, k + extra)
    values, residuals = np.empty(found, np.float64), np.empty(found, np.float64)
    for c in range(found):
        best = -1
        for b in range(slots):
            if mark[STATUS, b] != FOUND:
                continue
            if best < 0 or number[THETA, b] > number[THETA, best]:
                best = b
        mark[STATUS, best] = FREE
        values[c], residuals[c] = number[THETA, best], number[RES, best]
        clear[c] = best
    kept = min(found, k)
    while kept < found and values[kept] >= values[k - 1] - 1e-6 * scale:
        kept += 1
    answer = np.empty((d, kept), np.float64)
    for j in range(d):
        for c in range(kept):
            answer[order[j], c] = pool[clear[c], j]
    return certified, values[:kept].copy(), residuals[:kept].copy(), answer


@compiled
def lively_part(
    indptr: Ints,
    indices: Ints,
    values: Floats,
    order: Ints,
    vectors: Floats,
    k: int,
    changed: Bools,
    most: int,
) -> tuple[Ints, Ints, Ints, Floats]:
    """Rows in which eigenvectors of the largest eigenvalues are not negligible, probably.

    Those of vertices of high degree are localised there. These are the rows that matter in the
    earlier vectors, and those around changed rows that may have one now: the largest eigenvalue
    of a vertex i and its neighbours is about degree_i + sum_j 1 / (lambda - degree_j), which is
    compared with that of the vertices that have one.

    Args:
        indptr: (d + 1,) the Laplacian in CSR: row starts,
        indices: columns,
        values: and values.
        order: (d,) row at each place of the elimination order.
        vectors: (d, m) earlier eigenvectors.
        k: how many of them matter.
        changed: (d,) rows that are not as they were.
        most: give up if there are more rows.

    Returns:
        (n,) rows in elimination order, none if given up; and the matrix of these rows and columns:
        row starts, columns and values.
    """
    d = indptr.size - 1
    degree, queue = np.empty(d, np.float64), np.empty(d, np.int32)
    steps = np.empty(d, np.int32)
    for i in range(d):
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] == i:
                degree[i] = values[p]
        steps[i] = -1
    n = 0
    for i in range(d):
        largest = 0.0
        for c in range(k):
            largest = max(largest, abs(vectors[i, c]))
        if largest > NEGLIGIBLE:
            steps[i] = 1
            queue[n] = i
            n += 1
    peak = np.empty(k, np.int32)
    for c in range(k):
        peak[c] = 0
        for i in range(d):
            if abs(vectors[i, c]) > abs(vectors[peak[c], c]):
                peak[c] = i
    level, least = math.inf, math.inf
    for c in range(k):
        level = min(level, degree[peak[c]] + 1.0)
    for again in range(2):
        for t in range(k if again == 0 else d):
            i = peak[t] if again == 0 else t
            if again and (not changed[i] or degree[i] + 1.0 < 0.5 * level):
                continue
            value = degree[i]
            for p in range(indptr[i], indptr[i + 1]):
                if indices[p] != i:
                    value += values[p] * values[p] / max(level - degree[indices[p]], 1.0)
            if again == 0:
                least = min(least, value)
            elif value >= least:
                if steps[i] < 0:
                    queue[n] = i
                    n += 1
                steps[i] = max(steps[i], AROUND)
    head = 0
    while head < n and n <= most:
        i = queue[head]
        head += 1
        if steps[i] == 0:
            continue
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            if steps[j] < 0:
                steps[j] = steps[i] - 1
                queue[n] = j
                n += 1
    if n > most:
        n = 0
    lively, place = np.empty(n, np.int32), queue
    room = n = 0
    for t in range(d):
        i = order[t]
        place[i] = -1
        if steps[i] >= 0 and n < lively.size:
            lively[n] = i
            place[i] = n
            n += 1
            room += indptr[i + 1] - indptr[i]
    starts, columns = np.empty(n + 1, np.int32), np.empty(room, np.int32)
    entries = np.empty(room, np.float64)
    m = 0
    for t in range(n):
        starts[t] = m
        for p in range(indptr[lively[t]], indptr[lively[t] + 1]):
            j = place[indices[p]]
            if j >= 0:
                columns[m], entries[m] = j, values[p]
                m += 1
    starts[n] = m
    return lively, starts, columns[:m].copy(), entries[:m].copy()


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


def analyse(indptr: Ints, indices: Ints, values: Floats, order: Ints | None = None) -> Analysis:
    """Prepare a sparse symmetric matrix for factorisations.

    Args:
        indptr: (d + 1,) the matrix in CSR, every diagonal entry stored: row starts,
        indices: columns,
        values: and values; all read-only.
        order: (d,) elimination order; a new one if not given.

    Returns:
        Its pattern.
    """
    if order is None:
        order, _, _ = order_rows(indptr, indices)
    return Analysis(order, *factor_pattern(indptr, indices, values, order))


def track_lively(
    indptr: Ints,
    indices: Ints,
    values: Floats,
    order: Ints,
    warm: Floats,
    changed: Bools,
    k: int,
    scale: float,
    tol: float,
    extra: int,
) -> Floats:
    """Better vectors to start from: those of the part of the matrix where they are.

    Args:
        indptr: (d + 1,) the Laplacian in CSR: row starts,
        indices: columns,
        values: and values.
        order: (d,) row at each place of the elimination order.
        warm: (d, m) vectors to start from.
        changed: (d,) rows that are not as they were.
        k: wanted pairs.
        scale: lower bound on the norm.
        tol: residuals up to tol * scale will count as converged.
        extra: pairs beyond the k-th that are kept.

    Returns:
        (d, m) the part's eigenvectors, 0 in the other rows; ``warm`` if they were not found.
    """
    d = order.size
    lively, part_indptr, part_indices, part_values = lively_part(
        indptr, indices, values, order, warm, k, changed, d // 2
    )
    n = lively.size
    if n < 8 * k:
        return warm
    for array in (part_indptr, part_indices, part_values):
        array.setflags(write=False)  # one type for the kernels
    in_order = np.arange(n, dtype=np.int32)
    part = analyse(part_indptr, part_indices, part_values, in_order)
    certified, _, _, vectors = track(
        *part, False, np.ascontiguousarray(warm[lively]), changed[lively], k, scale,
        0.5 * tol, -1.0, 2.0 * scale + 1.0, MAX_LIVELY_SWEEPS, extra,
    )  # fmt: skip
    if not certified:
        return warm
    better = np.zeros((d, vectors.shape[1]))
    better[lively] = vectors
    return better
