"""The compiled loop behind `graphrqi.features.graph_signal`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled


@compiled
def differences(
    indptr: NDArray[np.int32],
    indices: NDArray[np.int32],
    values: NDArray[np.float64],
    signal: NDArray[np.float64],
    known: NDArray[np.bool_],
    scales: int,
) -> NDArray[np.float64]:
    """Difference of a signal from its neighbourhood; see `graphrqi.features.graph_signal`.

    Args:
        indptr: (n + 1,) row starts of the Laplacian.
        indices: (z,) its columns.
        values: (z,) its values.
        signal: (n,) values.
        known: (n,) vertices that count.
        scales: how many scales.

    Returns:
        (n, scales); NaN where the vertex does not count or has no neighbour that does.
    """
    n = signal.size
    out = np.full((n, scales), np.nan)
    level, mean = np.where(known, signal, 0.0), np.empty(n)
    for scale in range(scales):
        for i in range(n):
            total, weighted = 0.0, 0.0
            for e in range(indptr[i], indptr[i + 1]):
                j = indices[e]
                if j != i and known[j]:
                    total -= values[e]
                    weighted -= values[e] * level[j]
            if total > 0.0:
                mean[i] = weighted / total
                if known[i]:
                    out[i, scale] = level[i] - mean[i]
            else:
                mean[i] = level[i]
        level[:] = mean
    return out
