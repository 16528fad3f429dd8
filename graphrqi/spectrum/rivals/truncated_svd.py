"""scikit-learn's TruncatedSVD: a randomised range finder with power iterations.

Built for matrices whose singular values fall off quickly. A traffic graph's do not, so that five
power iterations leave large residuals. At the smallest end it works on s I - L, where s bounds the
spectrum, whose largest eigenvalues lie closer still. Costs O((m + d k) k) per power iteration.

References:
    Halko, Martinsson, Tropp (2011), Finding structure with randomness, SIAM Review 53, 217.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from graphrqi.spectrum.contract import Pairs, Problem, eigensolver

POWER_ITERATIONS = 5
"""scikit-learn's own default."""


@eigensolver(dense_share=2)
def solve(problem: Problem) -> Pairs:
    """Approximate the pairs with ``sklearn.decomposition.TruncatedSVD``; it has no warm start."""
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
