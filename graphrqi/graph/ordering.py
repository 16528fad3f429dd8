"""Cuthill-McKee order of a graph's rows, and its connected components.

References:
    Cuthill, McKee (1969), Reducing the bandwidth of sparse symmetric matrices, Proc. 24th ACM
    Conf., 157-172.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled

Ints: TypeAlias = NDArray[np.int32]


@compiled
def order_rows(indptr: Ints, indices: Ints) -> tuple[Ints, Ints, int]:
    """Cuthill-McKee order and connected components.

    Args:
        indptr: (d + 1,) row starts of a symmetric pattern.
        indices: its columns.

    Returns:
        (d,) row at each place of the order, to be reversed for elimination; (d,) component of
        each row; number of components.
    """
    d = indptr.size - 1
    order, label = np.empty(d, np.int32), np.empty(d, np.int32)
    degree, walked = np.empty(d, np.int32), np.empty(d, np.int32)
    for i in range(d):
        walked[i] = 0
    first = count = 0
    for seed in range(d):
        if walked[seed] > 0:
            continue
        root = seed
        for walk in range(1, 4):  # twice towards the rim, then for good
            order[first], walked[root] = root, walk
            head, tail = first, first + 1
            while head < tail:
                i = order[head]
                label[i] = count
                head += 1
                begin = tail
                for p in range(indptr[i], indptr[i + 1]):
                    j = indices[p]
                    if walked[j] < walk:
                        walked[j] = walk
                        degree[j] = indptr[j + 1] - indptr[j]
                        q = tail
                        while q > begin and degree[order[q - 1]] > degree[j]:
                            order[q] = order[q - 1]
                            q -= 1
                        order[q] = j
                        tail += 1
            root = order[tail - 1]
        first = tail
        count += 1
    return order, label, count
