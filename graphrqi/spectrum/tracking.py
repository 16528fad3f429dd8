"""Kernel of the certified tracker: Rayleigh-quotient iterations that share their factorisations.

All vectors are in elimination order, and M is L at the largest end and -L at the smallest, so that
the wanted eigenvalues are always the largest of M. See :mod:`graphrqi.spectrum.certified`.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled
from graphrqi.spectrum.factorization import factor_and_solve
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
"""Size of a start's noise outside the rows that changed: an eigenvector of the new matrix has a part
in those rows, unless it was one of the old matrix already (our choice)."""
MAX_POINTS = 400


@compiled
def gram(x: Floats, g: Floats) -> None:
    """Write x^T x of a (d, m) block to g (m, m)."""
    d, m = x.shape
    for a in range(m):
        for b in range(m):
            g[a, b] = 0.0
    for j in range(d):
        for a in range(m):
            v = x[j, a]
            for b in range(m):
                g[a, b] += v * x[j, b]


@compiled
def turn(x: Floats, t: Floats) -> None:
    """x <- x t for a (d, m) block and an (m, m) matrix."""
    d, m = x.shape
    line = np.empty(m, np.float64)
    for j in range(d):
        for b in range(m):
            line[b] = 0.0
        for a in range(m):
            v = x[j, a]
            for b in range(m):
                line[b] += v * t[a, b]
        for b in range(m):
            x[j, b] = line[b]


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
    acc: Floats,
    n_acc: int,
    x: Floats,
    ax: Floats,
    theta: Floats,
    res: Floats,
    source: Ints,
) -> int:
    """Ritz pairs of M in the span of eight columns, outside the span of given vectors.

    Args:
        starts: (d + 1,) column starts of M's strict lower triangle.
        rows: its rows.
        entries: its values.
        diagonal: (d,) of M.
        acc: (n, d) orthonormal vectors to stay orthogonal to.
        n_acc: how many of them count.
        x: (d, 8) columns, some perhaps 0; overwritten by the Ritz vectors.
        ax: (d, 8) room.
        theta: (8,) overwritten by the Ritz values.
        res: (8,) overwritten by the norms of M x - theta x.
        source: (8,) overwritten by the column that has the largest part in each Ritz vector.

    Returns:
        How many Ritz pairs there are.
    """
    d = diagonal.size
    g, h = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    w, t = np.zeros((8, 8), np.float64), np.empty((8, 8), np.float64)
    nothing = spread(0.0)
    yy = nothing
    for j in range(d):
        y = load(x, j)
        yy = more(yy, y, y)
    store(t, 0, yy)
    for _ in range(2):
        for b in range(n_acc):
            part = nothing
            for j in range(d):
                part = plus(part, -acc[b, j], load(x, j))
            for j in range(d):
                store(x, j, plus(load(x, j), acc[b, j], part))
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
        ga = ha = nothing
        for j in range(d):
            v = x[j, a]
            ga = plus(ga, v, load(x, j))
            ha = plus(ha, v, load(ax, j))
        store(g, a, ga)
        store(h, a, ha)
    # Gram-Schmidt in coefficients: columns w with w^T g w = I, a Cholesky factorisation of g.
    rank = int(np.int64(0))
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
    jacobi(g, t, np.int64(rank))
    for i in range(8):
        for c in range(8):
            s = 0.0
            for b in range(rank):
                s += w[i, b] * t[b, c]
            h[i, c] = s if c < rank else 0.0
    for c in range(8):
        theta[c] = g[c, c]
        source[c] = 0
        for b in range(8):
            if abs(h[b, c]) > abs(h[source[c], c]):
                source[c] = b
        t[0, c] = theta[c]
    value = load(t, 0)
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
    store(t, 0, yy)
    for c in range(8):
        res[c] = math.sqrt(t[0, c])
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
) -> Bools:
    """Find the rows in which two matrices differ.

    Args:
        old_row: (d,) row in the earlier matrix of every row, or -1.
        old_indptr: the earlier matrix in CSR: row starts,
        old_indices: columns,
        old_values: and values.
        indptr: (d + 1,) the matrix in CSR: row starts,
        indices: columns,
        values: and values.

    Returns:
        (d,) whether the row differs.
    """
    d = old_row.size
    differs = np.empty(d, np.bool_)
    for i in range(d):
        r = old_row[i]
        differs[i] = True
        if r < 0 or old_indptr[r + 1] - old_indptr[r] != indptr[i + 1] - indptr[i]:
            continue
        same = True
        first, last = old_indptr[r], old_indptr[r + 1]
        for p in range(indptr[i], indptr[i + 1]):
            column = old_row[indices[p]]
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
def track(
    order: Ints,
    starts: Ints,
    rows: Ints,
    target: Ints,
    entries: Floats,
    diagonal: Floats,
    label: Ints,
    components: int,
    deflate: bool,
    warm: Floats,
    changed: Bools,
    k: int,
    scale: float,
    tol: float,
    low: float,
    high: float,
    max_sweeps: int,
    answer: Floats,
    values: Floats,
    residuals: Floats,
) -> tuple[bool, int, int, float]:
    """Find and certify the k largest eigenpairs of M.

    Args:
        order: (d,) row at each place of the elimination order.
        starts: (d + 1,) column starts of the factor.
        rows: its rows.
        target: where its updates land.
        entries: M in the factor's pattern.
        diagonal: (d,) of M.
        label: (d,) component of each row (not place).
        components: how many.
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
        answer: (d, m) room for the vectors, by row, m >= k.
        values: (m,) room for the eigenvalues of M, descending.
        residuals: (m,) room for the residuals of the vectors as answered.

    Returns:
        Whether none of the k was missed, number of pairs answered, factorisations used, and the
        largest departure of the vectors from orthonormality.
    """
    d = order.size
    ignored = components if deflate else 0
    room = 2 * k + 24
    acc, cand = np.empty((room, d), np.float64), np.empty((room, d), np.float64)
    acc_theta, acc_res = np.empty(room, np.float64), np.empty(room, np.float64)
    theta, res, home = np.empty(room), np.empty(room), np.empty(room)
    use, age = np.empty(room, np.int32), np.empty(room, np.int32)
    n_acc = n_cand = int(np.int64(0))
    point, error = np.empty(MAX_POINTS, np.float64), np.empty(MAX_POINTS, np.float64)
    above, clear = np.empty(MAX_POINTS, np.int32), np.empty(MAX_POINTS, np.int32)
    point[0], above[0], error[0] = high, 0, 0.0
    point[1], above[1], error[1] = low, d - ignored, 0.0
    n_points = 2
    factor, pivots = np.empty((rows.size, 8), np.float64), np.empty((d, 8), np.float64)
    x, ax = np.zeros((d, 8), np.float64), np.empty((d, 8), np.float64)
    shifts, growth, counts = np.empty((1, 8)), np.empty((1, 8)), np.empty((1, 8))
    ritz, ritz_res = np.empty(8), np.empty(8)
    lane, source, lane_age = np.empty(8, np.int32), np.empty(8, np.int32), np.empty(8, np.int32)
    estimate = np.empty(2 * room, np.float64)
    size, mean = np.zeros(components, np.float64), np.empty((components, 8), np.float64)
    part = np.empty(d, np.int32)
    for j in range(d):
        part[j] = label[order[j]]
        size[part[j]] += 1.0
    is_changed = np.empty(d, np.bool_)
    for j in range(d):
        is_changed[j] = changed[order[j]]
    narrow = warm.shape[1] > 0
    first = narrow
    seed = np.uint64(88172645463325252)
    goal0, delta0, floor = 0.9 * tol * scale, tol * scale, 1e-13 * scale
    sweeps = 0
    certified = stuck = False
    wanted = k  # raised where eigenvalues equal to the k-th have to be found too
    warm_done = 0
    warm_columns = min(warm.shape[1], 32)
    nothing = spread(0.0)
    while True:
        warming = warm_done < warm_columns
        if warming:  # first, Rayleigh-Ritz in the span of the given vectors
            for q in range(8):
                lane[q] = q if warm_done + q < warm_columns else -2
                shifts[0, q] = math.inf
                for j in range(d):
                    x[j, q] = warm[order[j], warm_done + q] if lane[q] >= 0 else 0.0
            warm_done += 8
        else:
            # Points whose count is clear of the eigenvalues found; one may be the certificate.
            n_clear = 0
            delta = delta0
            if deflate and n_acc >= k:
                delta = min(delta0, max(1e-2 * abs(acc_theta[k - 1]), floor))
            for i in range(n_points):
                near = False
                found = 0
                for b in range(n_acc):
                    near = near or abs(acc_theta[b] - point[i]) <= error[i] + acc_res[b]
                    found += acc_theta[b] > point[i]
                if not near or i == 0 or i == n_points - 1:
                    clear[n_clear] = i
                    n_clear += 1
                if not near and n_acc >= k and found == above[i]:
                    certified = certified or point[i] + error[i] <= acc_theta[k - 1] + delta
            if certified or sweeps >= max_sweeps:
                break

            # Lanes: candidates where eigenvalues are missing, then new starts, then counts.
            used = 0
            for c in range(n_cand):
                use[c] = 0
            for i in range(n_clear - 1):
                top, bottom = point[clear[i]], point[clear[i + 1]]
                n, n_below = above[clear[i]], above[clear[i + 1]]
                if n >= wanted:
                    break
                missing = min(n_below, wanted) - n
                for b in range(n_acc):
                    missing -= bottom < acc_theta[b] < top
                while missing > 0:
                    best = -1
                    for c in range(n_cand):
                        if use[c] == 0 and bottom < theta[c] < top:
                            if best < 0:
                                best = c
                            elif n_below > wanted:
                                if theta[c] > theta[best]:
                                    best = c
                            elif res[c] < res[best]:
                                best = c
                    if best < 0:
                        break
                    use[best] = 1
                    missing -= 1
                    if used < 8:
                        shifts[0, used], lane[used] = theta[best], best
                        used += 1
                for r in range(missing):
                    if used == 8:
                        break
                    if deflate and top == 0.0:
                        shift = bottom * math.exp(-1.2 * (r + 1))
                    else:
                        shift = bottom + (top - bottom) * (missing - r) / (missing + 1.0)
                    best = -1
                    for c in range(n_cand):
                        if use[c] == 0 and bottom < home[c] < top and age[c] < MAX_AGE:
                            if best < 0 or res[c] < res[best]:
                                best = c
                    if best >= 0:
                        age[best] += 1
                    if best < 0:
                        if n_cand == room:
                            break
                        best = n_cand
                        n_cand += 1
                        seed = random_start(cand[best], is_changed, narrow, seed)
                        age[best] = 0
                    theta[best], res[best], use[best] = shift, math.inf, 1
                    shifts[0, used], lane[used] = shift, best
                    used += 1
            solving = used > 0

            # Spare lanes count just below the k-th value, and divide the interval that holds it.
            n = 0
            for b in range(n_acc):
                estimate[n] = acc_theta[b]
                n += 1
            for c in range(n_cand):
                if use[c] > 0:
                    estimate[n] = theta[c]
                    n += 1
            if n >= wanted:
                for a in range(wanted):
                    for b in range(a + 1, n):
                        if estimate[b] > estimate[a]:
                            estimate[a], estimate[b] = estimate[b], estimate[a]
                last = estimate[wanted - 1]
                doubt = 0.0
                for c in range(n_cand):
                    if use[c] > 0 and theta[c] == last and res[c] < math.inf:
                        doubt = min(1.5 * res[c], 50.0 * res[c] * res[c] / scale)
                unit = min(scale, 100.0 * abs(last)) if deflate else scale
                if first and used > 0:  # look for eigenvalues that the change has made
                    free = min(8 - used, room - n_cand)
                    for r in range(free):
                        seed = random_start(cand[n_cand], is_changed, narrow, seed)
                        shift = last + (estimate[0] - last) * (r + 0.5) / free
                        theta[n_cand], res[n_cand], use[n_cand] = shift, math.inf, 1
                        age[n_cand] = 0
                        shifts[0, used], lane[used] = shift, n_cand
                        used += 1
                        n_cand += 1
                first = False
                margin = max(doubt, 1e-4 * unit)
                while used < 8 and margin >= doubt and margin >= 1e-9 * unit:
                    shifts[0, used], lane[used] = last - margin, -1
                    used += 1
                    margin *= 0.03
                if doubt < 0.5 * delta and used < 8:
                    shifts[0, used], lane[used] = last + 0.5 * delta, -1
                    used += 1
            for i in range(n_clear - 1):
                top, bottom = point[clear[i]], point[clear[i + 1]]
                if above[clear[i]] < wanted < above[clear[i + 1]]:
                    free = 8 - used
                    for r in range(free):
                        if deflate and top == 0.0:
                            shift = bottom * math.exp(-1.0 * (r + 1))
                        else:
                            shift = bottom + (top - bottom) * (free - r) / (free + 1.0)
                        shifts[0, used], lane[used] = shift, -1
                        used += 1
                    if not solving and stuck:  # equal eigenvalues at the k-th: find them all
                        wanted = above[clear[i + 1]]
                        break
            if not solving:
                if wanted > room - 12 or (stuck and wanted == k):
                    break
                stuck = True
            for q in range(used, 8):
                shifts[0, q], lane[q] = low - scale, -2

            # One factorisation for all.
            if solving:
                for q in range(8):
                    if lane[q] >= 0:
                        v = cand[lane[q]]
                        for j in range(d):
                            x[j, q] = v[j]
                    else:
                        for j in range(d):
                            x[j, q] = 0.0
            factor_and_solve(
                starts, rows, target, entries, diagonal, shifts, 1e-15 * scale, 2 * solving,
                factor, pivots, x, counts, growth,
            )  # fmt: skip
            sweeps += 1
            for q in range(8):
                s = shifts[0, q]
                n = int(counts[0, q]) - ignored
                uncertain = 4.0 * ROUNDING * growth[0, q]
                if lane[q] == -2 or n_points == MAX_POINTS or not low < s < high:
                    continue
                i = n_points
                while i > 0 and point[i - 1] < s:
                    i -= 1
                if point[i - 1] == s or above[i - 1] > n or above[i] < n:
                    continue
                if uncertain > 1e-4 * scale:
                    continue
                for b in range(n_points, i, -1):
                    point[b], above[b], error[b] = point[b - 1], above[b - 1], error[b - 1]
                point[i], above[i], error[i] = s, n, uncertain
                n_points += 1
            if not solving:
                continue

        if deflate:  # take out the mean over each component; nothing may be left of a vector
            before = after = nothing
            for c in range(components):
                store(mean, c, nothing)
            for j in range(d):
                y = load(x, j)
                before = more(before, y, y)
                store(mean, part[j], plus(load(mean, part[j]), 1.0, y))
            for j in range(d):
                y = plus(load(x, j), -1.0 / size[part[j]], load(mean, part[j]))
                after = more(after, y, y)
                store(x, j, y)
            store(counts, 0, before)
            store(growth, 0, after)
            for q in range(8):
                if growth[0, q] < 1e-12 * counts[0, q]:
                    for j in range(d):
                        x[j, q] = 0.0
        rank = rayleigh_ritz(
            starts, rows, entries, diagonal, acc, n_acc, x, ax, ritz, ritz_res, source
        )
        # The Ritz pairs take the place of the candidates that were in the lanes.
        for q in range(8):
            lane_age[q] = age[lane[q]] if lane[q] >= 0 and not warming else 0
        n = 0
        for c in range(n_cand):
            if use[c] == 0:
                continue
            in_lane = False
            for q in range(8):
                in_lane = in_lane or (lane[q] == c and not warming)
            if not in_lane:
                if n < c:
                    theta[n], res[n], home[n], age[n] = theta[c], res[c], home[c], age[c]
                    for j in range(d):
                        cand[n, j] = cand[c, j]
                n += 1
        n_cand = n
        for c in range(rank):
            if deflate and ritz[c] > -0.1 * floor:
                continue
            goal = min(goal0, max(1e-3 * abs(ritz[c]), floor)) if deflate else goal0
            if ritz_res[c] <= goal:
                if n_acc == room:
                    continue
                b = n_acc
                while b > 0 and acc_theta[b - 1] < ritz[c]:
                    acc_theta[b], acc_res[b] = acc_theta[b - 1], acc_res[b - 1]
                    for j in range(d):
                        acc[b, j] = acc[b - 1, j]
                    b -= 1
                acc_theta[b], acc_res[b] = ritz[c], ritz_res[c]
                for j in range(d):
                    acc[b, j] = x[j, c]
                n_acc += 1
            elif n_cand < room:
                theta[n_cand], res[n_cand] = ritz[c], ritz_res[c]
                home[n_cand], use[n_cand] = shifts[0, source[c]], 1
                age[n_cand] = lane_age[source[c]]
                for j in range(d):
                    cand[n_cand, j] = x[j, c]
                n_cand += 1

    # Answer with the largest, made orthonormal to rounding.
    found = min(n_acc, answer.shape[1])
    if found < k:
        return False, found, sweeps, math.inf
    w, g = np.empty((d, found), np.float64), np.empty((found, found), np.float64)
    for c in range(found):
        values[c], residuals[c] = acc_theta[c], acc_res[c]
        for j in range(d):
            w[j, c] = acc[c, j]
    gram(w, g)
    departure = 0.0
    for a in range(found):
        for b in range(found):
            departure = max(departure, abs(g[a, b] - (1.0 if a == b else 0.0)))
            g[a, b] = -0.5 * g[a, b]
        g[a, a] += 1.5
    if departure > 1e-14:
        turn(w, g)  # Newton's step to the nearest orthonormal block squares the departure
        for c in range(found):
            residuals[c] += departure * scale
    for j in range(d):
        for c in range(found):
            answer[order[j], c] = w[j, c]
    return certified, found, sweeps, found * departure * departure + 4.0 * ROUNDING
