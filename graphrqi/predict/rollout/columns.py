"""Columns of the arrays that the compiled functions of a rollout share.

They take a few wide arrays instead of many narrow ones: handing over an array costs time of its
own, in every call and in every step.
"""

from __future__ import annotations

from typing import Final

PRESENT: Final = ("s", "speed", "accel", "half_length", "on_path")
"""(n, 5) the drivers at present: distance along the first lane of its path m, m/s, m/s2 (or
`UNKNOWN_ACCELERATION`), m, and 1 for a driver on a path."""
START_S, START_SPEED, START_ACCEL, HALF_LENGTH, ON_PATH = range(5)

MOTION: Final = (
    "x", "speed", "offset", "return_speed", "travelled", "residual", "wish", "ahead", "accel",
)  # fmt: skip
"""(n, 9) the drivers at one step: distance along the path m, m/s, distance to the left of the
lane's centre m, speed of the return to it m/s, distance since the present m, residual acceleration
at present m/s2, wished speed under the limits here and ahead m/s, distance to the leader's centre
m, and the acceleration that the model asks for m/s2."""
X, SPEED, OFFSET, RETURN_SPEED, TRAVELLED, RESIDUAL, WISH, AHEAD, ACCEL = range(9)

ROUTE: Final = ("path", "on", "leader")
"""(n, 3) their paths, which lane of it each has reached, and its leader (-1: none)."""
PATH, ON, LEADER = range(3)

PLACE: Final = ("s", "speed")
"""(n, 2) where a driver's neighbours take it to be: distance along its lane m, and m/s."""
S, V = range(2)

RANKING: Final = ("lane", "order", "rank")
"""(n, 3) the lane of each driver; the drivers sorted by s within each lane; and the place of each
among these."""
LANE, ORDER, RANK = range(3)

SPARE: Final = ("sorted", "used")
"""(n + 1, 2) room for sorting: the drivers in the order of the step before, and the lanes that
somebody is on; in the last row how many such lanes there are."""
SORTED, USED = range(2)

FIRST, LAST = range(2)
"""Rows of (2, L) places in the order of the first and last driver of each lane; 0 and -1 where
there is none."""
