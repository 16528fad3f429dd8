"""The compiled loops behind `graphrqi.predict.scene.stop_constraints`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled
from sim.road import lane_search


@compiled
def close_crossing(
    line: NDArray[np.float64],
    width: float,
    xy: NDArray[np.float64],
    heading: NDArray[np.float64],
    speed: NDArray[np.float64],
    gates: NDArray[np.int64],
    centre: NDArray[np.float64],
    half: NDArray[np.float64],
    reach_s: float,
    step_s: float,
    state: int,
    closed: NDArray[np.int8],
) -> None:
    """Close the gates of one crossing while pedestrians are in the way or about to be.

    Args:
        line: (P, 2) the crossing's centre line, m.
        width: its width, m.
        xy: (p, 2) pedestrians, m.
        heading: (p,) rad.
        speed: (p,) m/s.
        gates: (z,) rows of ``closed`` that belong to it.
        centre: (z,) where along the crossing each gate's lane has its centre, m.
        half: (z,) half of the lane's width, m.
        reach_s: who will be in a lane within this time blocks it already, s.
        step_s: time between columns of ``closed``, s.
        state: what a closed gate is.
        closed: (Z, H + 1) receives it.
    """
    for p in range(len(xy)):
        x, y = xy[p, 0], xy[p, 1]
        u, across, total = lane_search.along_at(line, x, y)
        if not (abs(across) <= width / 2 + 1.0 and -0.5 < u < total + 0.5):
            continue
        ahead, _, _ = lane_search.along_at(line, x + math.cos(heading[p]), y + math.sin(heading[p]))
        pace = (ahead - u) * speed[p]
        way = np.sign(pace)
        for h in range(closed.shape[1]):
            at = u + pace * (h * step_s)
            if not -0.5 < at < total + 0.5:
                continue
            for z in range(gates.size):
                left = (centre[z] - at) * way
                coming = left > 0 and left - half[z] <= abs(pace) * reach_s
                if coming or abs(centre[z] - at) <= half[z]:
                    closed[gates[z], h] = state
