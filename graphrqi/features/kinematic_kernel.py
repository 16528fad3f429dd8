"""The compiled loop behind `graphrqi.features.kinematic`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled


@compiled
def oldest(
    rows: NDArray[np.int64],
    times: NDArray[np.float64],
    values: NDArray[np.float64],
    since_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far each agent's value is now from the oldest one known from a time on.

    Args:
        rows: (n,) whose.
        times: (T,) ascending, s.
        values: (m, T, 2) of all agents; NaN where unknown.
        since_s: no older than this, s; the last time is left out.

    Returns:
        (n, 2) differences, NaN where none is known, and (n,) s: of an unknown value since the
        oldest time, or 1 where there is no time.
    """
    now = times.size - 1
    first = 0
    while first < now and times[first] < since_s:
        first += 1
    gone, ago = np.full((rows.size, 2), np.nan), np.ones(rows.size)
    if first == now:
        return gone, ago
    for i in range(rows.size):
        row, at = rows[i], first
        while at < now - 1 and np.isnan(values[row, at, 0]):
            at += 1
        if np.isnan(values[row, at, 0]):
            at = first
        gone[i, 0] = values[row, now, 0] - values[row, at, 0]
        gone[i, 1] = values[row, now, 1] - values[row, at, 1]
        ago[i] = times[now] - times[at]
    return gone, ago


@compiled
def along(
    direction: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) parts of vectors (n, 2) along directions (n, 2), and to the left of them."""
    n = len(direction)
    ahead, left = np.empty(n), np.empty(n)
    for i in range(n):
        ahead[i] = values[i, 0] * direction[i, 0] + values[i, 1] * direction[i, 1]
        left[i] = direction[i, 0] * values[i, 1] - direction[i, 1] * values[i, 0]
    return ahead, left
