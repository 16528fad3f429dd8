"""Graph signals: how each driver differs from its neighbours in the traffic graph.

For a signal s on the vertices (speed, sideways movement), the random-walk Laplacian gives
(D^-1 L s)_i = s_i - mean of s over i's neighbours. Filtering by powers of P = D^-1 A first
compares wider and wider neighbourhoods: P^j s - P^(j+1) s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def differences(
    graph: TrafficGraph, signal: FloatArray, taking_part: BoolArray, scales: int = 2
) -> FloatArray:
    """Difference of a signal from its neighbourhood, at several scales.

    Args:
        graph: of n vertices.
        signal: (n,) values; NaN where unknown.
        taking_part: (n,) vertices that count as neighbours (drivers, not pedestrians).
        scales: how many scales.

    Returns:
        (n, scales) column j is P^j s - P^(j+1) s; NaN where the signal is unknown or there is no
        neighbour.

    Examples:
        >>> path = TrafficGraph.from_edges([1, 2, 3], [(1, 2), (2, 3)])
        >>> differences(path, np.array([1.0, 2.0, 6.0]), np.ones(3, bool), scales=1).ravel()
        array([-1. , -1.5,  4. ])
    """
    from graphrqi.features.graph_signal_kernel import differences as compiled_differences

    known = taking_part & ~np.isnan(signal)
    return compiled_differences(graph.indptr, graph.indices, graph.values, signal, known, scales)
