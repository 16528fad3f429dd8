"""The time from positions to features, ours and the usual way."""

from __future__ import annotations

import time
from typing import Any, cast

import numpy as np

from experiments.benches.spectrum.costs import DENSE_UP_TO
from experiments.benches.spectrum.rows import Row, median_row
from experiments.benches.spectrum.sequences import Floats, traffic
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS, Spectrum


def path_rows(
    layout: str, kind: str, d: int, pairs: int, steps: int, seed: int, budget_s: float
) -> list[Row]:
    """Time the whole way from positions to features, ours and the usual one."""
    graph = TrafficGraph.empty(neighbors=4, reset=100, kind=cast(Any, kind))
    usual = _UsualPath(kind, d)
    spectrum: Spectrum | None = None
    cpu: dict[str, list[float]] = {"positions-to-features": [], "positions-to-features-scipy": []}
    for step, (ids, xy) in enumerate(traffic(layout, d, 98, seed)):
        measured = step >= 98 - steps
        begin = time.process_time()
        graph = graph.observe(ids, xy)
        if measured or step >= 96 - steps:
            spectrum = SOLVERS["graphrqi"](graph, pairs, "largest", spectrum)
            cheap_features(spectrum.eigenvalues, spectrum.eigenvectors)
        if measured:
            cpu["positions-to-features"].append(1e3 * (time.process_time() - begin))
        begin = time.process_time()
        matrix = usual.observe(xy)
        slow = cpu["positions-to-features-scipy"]
        if measured and d <= DENSE_UP_TO and (not slow or sum(slow) < 1e3 * budget_s):
            values, vectors = np.linalg.eigh(matrix)
            cheap_features(values[: -pairs - 1 : -1], vectors[:, : -pairs - 1 : -1])
            slow.append(1e3 * (time.process_time() - begin))
    rows = []
    for name, times in cpu.items():
        if times:
            key = {"solver": name, "d": d, "graph": layout, "kind": kind, "end": "largest"}
            rows.append(median_row(key, "cpu_ms", times))
    return rows


def cheap_features(values: Floats, vectors: Floats) -> Floats:
    """Sizes of the eigenvectors' rows and two heat kernels.

    Args:
        values: (k,) eigenvalues.
        vectors: (d, k) eigenvectors.

    Returns:
        (d, k + 2) |u| and the sums over pairs of u^2 exp(-t lambda), t = 0.1 and 1.
    """
    kernels = np.exp(-np.outer(values, (0.1, 1.0)))
    return np.hstack([np.abs(vectors), vectors**2 @ kernels])


class _UsualPath:
    """Positions to a dense Laplacian with cKDTree, numpy and scipy."""

    def __init__(self, kind: str, d: int) -> None:
        self.kind, self.d = kind, d
        self.kept = np.empty(0, np.int64)

    def observe(self, xy: Floats) -> Floats:
        from scipy.sparse import csr_array, diags_array
        from scipy.spatial import cKDTree

        _, near = cKDTree(xy).query(xy, k=5)
        rows = np.repeat(np.arange(self.d), 4)
        columns = np.asarray(near, dtype=np.int64)[:, 1:].ravel()
        pairs = np.minimum(rows, columns) * self.d + np.maximum(rows, columns)
        self.kept = np.union1d(self.kept, pairs) if self.kind == "accumulated" else np.unique(pairs)
        i, j = self.kept // self.d, self.kept % self.d
        ones = np.ones(2 * i.size)
        shape = (self.d, self.d)
        a = csr_array((ones, (np.concatenate([i, j]), np.concatenate([j, i]))), shape=shape)
        laplacian: Any = diags_array(a.sum(axis=1)) - a
        return laplacian.toarray() if self.d <= DENSE_UP_TO else np.empty((0, 0))
