"""The certificate: a count of the eigenvalues says whether an answer of any solver is complete.

References:
    Parlett (1998), The Symmetric Eigenvalue Problem, section 3.3 (Sylvester's law of inertia).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graphrqi.spectrum.contract import Pairs, Spectrum, answer, laplacian_scale

MAX_WORK = 1e9
"""Multiplications of a factorisation above which none is tried (a few seconds)."""


def certify(spectrum: Spectrum, tol: float = 1e-8) -> Spectrum:
    """Count eigenvalues, and say whether a solver's answer is complete.

    Args:
        spectrum: k pairs from any solver.
        tol: residual up to which pairs count as converged, relative to max(1, lambda_max).

    Returns:
        The same pairs, certified if they are converged, orthonormal, and a count of the eigenvalues
        beyond the last one finds no more than they are. The answer stays uncertified if a rounding
        error in the count could matter.
    """
    from graphrqi.spectrum.certified.factorization import Counts, Factor, factor_and_solve, prepare

    graph = spectrum.graph
    values, vectors = spectrum.eigenvalues, spectrum.eigenvectors
    measured = answer(graph, Pairs(values, vectors, True, spectrum.note), spectrum.end, tol)
    k, d = values.size, graph.ids.size
    if not measured.certified or k == 0:
        return measured
    scale = laplacian_scale(graph)
    matrix = prepare(graph)
    if matrix.work > MAX_WORK:
        return replace(measured, certified=False)
    away = -1.0 if spectrum.end == "largest" else 1.0
    floor = 1e-13 * scale
    last = values.min() if spectrum.end == "largest" else values.max()
    delta = min(tol * scale, max(floor, 1e-2 * abs(last)))
    steps = np.array([1e-4, 1e-5, 1e-6, 1e-7, 1e-8, -0.5 * delta / scale, 3e-4, 1e-3]) * scale
    counts = Counts(*np.empty((3, 1, 8)))
    counts.shift[0] = last + away * steps
    factor = Factor(np.empty((matrix.entries.size, 8)), np.empty((d, 8)), np.empty((d, 8)))
    factor_and_solve(matrix, counts, 1e-15 * scale, 0, factor, np.zeros((d, 8)))
    complete = False
    for s, n, g in zip(counts.shift[0], counts.above[0], counts.growth[0], strict=True):
        error = 4.0 * 2.2e-16 * g
        if (np.abs(values - s) <= error + measured.residuals).any():
            continue
        if spectrum.end == "largest":
            same = int((values > s).sum()) == int(n)
            beyond = s + error <= last + delta
        else:
            same = int((values < s).sum()) == d - int(n)
            beyond = s - error >= last - delta
        complete = complete or (same and bool(beyond))
    pairs = Pairs(values, vectors, complete, spectrum.note, spectrum.carried)
    return answer(graph, pairs, spectrum.end, tol)
