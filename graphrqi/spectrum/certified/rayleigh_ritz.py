"""Kernels: the Rayleigh-Ritz step in the span of eight columns, outside the pairs found already."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from graphrqi.spectrum.certified.factorization import load, more, plus, spread, store, times
from graphrqi.spectrum.certified.prepared import Bools, Floats, Ints, Prepared
from sim.compiled import inner

Ritz: TypeAlias = tuple[Floats, Floats, Floats]
"""(r,) Ritz values, (r,) residuals, and (r, d) unit vectors."""

INDEPENDENT = 1e-3
"""A column is kept if this part of it is outside the span of the others; orthogonality is restored
at the end."""
SPARE = 24
"""Vectors kept beyond the wanted number: those of three factorisations."""


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
