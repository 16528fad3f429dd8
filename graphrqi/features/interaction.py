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
from graphrqi.features.motion import Motion
from graphrqi.graph import TrafficGraph

NOMINAL_LENGTH_M: Final = 4.6
"""Length taken off centre distances (a European median car)."""

SAME_PATH_M: Final = 1.7
"""Sideways distance within which another is on the same path (half a lane, rounded up)."""

BESIDE_M: Final = 5.0
"""Sideways distance within which another is in the next lane (a lane and a half)."""

ABREAST_M: Final = 10.0
"""Distance along the direction of travel within which another is beside (two car lengths)."""

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
    """Find every driver's leader, follower and neighbours along the graph's edges.

    Args:
        motion: of the n vertices, in the order of the graph.
        drives: (n,) whether each vertex drives; the others are pedestrians.
        graph: its edges join vertices that may interact.

    Returns:
        Interaction of each vertex.
    """
    from graphrqi.features.kernels import find_neighbors

    nearest = np.full((len(motion.xy), 2), -1, dtype=np.int64)
    found = np.full((len(motion.xy), 6), np.nan)
    found[:, 4] = 0.0
    find_neighbors(
        graph.indptr, graph.indices, motion.xy.copy(), motion.velocity, motion.direction, drives,
        (SAME_PATH_M, BESIDE_M, ABREAST_M, PEDESTRIAN_AHEAD_M), nearest, found,
    )  # fmt: skip
    return Interaction(
        leader=nearest[:, 0],
        gap=np.maximum(found[:, 0] - NOMINAL_LENGTH_M, 0.0),
        leader_speed=found[:, 1],
        follower=nearest[:, 1],
        rear_gap=np.maximum(found[:, 2] - NOMINAL_LENGTH_M, 0.0),
        rear_speed=found[:, 3],
        beside=found[:, 4],
        pedestrian_m=found[:, 5],
    )


def differences(
    graph: TrafficGraph, signal: FloatArray, drives: BoolArray, scales: int = 2
) -> FloatArray:
    """Difference of a signal from its neighbourhood, at several scales.

    Args:
        graph: of n vertices.
        signal: (n,) values; NaN where unknown.
        drives: (n,) vertices that count as neighbours (drivers, not pedestrians).
        scales: number of scales.

    Returns:
        (n, scales) column j is P^j s - P^(j+1) s; NaN where the signal is unknown, and without
        neighbours.

    Examples:
        >>> path = TrafficGraph.from_edges([1, 2, 3], [(1, 2), (2, 3)])
        >>> differences(path, np.array([1.0, 2.0, 6.0]), np.ones(3, bool), scales=1).ravel()
        array([-1. , -1.5,  4. ])
    """
    from graphrqi.features.kernels import signal_differences

    counts = drives & ~np.isnan(signal)
    level = np.where(counts, signal, 0.0)
    out = np.empty((signal.size, scales))
    signal_differences(
        graph.indptr, graph.indices, graph.values, counts, level, np.empty(signal.size), out
    )
    return out


def neighbor_speed(motion: Motion, drives: BoolArray, graph: TrafficGraph) -> FloatArray:
    """(n,) mean speed of the neighbours that drive the same way, m/s; NaN without one."""
    from graphrqi.features.kernels import speed_of_neighbors

    out = np.empty(drives.size)
    speed_of_neighbors(graph.indptr, graph.indices, motion.velocity, motion.direction, drives, out)
    return out
