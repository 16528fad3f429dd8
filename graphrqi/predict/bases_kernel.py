"""The compiled loop behind `graphrqi.predict.bases`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled


@compiled
def inertia(
    speed: NDArray[np.float64],
    accel: NDArray[np.float64],
    time_s: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Everyone straight on at constant acceleration; who brakes stops and stays.

    Args:
        speed: (n,) m/s.
        accel: (n,) m/s2.
        time_s: (J,) from now, s.
        out: (n, J, 2) receives the places ahead and to the left, m.
    """
    for i in range(speed.size):
        stops_s = -speed[i] / accel[i] if accel[i] < 0.0 else math.inf
        for j in range(time_s.size):
            moving_s = min(time_s[j], stops_s)
            out[i, j, 0] = speed[i] * moving_s + 0.5 * accel[i] * (moving_s * moving_s)
            out[i, j, 1] = 0.0


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
