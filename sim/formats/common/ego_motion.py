"""Positions recorded from a moving vehicle, transformed into one frame that stands still.

Most agents stand between two consecutive frames (parked cars, say), so the rigid motion that fits
most agents is the recording vehicle's own. A least-squares fit (Procrustes) alternates with
dropping the agents that do not follow it. The motion is undone step by step, so errors add up:
distances between far-apart times are less certain than between near ones.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.formats.common.recording import motion
from sim.frames import Tracks

FloatArray = NDArray[np.float64]

ROUNDS: Final = 10
"""Fits per pair of frames (the kept agents stop changing after a few)."""

MIN_AGENTS: Final = 3
"""Agents needed for a fit; with fewer, the last motion is assumed to go on."""


def rigid_motion(before: FloatArray, after: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rotation and shift that most points follow from one frame to the next.

    Args:
        before: (n, 2) m.
        after: (n, 2) the same agents a step later, m.

    Returns:
        (2, 2) rotation and (2,) shift with ``after @ rotation.T + shift`` near ``before`` for at
        least half of the points.

    Examples:
        >>> still = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 9.0], [7.0, 7.0]])
        >>> seen = still - [1.0, 0.5]
        >>> seen[3] += 5.0  # one drives off
        >>> rigid_motion(still, seen)[1].round(6).tolist()
        [1.0, 0.5]
    """
    rotation = np.eye(2)
    shift = np.median(before - after, axis=0)
    for _ in range(ROUNDS):
        missed = np.hypot(*(after @ rotation.T + shift - before).T)
        kept = missed <= np.median(missed) + 1e-9
        source, target = after[kept], before[kept]
        middle, aim = source.mean(axis=0), target.mean(axis=0)
        u, _, vt = np.linalg.svd((source - middle).T @ (target - aim))
        flip = np.diag([1.0, np.sign(np.linalg.det(vt.T @ u.T))])
        rotation = vt.T @ flip @ u.T
        shift = aim - rotation @ middle
    return rotation, shift


def remove_ego_motion(tracks: Tracks) -> Tracks:
    """Bring tracks seen from a moving vehicle into the frame of the first instant.

    Args:
        tracks: positions relative to the recording vehicle, m.

    Returns:
        The same agents; headings and speeds are told anew from the motion.
    """
    xy = tracks.xy.copy()
    rotation, shift = np.eye(2), np.zeros(2)
    turn, step = np.eye(2), np.zeros(2)
    for t in range(1, tracks.time_s.size):
        both = tracks.valid[:, t - 1] & tracks.valid[:, t]
        if np.count_nonzero(both) >= MIN_AGENTS:
            turn, step = rigid_motion(tracks.xy[both, t - 1], tracks.xy[both, t])
        shift = rotation @ step + shift
        rotation = rotation @ turn
        xy[:, t] = tracks.xy[:, t] @ rotation.T + shift
    heading, speed = motion(xy, tracks.time_s, 0.0)
    return dataclasses.replace(
        tracks,
        xy=xy,
        heading=heading,
        speed=speed,
    )
