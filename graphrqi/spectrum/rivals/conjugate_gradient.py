"""Inverse iteration whose linear systems are solved by conjugate gradients.

A block of k vectors is multiplied by the inverse of L (smallest end) or of s I - L (largest end, s
above the spectrum). A Rayleigh-Ritz step follows. It needs only products with L, O((m + d) k) each,
and no factorisation. Inverse iteration converges like the ratio of neighbouring eigenvalues, which
is close to 1 at the largest end. Each system needs about the root of its condition number of
products. It is slow and often stops unconverged.

References:
    Hestenes, Stiefel (1952), J. Res. NBS 49, 409-436.
    Parlett (1998), The Symmetric Eigenvalue Problem, section 4.2.
"""

from __future__ import annotations

import numpy as np

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import Pairs, Problem, eigensolver
from graphrqi.spectrum.spectrum import Floats
from graphrqi.spectrum.subspaces import null_space, rayleigh_ritz

MAX_OUTER = 20
"""Inverse iterations before giving up."""
MAX_PRODUCTS = 200
"""Products with L per system before going on with what there is."""


@eigensolver(dense_share=2)
def solve(problem: Problem) -> Pairs:
    """Run block inverse iteration from the earlier vectors, converged or not."""
    graph, end = problem.graph, problem.end
    null = null_space(graph) if end == "smallest" else np.zeros((graph.ids.size, 0))
    known = null[:, : problem.num_pairs]
    k = min(problem.num_pairs, graph.ids.size - null.shape[1]) - known.shape[1]
    values, vectors = np.zeros(0), np.zeros((graph.ids.size, 0))
    iterations = 0
    if k > 0:
        block = problem.starting_block(k)
        values, vectors = rayleigh_ritz(graph, np.linalg.qr(_outside(block, null))[0], end)
        shift = 0.0 if end == "smallest" else 2.0 * problem.scale * (1.0 + 1e-6)
        for iterations in range(1, MAX_OUTER + 1):  # noqa: B007  (reported below)
            error = graph.laplacian @ vectors - vectors * values
            if np.linalg.norm(error, axis=0).max() <= problem.tol * problem.scale:
                break
            block = _solve_systems(graph, shift, vectors, null)
            values, vectors = rayleigh_ritz(graph, np.linalg.qr(block)[0], end)
    values = np.concatenate([np.zeros(known.shape[1]), values])
    return Pairs(values, np.hstack([known, vectors]), note=f"{iterations} inverse iterations")


def _outside(block: Floats, null: Floats) -> Floats:
    """Columns without their part in the null space."""
    return block - null @ (null.T @ block)


def _solve_systems(graph: TrafficGraph, shift: float, right: Floats, null: Floats) -> Floats:
    """Solve L Y = X, or (shift I - L) Y = X where shift > 0, by conjugate gradients.

    To 1e-10 or as near as the limit of products allows, orthogonal to the null space.
    """
    laplacian = graph.laplacian
    inverse_diagonal = 1.0 / np.maximum(np.abs(shift - graph.degree), 1e-3)[:, None]
    y = np.zeros_like(right)
    r = right.copy()
    z = inverse_diagonal * r
    p = z.copy()
    rz = np.einsum("ij,ij->j", r, z)
    for _ in range(MAX_PRODUCTS):
        q = shift * p - laplacian @ p if shift else laplacian @ p
        curvature = np.einsum("ij,ij->j", p, q)
        step = np.where(curvature > 0.0, rz / np.where(curvature > 0.0, curvature, 1.0), 0.0)
        y += step * p
        r -= step * q
        r = _outside(r, null)
        if np.linalg.norm(r, axis=0).max() <= 1e-10:
            break
        z = inverse_diagonal * r
        fresh = np.einsum("ij,ij->j", r, z)
        p = z + np.where(rz > 0.0, fresh / np.where(rz > 0.0, rz, 1.0), 0.0) * p
        rz = fresh
    return _outside(y, null)
