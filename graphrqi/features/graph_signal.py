"""Graph signals: how each driver differs from its neighbours in the traffic graph.

For a signal s on the vertices (speed, sideways movement), the random-walk Laplacian gives
(D^-1 L s)_i = s_i - mean of s over i's neighbours. Filtering by powers of P = D^-1 A first
compares wider and wider neighbourhoods: P^j s - P^(j+1) s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def differences(
    adjacency: csr_array, signal: FloatArray, taking_part: BoolArray, scales: int = 2
) -> FloatArray:
    """Difference of a signal from its neighbourhood, at several scales.

    Args:
        adjacency: (n, n) CSR, non-negative weights.
        signal: (n,) values; NaN where unknown.
        taking_part: (n,) vertices that count as neighbours (drivers, not pedestrians).
        scales: how many scales.

    Returns:
        (n, scales) column j is P^j s - P^(j+1) s; NaN where the signal is unknown or there is no
        neighbour.

    Examples:
        >>> path = csr_array(np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=float))
        >>> differences(path, np.array([1.0, 2.0, 6.0]), np.ones(3, bool), scales=1).ravel()
        array([-1. , -1.5,  4. ])
    """
    known = taking_part & ~np.isnan(signal)
    weight = known.astype(np.float64)
    total = adjacency @ weight
    lonely = total <= 0
    level = np.where(known, signal, 0.0)
    out = np.empty((signal.size, scales))
    for scale in range(scales):
        mean = (adjacency @ (level * weight)) / np.where(lonely, 1.0, total)
        mean = np.where(lonely, level, mean)
        out[:, scale] = level - mean
        level = mean
    out[~known | lonely] = np.nan
    return out
