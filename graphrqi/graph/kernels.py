"""Compiled: the nearest neighbours of every vehicle."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray, IntArray
from sim.compiled import in_place

Ints = NDArray[np.int32]

DIRECTION = np.array([math.cos(1.0), math.sin(1.0)])
"""Vehicles are sorted along this direction, which no straight road of a usual map is square to."""


def nearest_neighbors(ids: IntArray, xy: FloatArray, k: int) -> Ints:
    """(n, k) places of the nearest others of every vehicle, by distance, then by id.

    Vehicles are sorted along one direction. The search goes both ways from each, until the distance
    along that direction alone exceeds that of the k-th found. The result is exact. The search is
    slow only if most traffic is square to the direction.
    """
    found = np.empty((ids.size, k), np.int32)
    if k > 0:
        along = xy @ DIRECTION
        order = np.argsort(along, kind="stable")
        slack_m = 1e-15 * float(np.abs(xy).max())
        place = np.empty((ids.size, k), np.int32)
        square, who = np.empty(k + 1), np.empty(k + 1, np.int32)
        _find_nearest(ids[order], xy[order], along[order], slack_m, square, who, place)
        found[order] = order[place]
    return found


@in_place()
def _find_nearest(
    ids: IntArray,
    xy: FloatArray,
    along: FloatArray,
    slack: float,
    square: FloatArray,
    who: Ints,
    out: Ints,
) -> None:
    """See `nearest_neighbors`; ``square`` and ``who`` (k + 1,) are room to work in."""
    n, k = out.shape
    for i in range(n):
        found = 0
        low, high = i - 1, i + 1
        while low >= 0 or high < n:
            below = along[i] - along[low] if low >= 0 else math.inf
            above = along[high] - along[i] if high < n else math.inf
            j, away = (low, below) if below <= above else (high, above)
            least = away - slack
            if found == k and least > 0.0 and least * least * (1.0 - 1e-12) > square[k - 1]:
                break
            low, high = (low - 1, high) if below <= above else (low, high + 1)
            dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
            distance = dx * dx + dy * dy
            q = found
            while q > 0 and (
                distance < square[q - 1] or (distance == square[q - 1] and ids[j] < ids[who[q - 1]])
            ):
                square[q], who[q] = square[q - 1], who[q - 1]
                q -= 1
            square[q], who[q] = distance, j
            found += found < k
        for q in range(k):
            out[i, q] = who[q]
