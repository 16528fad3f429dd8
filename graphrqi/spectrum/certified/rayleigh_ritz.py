"""Kernels: the Rayleigh-Ritz step in the span of eight columns, outside the pairs found already."""

from __future__ import annotations

import math

import numpy as np

from graphrqi.spectrum.certified.eight import less, load, more, plus, spread, store
from graphrqi.spectrum.certified.prepared import Prepared
from graphrqi.spectrum.certified.search import FOUND, Floats, Ints, Search
from sim.compiled import inner

INDEPENDENT_SQUARED = 1e-6
"""A column is kept if the thousandth part of it is outside the span of the others: orthogonality is
then lost by a factor 1000 at most, and won back at the end."""
CHUNK = 128
"""Rows of eight numbers treated at a time: 8 kB, a quarter of a small first-level cache."""


@inner
def rayleigh_ritz(matrix: Prepared, search: Search) -> None:
    """Ritz pairs of M in the span of the eight columns, outside the span of the vectors found.

    ``search.x`` is overwritten by the Ritz vectors, ``theta`` by the Ritz values, ``norm`` by the
    norms of M x - theta x, and ``source``. Where the columns have a smaller span, a Ritz vector is
    0 and its source -1.
    """
    x, ax, source = search.x, search.ax, search.source
    d = len(x)
    g, h = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    w, norms = np.empty((8, 8), np.float64), np.empty((8, 8), np.float64)
    orthogonalise(search, norms)
    multiply(matrix, x, ax)
    gram_matrices(x, ax, g, h)
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
        search.theta[0, c] = g[c, c]
        for b in range(8):
            turn[b, c] = w[c, b]
            largest = source[c]
            if largest >= 0 and abs(w[c, b]) > abs(w[c, largest]):
                source[c] = b
    value = load(search.theta, 0)
    square = spread(0.0)
    for j in range(d):
        y = z = spread(0.0)
        for a in range(8):
            turned = load(turn, a)
            y = plus(y, x[j, a], turned)
            z = plus(z, ax[j, a], turned)
        store(x, j, y)
        z = less(z, value, y)
        square = more(square, z, z)
    store(search.norm, 0, square)
    for c in range(8):
        search.norm[0, c] = math.sqrt(search.norm[0, c])


@inner
def orthogonalise(search: Search, norms: Floats) -> None:
    """Make the eight columns orthogonal to the vectors found (Gram-Schmidt, twice if need be).

    The first two rows of ``norms`` are overwritten by the squared norms before and after.
    """
    pool, x = search.pool, search.x
    slots, d = pool.shape
    square = spread(0.0)
    for j in range(d):
        y = load(x, j)
        square = more(square, y, y)
    store(norms, 0, square)
    share = np.empty((slots, 8), np.float64)
    for _ in range(2):  # in chunks that stay in the cache
        for b in range(slots):
            store(share, b, spread(0.0))
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if search.status[b] == FOUND:
                    part = load(share, b)
                    for j in range(start, min(start + CHUNK, d)):
                        part = plus(part, -pool[b, j], load(x, j))
                    store(share, b, part)
        square = spread(0.0)
        for start in range(0, d, CHUNK):
            for b in range(slots):
                if search.status[b] == FOUND:
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


@inner
def gram_matrices(x: Floats, ax: Floats, g: Floats, h: Floats) -> None:
    """Overwrite ``g`` (8, 8) by x^T x and ``h`` (8, 8) by x^T M x."""
    d = len(x)
    for a in range(8):
        store(g, a, spread(0.0))
        store(h, a, spread(0.0))
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

    A column with too little outside the span of the others gets a row 0 and the source -1.
    """
    for a in range(8):
        store(w, a, spread(0.0))
        w[a, a] = 1.0
    for a in range(8):
        s = g[a, a]
        kept = 0.0 < norms[0, a] < math.inf and norms[1, a] >= INDEPENDENT_SQUARED * norms[0, a]
        r = 0.0
        if kept and s > INDEPENDENT_SQUARED * norms[1, a]:
            r = 1.0 / math.sqrt(s)
        source[a] = 0 if r > 0.0 else -1
        row_g, row_h = plus(spread(0.0), r, load(g, a)), plus(spread(0.0), r, load(h, a))
        row_w = plus(spread(0.0), r, load(w, a))
        store(h, a, row_h)
        store(w, a, row_w)
        for b in range(a + 1, 8):
            v = -r * g[a, b]
            store(g, b, plus(load(g, b), v, row_g))
            store(h, b, plus(load(h, b), v, row_h))
            store(w, b, plus(load(w, b), v, row_w))


@inner
def jacobi(h: Floats, w: Floats) -> None:
    """Diagonalise a symmetric h (8, 8) by cyclic Jacobi rotations; the rows of w turn along."""
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
                turn_rows(h, a, b, c, s)
                turn_rows(w, a, b, c, s)


@inner
def turn_rows(m: Floats, a: int, b: int, c: float, s: float) -> None:
    """Rotate rows a and b of (8, 8) numbers by the angle of cosine c and sine s."""
    y, z = load(m, a), load(m, b)
    store(m, a, plus(plus(spread(0.0), c, y), -s, z))
    store(m, b, plus(plus(spread(0.0), s, y), c, z))


@inner
def deflate_constants(x: Floats, component: Ints, size: Floats) -> None:
    """Make the eight columns orthogonal to the indicators of the components, -L's null space.

    A column of which nothing is left becomes 0.
    """
    mean, norms = np.zeros((size.size, 8), np.float64), np.empty((2, 8), np.float64)
    total = rest = spread(0.0)
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
