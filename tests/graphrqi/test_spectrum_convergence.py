"""Plain Rayleigh-quotient iterations from the graph before converge cubically on the one after."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from experiments.benchmarks.spectrum import graph_sequence

VECTORS = 8
D = 100


def residuals(matrix: np.ndarray, x: np.ndarray) -> list[float]:
    """Residuals over the largest eigenvalue, before and after each of six iterations."""
    size, path = float(np.linalg.norm(matrix, 2)), []
    for _ in range(7):
        mu = float(x @ matrix @ x)
        path.append(float(np.linalg.norm(matrix @ x - mu * x)) / size)
        try:
            x = np.linalg.solve(matrix - mu * np.eye(len(matrix)), x)
        except np.linalg.LinAlgError:  # mu is an eigenvalue to the last bit
            break
        x = x / np.linalg.norm(x)
    return path + [path[-1]] * (7 - len(path))


@pytest.mark.parametrize("layout", ["road", "crossing"])
def test_plain_iterations_converge_cubically(layout: str) -> None:
    paths, orders = [], []
    for before, after in pairwise(graph_sequence(layout, "instantaneous", D, 6)):
        matrix = after.laplacian.toarray()
        _, old = np.linalg.eigh(before.laplacian.toarray())
        for column in range(D - 1, D - 1 - VECTORS, -1):
            path = residuals(matrix, old[:, column])
            paths.append(path)
            orders += [  # the last triple that rounding lets one see
                np.log(c / b) / np.log(b / a)
                for a, b, c in zip(path[:-2], path[1:-1], path[2:], strict=True)
                if 1e-13 < c < b < a < 0.1
            ][-1:]
    after_n = np.median(np.array(paths), axis=0)
    assert after_n[3] < 1e-5 * after_n[0]
    assert 2.5 <= np.median(orders) <= 3.5
