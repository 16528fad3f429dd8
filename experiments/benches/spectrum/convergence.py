"""How fast plain Rayleigh-quotient iterations converge."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from experiments.benches.spectrum.rows import Row, median_row
from experiments.benches.spectrum.sequences import graph_sequence

VECTORS: Final = 8
"""Eigenvectors of each of five graphs that are followed: 40 in all."""


def convergence_rows(layout: str, d: int = 100) -> list[Row]:
    """Residuals of Rayleigh-quotient iterations, and the order they fall with.

    Plain iterations (one solution per shift) from eigenvectors of the graph before, on the graph
    after, both ends of the instantaneous graph's spectrum.

    Args:
        layout: one of `LAYOUTS`.
        d: vehicles.

    Returns:
        Rows of ``graphrqi``: ``residual_after_0`` to ``_6`` (medians) and
        ``order_of_convergence``: the median over vectors of log(r_{i+2} / r_{i+1}) /
        log(r_{i+1} / r_i) at the last i with r_i < 0.1 and r_{i+2} > 1e-13, r relative to the
        largest eigenvalue: as near to the limit as rounding lets one see.
    """
    paths, orders = [], []
    sequence = list(graph_sequence(layout, "instantaneous", d, 6, 0, 0))
    for before, after in pairwise(sequence):
        if not np.array_equal(before.ids, after.ids):  # somebody left the city, others came
            continue
        matrix = after.laplacian.toarray()
        _, old = np.linalg.eigh(before.laplacian.toarray())
        size = float(np.linalg.norm(matrix, 2))
        for column in range(d - 1, d - 1 - VECTORS, -1):
            x = old[:, column]
            path = []
            for _ in range(7):
                mu = float(x @ matrix @ x)
                path.append(float(np.linalg.norm(matrix @ x - mu * x)) / size)
                try:
                    x = np.linalg.solve(matrix - mu * np.eye(d), x)
                except np.linalg.LinAlgError:  # mu is an eigenvalue to the last bit
                    break
                x = x / np.linalg.norm(x)
            paths.append(path + [path[-1]] * (7 - len(path)))
            orders += [
                np.log(c / b) / np.log(b / a)
                for a, b, c in zip(path[:-2], path[1:-1], path[2:], strict=True)
                if 1e-13 < c < b < a < 0.1
            ][-1:]
    key = {
        "solver": "graphrqi",
        "d": d,
        "graph": layout,
        "kind": "instantaneous",
        "end": "largest",
    }
    table = np.array(paths)
    rows = [
        median_row(key, f"residual_after_{i}", table[:, i].tolist()) for i in range(table.shape[1])
    ]
    if orders:
        rows.append(median_row(key, "order_of_convergence", orders))
    return rows
