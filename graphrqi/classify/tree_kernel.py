"""The compiled evaluation of decision trees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.classify.simd import WIDTH, all_bits, first_bits, keep_where_above
from sim.compiled import compiled


@compiled
def sum_of_leaves(
    features: NDArray[np.float32],
    root: NDArray[np.uint32],
    depth: NDArray[np.uint32],
    column: NDArray[np.uint32],
    feature: NDArray[np.uint16],
    threshold: NDArray[np.float32],
    child: NDArray[np.uint32],
    value: NDArray[np.float32],
    out: NDArray[np.float64],
) -> None:
    """Add up the leaves that each sample falls into; see `graphrqi.classify.trees.Trees`.

    Every sample takes as many steps in a tree as the tree is deep (a leaf leads to itself), and a
    batch of samples takes each step together: there are no branches to predict, and the steps of
    different samples overlap. Unsigned indices need no check for negative ones. This is six times
    as fast as one sample after another.

    Args:
        features: (n, F).
        root: (B,).
        depth: (B,).
        column: (B,).
        feature: (N,).
        threshold: (N,).
        child: (N,).
        value: (N, W).
        out: (n, C) receives the sums; must be zero before.
    """
    batch = 64
    node = np.empty(batch, dtype=np.uint32)
    for begin in range(0, features.shape[0], batch):
        count = min(batch, features.shape[0] - begin)
        for b in range(root.size):
            for j in range(count):
                node[j] = root[b]
            for _ in range(depth[b]):
                for j in range(count):
                    k = node[j]
                    above = features[np.uint32(begin + j), feature[k]] > threshold[k]
                    node[j] = child[k] + np.uint32(above)
            for j in range(count):
                for w in range(value.shape[1]):
                    out[np.uint32(begin + j), column[b] + np.uint32(w)] += value[node[j], w]


@compiled
def sum_of_first_leaves(
    features: NDArray[np.float32],
    first: NDArray[np.uint64],
    feature: NDArray[np.uint64],
    threshold: NDArray[np.float32],
    keep: NDArray[np.uint32],
    leaf: NDArray[np.float64],
    column: NDArray[np.uint64],
    out: NDArray[np.float64],
) -> None:
    """Add up the leaves that each sample falls into; see `graphrqi.classify.trees.QuickScorer`.

    Args:
        features: (K * F, 64) of K batches of 64 samples, feature by feature.
        first: (B + 1,).
        feature: (I,).
        threshold: (I,).
        keep: (I,).
        leaf: (B, 32).
        column: (B,).
        out: (K, C, 64) receives the sums; must be zero before.
    """
    place = np.empty(WIDTH, dtype=np.uint32)
    batch = np.uint64(len(features) // max(len(out), 1))
    for k in range(np.uint64(len(out))):
        for b in range(np.uint64(first.size - 1)):
            reachable = all_bits()
            for i in range(first[b], first[b + np.uint64(1)]):
                row = k * batch + feature[i]
                reachable = keep_where_above(reachable, features, row, threshold[i], keep[i])
            first_bits(reachable, place)
            values, total = leaf[b], out[k, column[b]]
            for j in range(WIDTH):
                total[j] += values[place[j]]
