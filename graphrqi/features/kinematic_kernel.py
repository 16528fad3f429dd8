"""The compiled loop behind `graphrqi.features.kinematic`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.compiled import compiled


@compiled
def oldest(
    rows: NDArray[np.int64],
    times: NDArray[np.float64],
    values: NDArray[np.float64],
    since_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The oldest known value of each agent from a time on, and how long ago it was.

    Args:
        rows: (n,) whose.
        times: (T,) ascending, s.
        values: (m, T, 2) of all agents; NaN where unknown.
        since_s: no older than this, s; the last time is left out.

    Returns:
        (n, 2) values, NaN where none is known, and (n,) s: of an unknown value since the oldest
        time, or 1 where there is no time.
    """
    now = times.size - 1
    first = 0
    while first < now and times[first] < since_s:
        first += 1
    found, ago = np.full((rows.size, 2), np.nan), np.ones(rows.size)
    if first == now:
        return found, ago
    for i in range(rows.size):
        at = first
        while at < now - 1 and np.isnan(values[rows[i], at, 0]):
            at += 1
        if np.isnan(values[rows[i], at, 0]):
            at = first
        found[i] = values[rows[i], at]
        ago[i] = times[now] - times[at]
    return found, ago
