"""The compiled loop behind `graphrqi.predict.learned.anchors`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


@compiled
def relative(
    bases: NDArray[np.float64],
    which: NDArray[np.int64],
    speed: NDArray[np.float64],
    time_s: NDArray[np.float64],
    scale_m: float,
) -> NDArray[np.float64]:
    """(n, W J 2) some of the rollouts (n, B, J, 2) against constant velocity, in their scale."""
    n, _, knots, _ = bases.shape
    out = np.empty((n, which.size, knots, 2))
    for i in range(n):
        for w in range(which.size):
            for j in range(knots):
                here = bases[i, which[w], j]
                out[i, w, j, 0] = (here[0] - speed[i] * time_s[j]) / scale_m
                out[i, w, j, 1] = here[1] / scale_m
    return out.reshape(n, which.size * knots * 2)
