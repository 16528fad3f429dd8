"""The algorithms of the paper's comparison: GraphRQI as printed and made right, and its rivals.

References:
    Chandra et al. (2020), GraphRQI, ICRA: eq. 2 and algorithm 1.
    Brand (2006), Fast low-rank modifications of the thin singular value decomposition, Linear
    Algebra and its Applications 415.
    Zhang, Cui, Pei, Wang, Zhu (2018), TIMERS: Error-bounded SVD restart on dynamic networks, AAAI.
    Hestenes, Stiefel (1952), J. Res. NBS 49, 409-436: conjugate gradients. Parlett (1998), The
    Symmetric Eigenvalue Problem, section 4.2: inverse iteration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.contract import (
    Floats,
    Pairs,
    Problem,
    Spectrum,
    all_pairs,
    carry_rows,
    eigensolver,
    null_space,
    pick,
    rayleigh_ritz,
)

RQI_PRINTED, CHANGE = 5, 1e-8
"""As printed: Rayleigh-quotient iterations per pair and update, and the eps at which they end, the
change of a unit vector (the paper has no values)."""
RQI = 8
"""Made right: Rayleigh-quotient iterations per pair; they converge cubically."""
DEPENDENT = 0.1
"""A converged vector with less of it than this outside the span of the others is a duplicate."""
RESTART_EDGES = 2.0
"""Changed edges, in units of the square root of d, above which it starts from a dense solution."""
MARGIN = 0.01
"""Loss above the bound, relative to the bound, that calls for a restart of TIMERS; the authors try
.01 to .2 and we take their strictest."""
MAX_OUTER, MAX_PRODUCTS = 20, 200
"""Inverse iterations before giving up, and products with L per system of conjugate gradients."""


def change_between(before: TrafficGraph, after: TrafficGraph) -> tuple[NDArray[np.int64], Floats]:
    """The edges in which two graphs differ, by vehicle id.

    Returns:
        (m, 2) ids of the edges that only one of them has; (m,) 1 for a new edge, -1 for one that is
        gone.
    """
    edges = np.sort(np.concatenate([before.edges, after.edges]), axis=1)
    signs = np.repeat([-1.0, 1.0], [len(before.edges), len(after.edges)])
    found, place = np.unique(edges, axis=0, return_inverse=True)
    total = np.bincount(place.ravel(), weights=signs, minlength=len(found))
    return found[total != 0.0], total[total != 0.0]


def _rows_of(graph: TrafficGraph, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 2) rows of a graph that edges (m, 2) of ids join."""
    return graph.rows_of(edges.ravel()).reshape(-1, 2)


class AllPairs(NamedTuple):
    """Every eigenvalue (d,) and eigenvector (d, d) of a graph, carried from step to step."""

    values: Floats
    vectors: Floats


def _all_pairs_before(previous: Spectrum | None, graph: TrafficGraph) -> AllPairs | None:
    """All pairs of an earlier answer, if its vehicles are the first rows of a graph."""
    if previous is None or not isinstance(previous.carried, AllPairs):
        return None
    before = previous.graph.ids
    return previous.carried if np.array_equal(graph.ids[: before.size], before) else None


@eigensolver()
def paper(problem: Problem) -> Pairs:
    """GraphRQI as it is printed, with the residual it really has.

    Every arrival of edges at a vehicle is taken as L_t = [L_{t-1} 0; 0 1] + delta delta^T, where
    delta is 1 at its new neighbours. This is not a Laplacian, so the pairs drift from the graph's.
    Edges that vanish have no update, and several pairs converge to the same vector. The printed
    loop condition is reversed. docs/spectrum.md shows each error in two lines.

    It starts from a dense solution, which alone can be certified, where vehicles departed. Costs
    O(d^2) per iteration and O(d^3) per arrival.
    """
    graph, previous = problem.graph, problem.previous
    old = _all_pairs_before(previous, graph)
    if old is None or previous is None:
        pairs, note = AllPairs(*all_pairs(graph)), "solved anew"
    else:
        pairs, note = _follow(old, previous.graph, graph), ""
    chosen = problem.chosen(*pairs)
    return Pairs(*chosen, complete=note != "", note=note, carried=pairs)


def _follow(pairs: AllPairs, before: TrafficGraph, graph: TrafficGraph) -> AllPairs:
    """Apply the printed update once for every vehicle that gained edges."""
    values, vectors = pairs
    edges, signs = change_between(before, graph)
    first, last = np.sort(_rows_of(graph, edges)[signs > 0.0], axis=1).T
    grown = range(before.ids.size, graph.ids.size)
    for vertex in sorted({*last.tolist(), *grown}):
        if vertex in grown:
            values = np.append(values, 1.0)
            border = np.eye(values.size)
            border[:-1, :-1] = vectors
            vectors = border
        delta = np.zeros(values.size)
        delta[first[last == vertex]] = 1.0
        values, vectors = _rank_one(values, vectors, delta)
    return AllPairs(values, vectors)


