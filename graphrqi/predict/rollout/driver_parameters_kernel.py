"""The compiled loop behind `graphrqi.predict.rollout.driver_parameters`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


@compiled
def personal(
    following: NDArray[np.float64],
    free_factor: NDArray[np.float64],
    least_factor: NDArray[np.float64],
    weight: float,
) -> NDArray[np.float64]:
    """(M, n, F) numbers, the wished speeds corrected by what was driven.

    Args:
        following: (M, n, F), or (M, 1, F) if the same for all; the first is the wished speed over
            the limit.
        free_factor: (n,) speed over limit driven freely; NaN if never.
        least_factor: (n,) largest speed over limit.
        weight: of the wished speed given against the one driven freely.
    """
    ways, given, numbers = following.shape
    n = free_factor.size
    out = np.empty((ways, n, numbers))
    for m in range(ways):
        for i in range(n):
            of = i if given == n else 0
            for f in range(numbers):
                out[m, i, f] = following[m, of, f]
            if not math.isnan(free_factor[i]):
                shown = math.log(max(free_factor[i], 0.1))
                wished = math.log(following[m, of, 0])
                out[m, i, 0] = math.exp((weight * wished + shown) / (1.0 + weight))
            out[m, i, 0] = max(out[m, i, 0], least_factor[i])
    return out
