"""The compiled walk down decision trees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled

SPELL = 0x077CB531
"""De Bruijn's: the upper five bits of its product with a power of two tell that one apart."""

BIT_PLACE: NDArray[np.int64] = (SPELL << np.arange(32) & 0xFFFFFFFF) >> 27
"""(32,) those five bits for each power."""


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
    """Add up the leaves that each sample falls into.

    Every sample takes as many steps in a tree as the tree is deep (a leaf leads to itself), and a
    batch of samples takes each step together, so that nothing is left for the processor to guess
    and its steps do not wait for one another. Unsigned indices spare a look at their sign. Six
    times as quick as following one sample after another.

    Args:
        features: (n, F).
        root: (B,) node at which each tree begins.
        depth: (B,) steps from there to the deepest leaf.
        column: (B,) of the sums that the first of a leaf's values adds to.
        feature: (N,) feature asked at a node.
        threshold: (N,) a value above this goes to the second child; infinite at a leaf.
        child: (N,) first child, the second comes next; a leaf is its own.
        value: (N, W) what a leaf adds.
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
    first: NDArray[np.int64],
    feature: NDArray[np.int64],
    threshold: NDArray[np.float32],
    keep: NDArray[np.uint32],
    leaf: NDArray[np.float32],
    column: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    """Add up the leaves that each sample falls into; see `graphrqi.classify.trees.ShortTrees`.

    Args:
        features: (K, F, b) of K batches of b samples.
        first: (B + 1,) where each tree's inner nodes begin, and the last's end.
        feature: (I,) feature asked at an inner node.
        threshold: (I,) above it the answer is yes.
        keep: (I,) bits of the leaves that are then still in reach.
        leaf: (B, 32) what each leaf adds, in the order of ``BIT_PLACE``.
        column: (B,) of the sum that the tree adds to.
        out: (K, C, b) receives the sums; must be zero before.
    """
    every, one = np.uint32(0xFFFFFFFF), np.uint32(1)
    spell, shift = np.uint32(SPELL), np.uint32(27)
    left = np.empty(features.shape[2], dtype=np.uint32)
    for k in range(features.shape[0]):
        for b in range(first.size - 1):
            left[:] = every
            for i in range(first[b], first[b + 1]):
                row, limit, kept = features[k, feature[i]], threshold[i], keep[i]
                for j in range(left.size):
                    left[j] &= kept if row[j] > limit else every
            values, total = leaf[b], out[k, column[b]]
            for j in range(left.size):
                lowest = np.uint32(left[j] & (~left[j] + one))
                total[j] += values[np.uint32(lowest * spell) >> shift]
