"""Eigenvalue solvers of numpy, scipy and scikit-learn.

References:
    Anderson et al. (1999), LAPACK Users' Guide: xSYEVD and xGESDD.
    Lehoucq, Sorensen, Yang (1998), ARPACK Users' Guide.
    Knyazev (2001), SIAM J. Sci. Comput. 23, 517-541: LOBPCG.
    Halko, Martinsson, Tropp (2011), Finding structure with randomness, SIAM Review 53, 217.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from graphrqi.spectrum.contract import Floats, Pairs, Problem, eigensolver

SHIFT = 1e-3
"""ARPACK's shift below the spectrum at the smallest end, relative to max(1, the largest degree)
(far enough for an accurate factorisation, near enough to separate the smallest eigenvalues)."""
MAX_ITERATIONS = 100
"""LOBPCG's iterations before giving up (scipy's own default is 20)."""
POWER_ITERATIONS = 5
"""Power iterations of the truncated SVD: scikit-learn's own default."""


@eigensolver()
def eigh(problem: Problem) -> Pairs:
    """All pairs by LAPACK's dense symmetric solver, component by component.

    Assumes nothing and never fails. It costs O(d^3) time and d^2 memory.

    Examples:
        >>> from graphrqi.graph import TrafficGraph
        >>> ring = TrafficGraph.from_edges([0, 1, 2], [(0, 1), (1, 2), (2, 0)])
        >>> eigh(ring, 2).eigenvalues.round(6).tolist()
        [3.0, 3.0]
    """
    return problem.dense()


@eigensolver()
def svd(problem: Problem) -> Pairs:
    """The singular value decomposition by LAPACK, as the paper's table has it.

    A Laplacian is symmetric and positive semidefinite, so its singular values are its eigenvalues.
    It costs a few times what `eigh` costs, since it does not use the symmetry.
    """
    vectors, values, _ = np.linalg.svd(problem.graph.laplacian.toarray())
    return Pairs(*problem.chosen(values, vectors), complete=True)


@eigensolver(dense_share=2)
def arpack(problem: Problem) -> Pairs:
    """Implicitly restarted Lanczos iterations, from the sum of the earlier vectors.

    The largest end needs products with L only, the smallest one a sparse LU factorisation of
    L + s I. Costs some tens of products or solves, plus O(d k^2). It drops pairs without notice
    where twins or equal components repeat an eigenvalue.
    """
    from scipy.sparse import csc_array, eye_array
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

    laplacian, k = problem.graph.laplacian, problem.num_pairs
    d = problem.graph.ids.size
    start = problem.starting_block().sum(axis=1)
    rng = np.random.default_rng(0)  # for restarts; scipy's own differs from call to call
    goal = 0.1 * problem.tol
    note = ""
    try:
        if problem.end == "largest":
            values, vectors = eigsh(laplacian, k, which="LA", v0=start, tol=goal, rng=rng)
        else:
            shift = SHIFT * problem.scale
            factor = splu(csc_array(laplacian + shift * eye_array(d)))

            def inverse(x: Floats) -> Floats:
                y: Floats = factor.solve(x)
                return y

            operator = LinearOperator((d, d), matvec=inverse, dtype=np.float64)
            _, vectors = eigsh(operator, k, which="LA", v0=start, tol=goal, rng=rng)
            values = np.einsum("ij,ij->j", vectors, laplacian @ vectors)
            note = f"shift {shift:.1e} below the spectrum"
    except ArpackError as error:
        return problem.dense(f"solved anew: {error}")
    values, vectors = problem.chosen(values, vectors)
    return Pairs(values, np.linalg.qr(vectors)[0], note=note)


@eigensolver(dense_share=5)
def lobpcg(problem: Problem) -> Pairs:
    """Locally optimal block conjugate gradients from the earlier vectors, converged or not.

    Needs products with L only: O((m + d k) k) per iteration. The smallest end of a long road would
    take hundreds of iterations. It does not see an eigenvalue outside the span of the last vectors.
    """
    from scipy.linalg import LinAlgWarning
    from scipy.sparse.linalg import lobpcg as improved

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # not converged: the residuals say so
        warnings.simplefilter("ignore", LinAlgWarning)
        values, vectors = improved(
            problem.graph.laplacian,
            problem.starting_block(),
            tol=problem.tol * problem.scale,
            maxiter=MAX_ITERATIONS,
            largest=problem.end == "largest",
        )
    values, vectors = problem.chosen(np.asarray(values, dtype=np.float64), np.asarray(vectors))
    return Pairs(values, np.linalg.qr(vectors)[0])


@eigensolver(dense_share=2)
def truncated_svd(problem: Problem) -> Pairs:
    """scikit-learn's randomised range finder with power iterations, without a warm start.

    Built for matrices whose singular values fall off quickly. A traffic graph's do not, so large
    residuals are left. The smallest end works on s I - L, where s bounds the spectrum.
    """
    from scipy.sparse import eye_array
    from sklearn.decomposition import TruncatedSVD

    graph, k = problem.graph, problem.num_pairs
    matrix: Any = graph.laplacian
    if problem.end == "smallest":
        # a little above the spectrum: at its edge a wanted pair would be 0 as the null space is
        bound = 2.1 * problem.scale
        matrix = bound * eye_array(graph.ids.size, format="csr") - matrix
    with np.errstate(invalid="ignore"):  # it also divides by the variance, 0 without edges
        model = TruncatedSVD(k, n_iter=POWER_ITERATIONS, random_state=0).fit(matrix)
    vectors, _ = np.linalg.qr(model.components_.T)
    values = np.einsum("ij,ij->j", vectors, graph.laplacian @ vectors)
    return Pairs(*problem.chosen(values, vectors))