def _rank_one(values: Floats, vectors: Floats, delta: Floats) -> tuple[Floats, Floats]:
    """Rayleigh-quotient iterations for every pair of U Lambda U^T + delta delta^T.

    U is taken for orthonormal as the paper does; nothing keeps the new vectors different.
    """
    r = vectors.T @ delta
    x = np.eye(values.size)
    shift = values + r**2
    for _ in range(RQI_PRINTED):
        gap = values[:, None] - shift
        gap = np.where(np.abs(gap) < 1e-14, 1e-14, gap)
        ax, ar = x / gap, r[:, None] / gap
        denominator = 1.0 + r @ ar
        denominator = np.where(np.abs(denominator) < 1e-14, 1e-14, denominator)
        y = ax - ar * ((r @ ax) / denominator)  # Sherman-Morrison
        length = np.linalg.norm(y, axis=0)
        usable = (length > 0.0) & np.isfinite(length)
        y = np.where(usable, y / np.where(usable, length, 1.0), x)
        change = np.minimum(np.linalg.norm(y - x, axis=0), np.linalg.norm(y + x, axis=0)).max()
        x = y
        shift = values @ x**2 + (r @ x) ** 2
        if change <= CHANGE:
            break
    moved = vectors @ x  # the columns of U may have become dependent: a zero column stays zero
    length = np.linalg.norm(moved, axis=0)
    return shift, moved / np.where(length > 0.0, length, 1.0)


@eigensolver()
def exact(problem: Problem) -> Pairs:
    """The paper's algorithm made right: every pair updated by Rayleigh-quotient iterations.

    With w_e = e_i - e_j for every edge that came (s_e = 1) or went (-1), L_t = blk(L_{t-1}, 0) +
    W S W^T. Woodbury's formula gives the inverse in the old eigenbasis, with one (p, p) system per
    pair.

    Differs from the paper: the update is a Laplacian, p edges at once. Pairs that converge to the
    same vector are replaced by a Rayleigh-Ritz step in the complement. The iteration stops on its
    residual.

    Assumes that no vehicle departed and that few edges changed; else it starts from a dense
    solution. Costs O(d p^2) for each of d pairs, and O(d^3) for the back-transformation.
    """
    pairs, note = _updated(problem)
    kept = AllPairs(*all_pairs(problem.graph)) if pairs is None else pairs
    return Pairs(*problem.chosen(*kept), complete=True, note=note, carried=kept)


def _updated(problem: Problem) -> tuple[AllPairs | None, str]:
    """All pairs, updated from the earlier answer; None if that cannot be done, and a remark."""
    graph, previous = problem.graph, problem.previous
    old = _all_pairs_before(previous, graph)
    if old is None or previous is None:
        return None, "solved anew: no earlier answer of this solver, or vehicles departed"
    edges, signs = change_between(previous.graph, graph)
    if len(edges) > RESTART_EDGES * graph.ids.size**0.5:
        return None, f"solved anew: {len(edges)} edges changed"
    goal = 0.1 * problem.tol * problem.scale
    values, vectors = pairs = update(old, graph.ids.size, _rows_of(graph, edges), signs, goal)
    drift = np.linalg.norm(graph.laplacian @ vectors - vectors * values, axis=0)
    if drift.max(initial=0.0) > 10.0 * goal:
        return None, "solved anew: rounding errors had built up"
    return pairs, ""


