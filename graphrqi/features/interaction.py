"""How a driver relates to its neighbours in the traffic graph.

`interactions` finds the vehicles ahead, behind and beside. Vehicle lengths are not known from
positions, so gaps are centre distances less one nominal car length.

`differences` compares a signal on the vertices (speed, sideways movement) with the neighbourhood.
The random-walk Laplacian gives (D^-1 L s)_i = s_i - mean of s over i's neighbours. Powers of P =
D^-1 A widen the neighbourhoods: P^j s - P^(j+1) s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from graphrqi.arrays import BoolArray, FloatArray, IntArray
from graphrqi.features.motion import Motion, along
from graphrqi.graph import TrafficGraph

NOMINAL_LENGTH_M: Final = 4.6
"""Length taken off centre distances (a European median car)."""

SAME_PATH_M: Final = 1.7
"""Sideways distance within which another is on the same path (half a lane, rounded up)."""

BESIDE_M: Final = 5.0
"""Sideways distance within which another is in the next lane (a lane and a half)."""

ABREAST_M: Final = 10.0
"""Distance along the direction of travel within which another is beside (two car lengths)."""

SAME_WAY: Final = 0.5
"""Least cosine between the directions of drivers that drive the same way (60 degrees)."""

PEDESTRIAN_AHEAD_M: Final = 30.0
"""Distance ahead within which a pedestrian counts (2.5 s at town speed)."""


@dataclass(frozen=True, slots=True)
class Interaction:
    """The neighbours of each vertex; NaN (or -1) where there is none.

    Attributes:
        leader: (n,) the nearest ahead on the same path, -1 if none.
        gap: (n,) to the leader, m; at least 0.
        leader_speed: (n,) m/s, along the follower's direction.
        follower: (n,) the nearest behind on the same path, -1 if none.
        rear_gap: (n,) m; at least 0.
        rear_speed: (n,) m/s, along the direction of the driver ahead of it.
        beside: (n,) number of drivers in the next lanes within ``ABREAST_M``.
        pedestrian_m: (n,) distance ahead of the nearest pedestrian near the path, m.
    """

    leader: IntArray
    gap: FloatArray
    leader_speed: FloatArray
    follower: IntArray
    rear_gap: FloatArray
    rear_speed: FloatArray
    beside: FloatArray
    pedestrian_m: FloatArray


def interactions(motion: Motion, drives: BoolArray, graph: TrafficGraph) -> Interaction:
    """Every driver's leader, follower and neighbours along the graph's edges.

    The n vertices are in the order of the graph; those that do not drive are pedestrians.
    """
    from graphrqi.features.kernels import find_around

    n = drives.size
    nearest, distance, beside = np.full((3, n), -1), np.full((3, n), np.inf), np.zeros(n)
    bounds = SAME_PATH_M, BESIDE_M, ABREAST_M, SAME_WAY, PEDESTRIAN_AHEAD_M
    # copies: kernels are compiled again for read-only arrays
    find_around(
        *graph.pairs, motion.xy.copy(), motion.direction, drives.copy(), bounds, nearest, distance,
        beside,
    )  # fmt: skip
    leader, follower, _ = nearest
    gap, rear_gap, pedestrian_m = np.where(nearest >= 0, distance, np.nan)
    leader_speed, rear_speed = (
        np.where(who >= 0, along(motion.direction, motion.velocity[who]), np.nan)
        for who in (leader, follower)
    )
    return Interaction(
        leader=leader,
        gap=np.maximum(gap - NOMINAL_LENGTH_M, 0.0),
        leader_speed=leader_speed,
        follower=follower,
        rear_gap=np.maximum(rear_gap - NOMINAL_LENGTH_M, 0.0),
        rear_speed=rear_speed,
        beside=beside,
        pedestrian_m=pedestrian_m,
    )


def differences(
    graph: TrafficGraph, signal: FloatArray, drives: BoolArray, scales: int = 2
) -> FloatArray:
    """(n, scales) difference of a signal from its neighbourhood: column j is P^j s - P^(j+1) s.

    Only vertices that drive count as neighbours. It is NaN where the signal is, and without
    neighbours.
    """
    counts = drives & ~np.isnan(signal)
    level = np.where(counts, signal, 0.0)
    row, other = graph.pairs
    row, other = row[counts[other]], other[counts[other]]
    total = np.bincount(row, minlength=signal.size)
    out = np.empty((signal.size, scales))
    for scale in range(scales):
        summed = np.bincount(row, level[other], signal.size)
        mean = np.where(total > 0, summed / np.maximum(total, 1), level)
        out[:, scale] = np.where((total > 0) & counts, level - mean, np.nan)
        level = mean
    return out


def neighbor_speed(motion: Motion, drives: BoolArray, graph: TrafficGraph) -> FloatArray:
    """(n,) mean speed of neighbours that drive the same way, m/s; NaN without one."""
    row, other = graph.pairs
    same_way = drives[other] & (along(motion.direction[row], motion.direction[other]) > SAME_WAY)
    row, other = row[same_way], other[same_way]
    count = np.bincount(row, minlength=drives.size)
    speed = along(motion.direction[row], motion.velocity[other])
    total = np.bincount(row, speed, drives.size)
    return np.where(count > 0, np.maximum(total / np.maximum(count, 1), 0.5), np.nan)
