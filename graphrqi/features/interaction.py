"""Who is ahead, behind, beside: interaction along the edges of a traffic graph.

Lengths are not known from positions, so gaps are centre distances less one nominal car length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.kinematic import Motion
from graphrqi.graph import TrafficGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NOMINAL_LENGTH_M: Final = 4.6
"""Length taken off centre distances (a European median car)."""

SAME_PATH_M: Final = 1.7
"""Sideways distance within which another is on the same path (half a lane, rounded up)."""

BESIDE_M: Final = 5.0
"""Sideways distance within which another is in the next lane (a lane and a half)."""

ABREAST_M: Final = 10.0
"""Distance along the way within which another is beside (our choice: two car lengths)."""

PEDESTRIAN_AHEAD_M: Final = 30.0
"""How far ahead a pedestrian matters (our choice: two seconds and a half at town speed)."""


@dataclass(frozen=True, slots=True)
class Interaction:
    """Each vertex and those around it; NaN (or -1) where there is nobody.

    Attributes:
        leader: (n,) index of the nearest ahead on the same path, -1 if none.
        gap: (n,) to the leader, m; at least 0.
        leader_speed: (n,) m/s, along the follower's direction.
        follower: (n,) index of the nearest behind on the same path, -1 if none.
        rear_gap: (n,) m; at least 0.
        rear_speed: (n,) m/s, along one's own direction.
        beside: (n,) how many are in the next lanes within ``ABREAST_M``.
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
    """Find everyone's leader, follower and neighbours along the graph's edges.

    Args:
        motion: of the n vertices, in the order of the graph.
        drives: (n,) whether each vertex drives; the others are pedestrians.
        graph: who may interact with whom.

    Returns:
        Interaction of each vertex.
    """
    from graphrqi.features.interaction_kernel import look_around

    who = np.full((motion.ids.size, 2), -1, dtype=np.int64)
    seen = np.full((motion.ids.size, 6), np.nan)
    seen[:, 4] = 0.0
    look_around(
        graph.indptr, graph.indices, motion.xy, motion.velocity, motion.direction, drives,
        SAME_PATH_M, BESIDE_M, ABREAST_M, PEDESTRIAN_AHEAD_M, who, seen,
    )  # fmt: skip
    return Interaction(
        leader=who[:, 0],
        gap=np.maximum(seen[:, 0] - NOMINAL_LENGTH_M, 0.0),
        leader_speed=seen[:, 1],
        follower=who[:, 1],
        rear_gap=np.maximum(seen[:, 2] - NOMINAL_LENGTH_M, 0.0),
        rear_speed=seen[:, 3],
        beside=seen[:, 4],
        pedestrian_m=seen[:, 5],
    )
