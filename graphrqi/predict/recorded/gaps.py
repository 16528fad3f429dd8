"""Whether the gaps between the vehicles of a recording are plausible.

Some recordings in circulation have tracks that are shifted in time: vehicles overlap, and what a
neighbour does says nothing. Then the network is told of no neighbours.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

HALF_LANE_M: Final = 1.5
"""A vehicle this close to the line along which another one drives is in its lane, m (half of a 3 m
lane)."""

AHEAD_M: Final = 100.0
"""Leaders count up to this distance, m."""

MOST_OVERLAPS: Final = 0.01
"""Share of followers that may overlap their leader before gaps count as implausible."""

STANDING_MPS: Final = 0.5
"""Vehicles slower than this stand."""


def inferred_leaders(history: Tracks, column: int = -1) -> tuple[IntArray, FloatArray]:
    """The leader of each vehicle, without a map.

    Args:
        history: tracks.
        column: at which time.

    Returns:
        (n,) row of the leader or -1, and (n,) bumper-to-bumper gap, m, +inf without one.
    """
    n = history.ids.size
    drives = (history.kind != PEDESTRIAN) & history.valid[:, column]
    xy, heading = history.xy[:, column], history.heading[:, column]
    facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    apart = xy[None] - xy[:, None]
    along = (apart * facing[:, None]).sum(axis=2)
    across = facing[:, None, 0] * apart[..., 1] - facing[:, None, 1] * apart[..., 0]
    same = np.cos(heading[None] - heading[:, None]) > 0.85
    ahead = (along > 0) & (along < AHEAD_M) & (np.abs(across) < HALF_LANE_M) & same
    ahead &= drives[:, None] & drives[None]
    distance = np.where(ahead, along, np.inf)
    if not n:
        return np.empty(0, np.int64), np.empty(0)
    leader = np.where(ahead.any(axis=1), distance.argmin(axis=1), -1)
    row = np.arange(n)
    gap = distance[row, np.maximum(leader, 0)]
    gap = np.where(leader >= 0, gap - (history.length + history.length[leader]) / 2, np.inf)
    return leader, gap


def plausible(history: Tracks) -> bool:
    """Whether hardly any follower overlaps its leader, over the history.

    Pairs that both stand are left out: parked cars do not show whether tracks are shifted in time.
    """
    overlaps = followers = 0
    every = 1 if history.time_s.size < 2 else max(1, round(1.0 / history.step_s))
    for column in range(history.time_s.size - 1, -1, -every):
        leader, gap = inferred_leaders(history, column)
        moves = history.speed[:, column] > STANDING_MPS
        counts = (leader >= 0) & (moves | moves[leader])
        followers += int(counts.sum())
        overlaps += int((counts & (gap < 0)).sum())
    return overlaps <= MOST_OVERLAPS * followers
