"""The compiled evaluation of decision trees, for many samples at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place

WIDTH = 64
"""Samples that are processed together. The loops over them are of this constant length, so that the
compiler makes vector instructions of them."""

ALL = np.uint32(0xFFFFFFFF)


@in_place()
def sum_of_leaves(
    features: NDArray[np.float32],
    first: NDArray[np.int64],
    feature: NDArray[np.int64],
    threshold: NDArray[np.float32],
    keep: NDArray[np.uint32],
    leaf: NDArray[np.float64],
    column: NDArray[np.int64],
    reachable: NDArray[np.uint32],
    out: NDArray[np.float64],
) -> None:
    """Add up the leaves that each sample falls into; see `graphrqi.classify.trees`.

    ``features`` is (K * F, 64), batch by batch of samples. ``leaf`` is indexed by the hash of a
    leaf's bit. ``reachable`` (64,) is overwritten. ``out`` (K, C, 64) must be zero.
    """
    width = len(features) // max(len(out), 1)
    for k in range(len(out)):
        for b in range(column.size):
            for j in range(WIDTH):
                reachable[j] = ALL
            for i in range(first[b], first[b + 1], 2):  # two at once: half the memory traffic
                n = min(i + 1, first[b + 1] - 1)
                values, others = features[k * width + feature[i]], features[k * width + feature[n]]
                limit, kept, other_limit, other_kept = threshold[i], keep[i], threshold[n], keep[n]
                for j in range(WIDTH):
                    one = kept if values[j] > limit else ALL
                    other = other_kept if others[j] > other_limit else ALL
                    reachable[j] &= one & other
            leaves, total = leaf[b], out[k, column[b]]
            for j in range(WIDTH):
                lowest = reachable[j] & np.uint32(-np.int64(reachable[j]))
                total[j] += leaves[np.uint32(lowest * np.uint32(0x077CB531)) >> np.uint32(27)]
