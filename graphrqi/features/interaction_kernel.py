"""The compiled loop behind `graphrqi.features.interaction`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


@compiled
def look_around(
    indptr: NDArray[np.int32],
    indices: NDArray[np.int32],
    xy: NDArray[np.float64],
    velocity: NDArray[np.float64],
    direction: NDArray[np.float64],
    drives: NDArray[np.bool_],
    same_path_m: float,
    beside_m: float,
    abreast_m: float,
    sight_m: float,
    who: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    """Find everyone's nearest ahead, behind and walking, and count those beside.

    Args:
        indptr: (n + 1,) where each vertex' edges begin.
        indices: (E,) other end of each edge; one from a vertex to itself does not count.
        xy: (n, 2) m.
        velocity: (n, 2) m/s.
        direction: (n, 2) unit vectors of travel; NaN where unknown, who then has nobody.
        drives: (n,) whether each vertex drives.
        same_path_m: sideways distance within which another is on the same path.
        beside_m: sideways distance within which another is in the next lane.
        abreast_m: distance along the way within which another is beside.
        sight_m: how far ahead a pedestrian matters.
        who: (n, 2) receives the nearest ahead and behind; must be -1 before.
        out: (n, 6) receives the distance ahead and the speed of the first, the distance behind and
            the speed of the second, how many are beside, and the distance to the nearest
            pedestrian; must be NaN before, but for the count.
    """
    for i in range(indptr.size - 1):
        if not drives[i]:
            continue
        east, north = direction[i, 0], direction[i, 1]
        for edge in range(indptr[i], indptr[i + 1]):
            j = indices[edge]
            if j == i:
                continue
            x, y = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
            ahead = x * east + y * north
            aside = abs(east * y - north * x)
            if not drives[j]:
                near = aside < beside_m and ahead > 0.0 and ahead < sight_m
                if near and not ahead >= out[i, 5]:
                    out[i, 5] = ahead
                continue
            if not east * direction[j, 0] + north * direction[j, 1] > 0.5:  # beyond 60 degrees
                continue
            if aside < same_path_m:
                place = 0 if ahead > 0.0 else 1
                far = abs(ahead)
                if far > 0.0 and not far >= out[i, 2 * place]:
                    who[i, place] = j
                    out[i, 2 * place] = far
                    out[i, 2 * place + 1] = velocity[j, 0] * east + velocity[j, 1] * north
            elif aside < beside_m and abs(ahead) < abreast_m:
                out[i, 4] += 1.0
