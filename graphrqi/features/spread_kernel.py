"""The compiled loop behind `graphrqi.features.statistics.spread`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled


@compiled
def spread_on_nodes(
    values: NDArray[np.float64],
    counts: NDArray[np.bool_],
    nodes: NDArray[np.float64],
    starts: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    """Spread each counted value over the two nodes of its block that it lies between.

    Args:
        values: (B, n).
        counts: (B, n).
        nodes: (S,) ascending within each block.
        starts: (B + 1,) where each block's nodes begin.
        out: (n, S) receives the weights.
    """
    for b in range(values.shape[0]):
        first, last = starts[b], starts[b + 1] - 1
        for i in range(values.shape[1]):
            if not counts[b, i]:
                continue
            value = values[b, i]
            if value <= nodes[first]:
                out[i, first] = 1.0
            elif value >= nodes[last]:
                out[i, last] = 1.0
            else:
                upper = first + 1
                while nodes[upper] < value:
                    upper += 1
                share = (value - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1])
                out[i, upper - 1] = 1.0 - share
                out[i, upper] = share