def update(old: AllPairs, d: int, ends: NDArray[np.int64], signs: Floats, goal: float) -> AllPairs:
    """All eigenpairs of d vehicles, ascending, after the change of p edges.

    The first vehicles are those of ``old``. ``ends`` (p, 2) are rows of the edges, and ``signs``
    (p,) are 1 or -1. ``goal`` is the residual of convergence.
    """
    c = old.values.size
    spread = np.concatenate([old.values, np.zeros(d - c)])
    basis = np.eye(d)
    basis[:c, :c] = old.vectors
    w = basis[ends[:, 0]].T - basis[ends[:, 1]].T  # (d, p) W^ = U^T W
    scale = max(1.0, float(np.abs(spread).max(initial=0.0)) + 2.0 * signs.size)
    x = np.eye(d)  # column j is the iterate of pair j in the old eigenbasis
    shift = spread + (w**2) @ signs
    norms = np.full(d, np.inf)
    active = np.arange(d)
    for _ in range(RQI):
        y = _shifted_solves(spread, w, signs, shift[active], x[:, active], scale)
        y /= np.linalg.norm(y, axis=0)
        applied = spread[:, None] * y + w @ (signs[:, None] * (w.T @ y))
        shift[active] = np.einsum("ij,ij->j", y, applied)
        norms[active] = np.linalg.norm(applied - y * shift[active], axis=0)
        x[:, active] = y
        active = active[norms[active] > goal]
        if not active.size:
            break
    everything = np.diag(spread) + (w * signs) @ w.T
    frame, corner, _ = qr(x[:, norms <= goal], pivoting=True)
    m = int((np.abs(np.diag(corner)) >= DEPENDENT).sum())
    if m < d:  # what no iteration reached: Rayleigh-Ritz in the orthogonal complement
        rest = frame[:, m:]
        frame[:, m:] = rest @ np.linalg.eigh(rest.T @ everything @ rest)[1]
    final = np.einsum("ij,ij->j", frame, everything @ frame)
    order = np.argsort(final, kind="stable")
    return AllPairs(final[order], (basis @ frame)[:, order])


def _shifted_solves(
    spread: Floats, w: Floats, signs: Floats, shifts: Floats, x: Floats, scale: float
) -> Floats:
    """(Lambda - mu_j I + W S W^T)^-1 x_j for every pair j, by Woodbury's formula."""
    gap = spread[:, None] - shifts
    floor = 1e-15 * scale  # a shift within rounding of a pole is moved off it
    gap = np.where(np.abs(gap) < floor, np.where(gap < 0.0, -floor, floor), gap)
    out = x / gap
    for j in range(shifts.size):
        scaled = w / gap[:, j : j + 1]
        system, right = np.diag(1.0 / signs) + w.T @ scaled, w.T @ out[:, j]
        try:
            step = np.linalg.solve(system, right)
        except np.linalg.LinAlgError:  # the shift is an eigenvalue to the last bit
            step = np.linalg.lstsq(system, right, rcond=None)[0]
        out[:, j] -= scaled @ step
    return out


@dataclass(frozen=True, eq=False)
class Tracked:
    """The rank-k approximation M ~ U diag(values) U^T that low-rank methods carry along.

    M is the Laplacian at the largest end, and s I - L at the smallest, where s bounds the spectrum.
    ``bound`` is that s, or 0. ``base`` is the graph of the last restart, ``base_loss`` its loss
    (squared Frobenius norm).
    """

    values: Floats
    vectors: Floats
    bound: float
    base: TrafficGraph
    base_loss: float


def _restart(problem: Problem) -> Tracked:
    """Exact pairs of this graph to track from: the approximation with the smallest loss."""
    values, vectors = all_pairs(problem.graph)
    bound = 4.0 * problem.scale if problem.end == "smallest" else 0.0
    shifted = bound - values if bound else values
    kept = pick(shifted, problem.num_pairs, "largest")
    loss = float((shifted**2).sum() - (shifted[kept] ** 2).sum())
    return Tracked(shifted[kept], vectors[:, kept], bound, problem.graph, loss)


def _carried_over(problem: Problem) -> tuple[Tracked, Floats, Floats] | None:
    """The earlier approximation with this graph's rows, and how M changed since.

    M is the old M, bordered by zeros, + W diag(S) W^T: W (d, p) and S (p,) are returned, too. None
    if vehicles departed, or if the spectrum outgrew the old bound.
    """
    graph, previous = problem.graph, problem.previous
    old = None if previous is None else previous.carried
    if previous is None or not isinstance(old, Tracked) or previous.end != problem.end:
        return None
    if old.values.size < problem.num_pairs or (old.bound and old.bound < 2.0 * problem.scale):
        return None
    if not np.isin(previous.ids, graph.ids).all():
        return None
    edges, signs = change_between(previous.graph, graph)
    unit = np.eye(graph.ids.size)
    first, last = _rows_of(graph, edges).T
    arrived = ~np.isin(graph.ids, previous.ids) if old.bound else np.zeros(graph.ids.size, bool)
    w = np.hstack([unit[:, first] - unit[:, last], unit[:, arrived]])
    signs = -signs if old.bound else signs
    weights = np.concatenate([signs, np.full(int(arrived.sum()), old.bound)])
    return replace(old, vectors=carry_rows(previous, graph, old.vectors)), w, weights


