"""Columns of the arrays that the compiled functions of a rollout share.

They take a few wide arrays instead of many narrow ones, because each argument costs time.
"""

from __future__ import annotations

from typing import Final

PRESENT: Final = ("s", "speed", "accel", "half_length", "on_path")
"""(n, 5) the drivers at present, in m, m/s and m/s2 (or `UNKNOWN_ACCELERATION`); the last column is
1 for a driver on a path."""
START_S, START_SPEED, START_ACCEL, HALF_LENGTH, ON_PATH = range(5)

MOTION: Final = (
    "x", "speed", "offset", "return_speed", "travelled", "residual", "wish", "ahead", "accel",
)  # fmt: skip
"""(n, 9) the drivers at one step. Distances are in m: along the path, left of the lane's centre,
travelled, to the leader. Speeds are in m/s: own, lateral, desired. Residual and model acceleration
are in m/s2."""
X, SPEED, OFFSET, RETURN_SPEED, TRAVELLED, RESIDUAL, WISH, AHEAD, ACCEL = range(9)

ROUTE: Final = ("path", "on", "leader")
"""(n, 3) their paths, which lane of it each has reached, and its leader (-1: none)."""
PATH, ON, LEADER = range(3)

PLACE: Final = ("s", "speed")
"""(n, 2) where a driver's neighbours assume it: distance along its lane, m, and speed, m/s."""
S, V = range(2)

RANKING: Final = ("lane", "order", "rank")
"""(n, 3) the lane of each driver, the drivers sorted by s within each lane, and the rank of
each."""
LANE, ORDER, RANK = range(3)

SPARE: Final = ("sorted", "used")
"""(n + 1, 2) memory for sorting: the drivers in the previous order, and the occupied lanes. The
last row holds the number of these lanes."""
SORTED, USED = range(2)

FIRST, LAST = range(2)
"""Rows of (2, L) ranks of the first and last driver of each lane; 0 and -1 for an empty lane."""
