"""Who is ahead, behind, beside: interaction along the edges of a traffic graph.

Lengths are not known from positions, so gaps are centre distances less one nominal car length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from graphrqi.features.kinematic import Motion

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NOMINAL_LENGTH_M: Final = 4.6
"""Length taken off centre distances (a European median car)."""

SAME_PATH_M: Final = 1.7
"""Sideways distance within which another is on the same path (half a lane, rounded up)."""

BESIDE_M: Final = 5.0
"""Sideways distance within which another is in the next lane (a lane and a half)."""

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
        beside: (n,) how many are in the next lanes within 10 m.
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


def _nearest(
    row: IntArray, distance: FloatArray, chosen: BoolArray, n: int
) -> tuple[IntArray, FloatArray]:
    """For each row the edge with the least distance among those chosen (-1 and NaN if none)."""
    edge = np.flatnonzero(chosen)
    edge = edge[np.lexsort((distance[edge], row[edge]))]
    rows, first = np.unique(row[edge], return_index=True)
    which = np.full(n, -1, dtype=np.int64)
    which[rows] = edge[first]
    value = np.full(n, np.nan)
    value[rows] = distance[edge[first]]
    return which, value


def interactions(motion: Motion, drives: BoolArray, adjacency: csr_array) -> Interaction:
    """Find everyone's leader, follower and neighbours along the graph's edges.

    Args:
        motion: of the n vertices, in the order of the graph.
        drives: (n,) whether each vertex drives; the others are pedestrians.
        adjacency: (n, n) CSR; who may interact with whom.

    Returns:
        Interaction of each vertex.
    """
    n = motion.ids.size
    row = np.repeat(np.arange(n), np.diff(adjacency.indptr))
    col = np.asarray(adjacency.indices, dtype=np.int64)
    direction = motion.direction
    relative = motion.xy[col] - motion.xy[row]
    ahead = (relative * direction[row]).sum(axis=1)
    left = direction[row, 0] * relative[:, 1] - direction[row, 1] * relative[:, 0]
    with_me = (direction[row] * direction[col]).sum(axis=1) > 0.5  # within 60 degrees
    both_drive = drives[row] & drives[col]
    on_path = both_drive & with_me & (np.abs(left) < SAME_PATH_M)
    along = (motion.velocity[col] * direction[row]).sum(axis=1)

    leading, lead_m = _nearest(row, ahead, on_path & (ahead > 0), n)
    trailing, rear_m = _nearest(row, -ahead, on_path & (ahead < 0), n)
    near = both_drive & with_me & (np.abs(ahead) < 10.0)
    beside = near & (np.abs(left) >= SAME_PATH_M) & (np.abs(left) < BESIDE_M)
    walker = drives[row] & ~drives[col] & (np.abs(left) < BESIDE_M)
    _, pedestrian_m = _nearest(row, ahead, walker & (ahead > 0) & (ahead < PEDESTRIAN_AHEAD_M), n)

    def of(edge: IntArray, values: FloatArray) -> FloatArray:
        return np.where(edge >= 0, values[edge] if values.size else np.nan, np.nan)

    def end(edge: IntArray) -> IntArray:
        return np.where(edge >= 0, col[edge] if col.size else -1, -1)

    return Interaction(
        leader=end(leading),
        gap=np.maximum(lead_m - NOMINAL_LENGTH_M, 0.0),
        leader_speed=of(leading, along),
        follower=end(trailing),
        rear_gap=np.maximum(rear_m - NOMINAL_LENGTH_M, 0.0),
        rear_speed=of(trailing, along),
        beside=np.bincount(row[beside], minlength=n).astype(np.float64),
        pedestrian_m=pedestrian_m,
    )