def _report(problem: Problem, tracked: Tracked, note: str) -> Pairs:
    """The pairs asked for out of a tracked approximation, which is carried on."""
    values = tracked.bound - tracked.values if tracked.bound else tracked.values
    return Pairs(*problem.chosen(values, tracked.vectors), note=note, carried=tracked)


@eigensolver()
def incremental_svd(problem: Problem) -> Pairs:
    """Brand's incremental SVD: fold each change of the matrix into a rank-k approximation.

    Assumes that the matrix is nearly of low rank: what lies outside the k columns is thrown away.
    A Laplacian has full rank outside its null space, so the error after several steps is of the
    order of its (k+1)-th eigenvalue. Costs O(d (k + p)^2) for p changed edges.
    """
    before = _carried_over(problem)
    if before is None:
        return _report(problem, _restart(problem), "started from a dense solution")
    tracked, w, weights = before
    basis, corner = np.linalg.qr(np.hstack([tracked.vectors, w]))  # Brand's eqs. 2-4
    core = (corner * np.concatenate([tracked.values, weights])) @ corner.T
    inner, turn = np.linalg.eigh(0.5 * (core + core.T))
    kept = pick(inner, problem.num_pairs, "largest")
    moved = replace(tracked, values=inner[kept], vectors=basis @ turn[:, kept])
    return _report(problem, moved, "")


@eigensolver()
def restart_svd(problem: Problem) -> Pairs:
    """TIMERS: first-order perturbation of k pairs, and a restart when a bound says it drifted.

    The loss ||M - U diag(s) U^T||_F^2 is compared with a lower bound on that of the best rank-k
    approximation. The bound is the loss at the last restart plus the change of trace of M M^T, less
    that change's k largest eigenvalues.

    Assumes changes that are small against the gaps between eigenvalues. A traffic graph's are not,
    so that it restarts at most steps, and costs what its dense restart costs.
    """
    before = _carried_over(problem)
    if before is not None:
        old, w, weights = before
        values, vectors = _perturbed(old.values, old.vectors, w, weights)
        moved = replace(old, values=values, vectors=vectors)
        if not _drifted(problem.graph, moved):
            return _report(problem, moved, "")
    return _report(problem, _restart(problem), "restarted")


def _perturbed(
    values: Floats, vectors: Floats, w: Floats, weights: Floats
) -> tuple[Floats, Floats]:
    """First-order change of eigenpairs inside their own span, by W diag(S) W^T."""
    small = w.T @ vectors
    change = small.T @ (weights[:, None] * small)
    gap = values[None, :] - values[:, None]
    usable = np.abs(gap) > np.abs(change)  # first order means nothing where the gap is smaller
    mixing = np.where(usable, change / np.where(usable, gap, 1.0), 0.0)
    vectors, corner = np.linalg.qr(vectors + vectors @ mixing)
    return values + np.diag(change), vectors * np.where(np.diag(corner) < 0.0, -1.0, 1.0)


def _drifted(graph: TrafficGraph, tracked: Tracked) -> bool:
    """Whether the loss exceeds the least possible by more than the margin (theorem 1).

    Always, where vehicles came or went since the last restart.
    """
    if not np.array_equal(tracked.base.ids, graph.ids):
        return True
    now, then = (_matrix(g, tracked.bound) for g in (graph, tracked.base))
    u = tracked.vectors
    inner = np.einsum("ij,ij->j", u, now @ u)
    loss = (now**2).sum() - 2.0 * (tracked.values * inner).sum() + (tracked.values**2).sum()
    growth = now @ now.T - then @ then.T
    top = np.asarray(np.linalg.eigvalsh(growth), dtype=np.float64)
    best = tracked.base_loss + np.trace(growth) - top[pick(top, u.shape[1], "largest")].sum()
    return bool(loss - best > MARGIN * max(best, 1e-12 * float((now**2).sum())))


def _matrix(graph: TrafficGraph, bound: float) -> Floats:
    """The matrix that is tracked."""
    laplacian: Floats = graph.laplacian.toarray()
    return bound * np.eye(graph.ids.size) - laplacian if bound else laplacian


@eigensolver(dense_share=2)
def conjugate_gradient(problem: Problem) -> Pairs:
    """Block inverse iteration from the earlier vectors, its systems solved by conjugate gradients.

    It inverts L at the smallest end, and s I - L, s above the spectrum, at the largest. It needs
    only products with L, O((m + d) k) each. Inverse iteration converges like the ratio of
    neighbouring eigenvalues, so that it is slow and often stops unconverged.
    """
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
    """Solve L Y = X, or (shift I - L) Y = X where shift > 0, outside the null space.

    The residual is 1e-10, or as small as the limit of products allows.
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
