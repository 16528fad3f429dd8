"""Look ids up in an ascending array of ids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def find(known: IntArray, ids: IntArray) -> tuple[IntArray, BoolArray]:
    """Places of ids in an ascending array, and which of them stand there.

    Args:
        known: (m,) ascending ids.
        ids: (n,) ids, in any order.

    Returns:
        (n,) index into `known` of each id that stands there (of another one's where it does not),
        and (n,) whether it stands there.

    Examples:
        >>> find(np.array([2, 5, 9]), np.array([5, 7, 10]))
        (array([1, 2, 2]), array([ True, False, False]))
        >>> find(np.array([], dtype=int), np.array([5]))
        (array([0]), array([False]))
    """
    if known.size == 0:
        return np.zeros(ids.size, dtype=np.int64), np.zeros(ids.size, dtype=bool)
    at = np.minimum(np.searchsorted(known, ids), known.size - 1)
    return at, known[at] == ids
