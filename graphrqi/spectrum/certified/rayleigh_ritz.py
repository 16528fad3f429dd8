"""Kernels: the Rayleigh-Ritz step in the span of eight columns, outside the pairs found already."""

from __future__ import annotations

import math

import numpy as np

from graphrqi.spectrum.certified.factorization import Pattern
from graphrqi.spectrum.certified.search import (
    BATCH_RESIDUAL,
    BATCH_RITZ,
    FOUND,
    STATUS,
    Floats,
    Ints,
    Search,
)
from graphrqi.spectrum.certified.simd import less, load, more, plus, spread, store
from sim.compiled import inner

INDEPENDENT_SQUARED = 1e-6
"""A column is kept if the thousandth part of it is outside the span of the others: orthogonality is
then lost by a factor 1000 at most, and won back at the end."""
CHUNK = 128
"""Rows of eight numbers treated at a time: 8 kB, a quarter of a small first-level cache."""


@inner
def rayleigh_ritz(pattern: Pattern, search: Search) -> None:
    """Ritz pairs of M in the span of the eight columns, outside the span of the vectors found.

    Args:
        pattern: M.
        search: ``x`` is overwritten by the Ritz vectors, ``batch`` by the Ritz values theta and the
            norms of M x - theta x, ``source`` by the column that has the largest part in each.
            Where the columns have a smaller span, a Ritz vector is 0 and its source -1.
    """
    pool, x, ax, batch, source = search.pool, search.x, search.ax, search.batch, search.source
    d = pool.shape[1]
    g, h = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    w, norms = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    orthogonalise(pool, search.record, x, norms)
    multiply(pattern.starts, pattern.rows, pattern.entries, pattern.diagonal, x, ax)
    gram_matrices(d, x, ax, g, h)
    orthonormal_basis(g, h, w, norms, source)
    for a in range(8):
        for b in range(8):
            s = 0.0
            for i in range(8):
                s += h[a, i] * w[b, i]
            g[a, b] = s
    jacobi(g, w)
    turn = norms
    for c in range(8):
        batch[BATCH_RITZ, c] = g[c, c]
        for b in range(8):
            turn[b, c] = w[c, b]
            largest = source[c]
            if largest >= 0 and abs(w[c, b]) > abs(w[c, largest]):
                source[c] = b
    value = load(batch, BATCH_RITZ)
    nothing = spread(0.0)
    square = nothing
    for j in range(d):
        y = z = nothing
        for a in range(8):
            turned = load(turn, a)
            y = plus(y, x[j, a], turned)
            z = plus(z, ax[j, a], turned)
        store(x, j, y)
        z = less(z, value, y)
        square = more(square, z, z)
    store(batch, BATCH_RESIDUAL, square)
    for c in range(8):
        batch[BATCH_RESIDUAL, c] = math.sqrt(batch[BATCH_RESIDUAL, c])


@inner
def orthogonalise(pool: Floats, record: Floats, x: Floats, norms: Floats) -> None:
    """Make the eight columns orthogonal to the vectors found (Gram-Schmidt, twice if need be).

    Args:
        pool: (n, d) vectors by row.
        record: which of them are found.
        x: (d, 8), overwritten.
        norms: (2 or more, 8), overwritten by the squared norms before and after.
    """
    slots, d = pool.shape
    nothing = spread(0.0)
    square = nothing
    for j in range(d):
        y = load(x, j)
        square = more(square, y, y)
    store(norms, 0, square)
    share = np.empty((slots, 8), np.float64)
    for _ in range(2):  # in chunks that stay in the cache
        for b in range(slots):
            store(share, b, nothing)
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if record[STATUS, b] == FOUND:
                    part = load(share, b)
                    for j in range(start, min(start + CHUNK, d)):
                        part = plus(part, -pool[b, j], load(x, j))
                    store(share, b, part)
        square = nothing
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if record[STATUS, b] == FOUND:
                    part = load(share, b)
                    for j in range(start, min(start + CHUNK, d)):
                        store(x, j, plus(load(x, j), pool[b, j], part))
            for j in range(start, min(start + CHUNK, d)):
                y = load(x, j)
                square = more(square, y, y)
        store(norms, 1, square)
        again = False
        for q in range(8):
            again = again or norms[1, q] < 0.25 * norms[0, q]
        if not again:
            break


@inner
def multiply(
    starts: Ints, rows: Ints, entries: Floats, diagonal: Floats, x: Floats, ax: Floats
) -> None:
    """Multiply M with eight columns: ``ax`` (d, 8) is overwritten by M x.

    Args:
        starts: (d + 1,) column starts of M's strict lower triangle.
        rows: its rows.
        entries: its values.
        diagonal: (d,) of M.
        x: (d, 8).
        ax: (d, 8), overwritten.
    """
    d = diagonal.size
    nothing = spread(0.0)
    for j in range(d):
        store(ax, j, plus(nothing, diagonal[j], load(x, j)))
    for j in range(d):
        y, sum_j = load(x, j), load(ax, j)
        for p in range(starts[j], starts[j + 1]):
            v, i = entries[p], rows[p]
            sum_j = plus(sum_j, v, load(x, i))
            store(ax, i, plus(load(ax, i), v, y))
        store(ax, j, sum_j)


@inner
def gram_matrices(d: int, x: Floats, ax: Floats, g: Floats, h: Floats) -> None:
    """Overwrite ``g`` (8, 8) by x^T x and ``h`` (8, 8) by x^T M x, of their first d rows."""
    nothing = spread(0.0)
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


@inner
def orthonormal_basis(g: Floats, h: Floats, w: Floats, norms: Floats, source: Ints) -> None:
    """Elimination turns the identity into rows w with w g w^T = I, and h into w h.

    Args:
        g: (8, 8) the columns' Gram matrix; overwritten.
        h: (8, 8) overwritten by w h.
        w: (8, 8) overwritten.
        norms: the columns' squared norms before and after `orthogonalise`.
        source: (8,) overwritten by 0; -1 for a column with too little outside the span of the
            others, whose row of w is 0.
    """
    nothing = spread(0.0)
    for a in range(8):
        store(w, a, nothing)
        w[a, a] = 1.0
    for a in range(8):
        s = g[a, a]
        kept = 0.0 < norms[0, a] < math.inf and norms[1, a] >= INDEPENDENT_SQUARED * norms[0, a]
        r = 0.0
        if kept and s > INDEPENDENT_SQUARED * norms[1, a]:
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
def deflate_constants(
    x: Floats, component: Ints, size: Floats, mean: Floats, norms: Floats
) -> None:
    """Make the eight columns orthogonal to the indicators of the components, -L's null space.

    Args:
        x: (d, 8), overwritten; a column of which nothing is left becomes 0.
        component: (d,) component of each place.
        size: (c,) their sizes.
        mean: (c, 8) memory.
        norms: (2, 8) memory.
    """
    total = rest = spread(0.0)
    for c in range(size.size):
        store(mean, c, total)
    for j in range(component.size):
        y = load(x, j)
        total = more(total, y, y)
        store(mean, component[j], plus(load(mean, component[j]), 1.0, y))
    for j in range(component.size):
        y = plus(load(x, j), -1.0 / size[component[j]], load(mean, component[j]))
        rest = more(rest, y, y)
        store(x, j, y)
    store(norms, 0, total)
    store(norms, 1, rest)
    for q in range(8):
        if norms[1, q] < 1e-12 * norms[0, q]:
            for j in range(component.size):
                x[j, q] = 0.0
