"""The compiled walk down decision trees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled


@compiled
def sum_of_leaves(
    features: NDArray[np.float64],
    root: NDArray[np.int64],
    feature: NDArray[np.int32],
    threshold: NDArray[np.float64],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    value: NDArray[np.float32],
    out: NDArray[np.float64],
) -> None:
    """Add up the leaves that each sample falls into.

    Args:
        features: (n, F).
        root: (B,) node at which each tree begins.
        feature: (N,) feature asked at a node; -1 at a leaf.
        threshold: (N,) a value at most this goes left.
        left: (N,) node to the left.
        right: (N,) node to the right.
        value: (N, C) what a leaf adds.
        out: (n, C) receives the sums; must be zero before.
    """
    for i in range(features.shape[0]):
        for b in range(root.size):
            node = root[b]
            while feature[node] >= 0:
                goes_left = features[i, feature[node]] <= threshold[node]
                node = left[node] if goes_left else right[node]
            for c in range(out.shape[1]):
                out[i, c] += value[node, c]
