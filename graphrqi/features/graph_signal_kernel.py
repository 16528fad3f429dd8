"""The compiled loop behind `graphrqi.features.graph_signal`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


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
    out, level, mean = np.empty((n, scales)), np.empty(n), np.empty(n)
    for i in range(n):
        level[i] = signal[i] if known[i] else 0.0
    for scale in range(scales):
        for i in range(n):
            total, weighted = 0.0, 0.0
            for e in range(indptr[i], indptr[i + 1]):
                j = indices[e]
                if j != i and known[j]:
                    total -= values[e]
                    weighted -= values[e] * level[j]
            mean[i] = weighted / total if total > 0.0 else level[i]
            out[i, scale] = level[i] - mean[i] if total > 0.0 and known[i] else np.nan
        for i in range(n):
            level[i] = mean[i]
    return out
