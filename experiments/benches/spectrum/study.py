"""Comparing a solver with LAPACK on graphs that eigenvalue algorithms get wrong."""

from __future__ import annotations

import numpy as np

from experiments.benches.spectrum.rows import Row, plain_row
from experiments.benches.spectrum.sequences import Floats, hostile_graphs
from graphrqi.spectrum import SOLVERS, Spectrum
from graphrqi.spectrum.subspaces import null_space


def study_rows(count: int, largest: int) -> list[Row]:
    """Compare our solver with LAPACK on hostile graphs.

    Args:
        count: graphs.
        largest: vehicles of the largest.

    Returns:
        Flat rows as of `run_spectrum_bench`, with ``d`` the largest: ``wrong_answers``,
        ``uncertified``, ``fallbacks``, ``eigenvalue_error_max`` and ``residual_max`` (both
        relative to max(1, lambda_max)), ``orthonormality_error_max``.
    """
    solve = SOLVERS["graphrqi"]
    last: dict[str, Spectrum] = {}
    wrong = uncertified = fallbacks = 0
    worst = np.zeros(3)
    for graph, k, end, nonzero, warm in hostile_graphs(count, largest, 0):
        found = solve(graph, k, end, last.get(end) if warm else None, 1e-8, nonzero)
        last[end] = found
        errors = errors_against_lapack(found, k, nonzero)
        worst = np.maximum(worst, errors)
        wrong += bool(errors[0] > 1e-8 or errors[1] > 1e-8 or errors[2] > 1e-9)
        uncertified += not found.certified
        fallbacks += found.note.startswith("fell back")
    key = {"solver": "graphrqi", "d": largest, "graph": "hostile", "kind": "mixed", "end": "both"}
    return [
        plain_row(key, "wrong_answers", wrong, count),
        plain_row(key, "uncertified", uncertified, count),
        plain_row(key, "fallbacks", fallbacks, count),
        plain_row(key, "eigenvalue_error_max", worst[0], count),
        plain_row(key, "residual_max", worst[1], count),
        plain_row(key, "orthonormality_error_max", worst[2], count),
    ]


def errors_against_lapack(found: Spectrum, num_pairs: int, nonzero: bool) -> Floats:
    """How far an answer is from right.

    Args:
        found: the answer.
        num_pairs: pairs that were asked for.
        nonzero: whether the null space was to be left out.

    Returns:
        (3,) largest eigenvalue error and residual, relative to max(1, lambda_max), and largest
        departure from orthonormality; infinite where the number of pairs is wrong.
    """
    matrix = found.graph.laplacian.toarray()
    right: Floats = np.linalg.eigvalsh(matrix) if matrix.size else np.zeros(0)
    scale = max(1.0, float(right.max(initial=0.0)))
    if nonzero:
        right = right[null_space(found.graph).shape[1] :]
    right = (right[::-1] if found.end == "largest" else right)[:num_pairs]
    values, vectors = found.eigenvalues, found.eigenvectors
    if values.shape != right.shape or vectors.shape != (len(matrix), right.size):
        return np.full(3, np.inf)
    gram = vectors.T @ vectors - np.eye(right.size)
    return np.array(
        [
            np.abs(values - right).max(initial=0.0) / scale,
            np.linalg.norm(matrix @ vectors - vectors * values, axis=0).max(initial=0.0) / scale,
            np.abs(gram).max(initial=0.0),
        ]
    )
