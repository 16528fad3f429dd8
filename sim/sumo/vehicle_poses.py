"""Vehicle poses from front bumpers: where each vehicle's centre is, and its heading.

The front bumper of a vehicle is where SUMO puts it, and the rear axle follows it (a tractrix), as
in a rolling car. SUMO's own angle is right in lanes and turns, but a crawling car that changes
lanes is turned by up to 60 degrees, and stays so when it stops.
"""

from __future__ import annotations

import math
from typing import Final

from sim.compiled import in_place
from sim.frames import BoolArray, FloatArray, IntArray
from sim.road.cells import Cells

AXLE_SHARE: Final = 0.8
"""The rear axle is this share of the length behind the front bumper (as in most cars)."""

TURNING, KEEPING = 0.8, 0.25
"""Greatest sideways over forward motion of a front bumper: where the road turns (a car's full
lock), and on straight roads (a hasty lane change). Sideways motion beyond it, which SUMO makes
while cars crawl or stand, moves the rear axle, too."""

STRAIGHTENING_M: Final = 6.0
"""A car is still straightening up this far after a turn (a car's length and more)."""


@in_place()
def find_poses(
    order: IntArray, rows: IntArray, front: FloatArray, angle: FloatArray, length: FloatArray,
    pedestrian: BoolArray, areas: FloatArray, cells: Cells, axles: FloatArray, xy: FloatArray,
    heading: FloatArray,
) -> None:  # fmt: skip
    """Centres and headings, from where the front bumpers are now and where they were before.

    Args:
        order: (n,) index of each agent in ``front`` and ``angle``, which are in SUMO's order.
        rows: (n,) row of each agent in ``length``, ``pedestrian`` and ``axles``.
        front: (2n,) centre of each front bumper, x and y alternating, m.
        angle: (n,) SUMO's angle, degrees clockwise from north; used for pedestrians and for
            vehicles that have just departed.
        length: (N,) of every agent, m.
        pedestrian: (N,) whether an agent is a pedestrian.
        areas: (J, 4) west, south, east and north side of each place where the road turns, m.
        cells: those of ``areas``, with at least `STRAIGHTENING_M` around them.
        axles: (N, 4) front bumper and rear axle at the last call, m; NaN for vehicles that have
            just departed. Updated in place.
        xy: (n, 2) receives the centres, m.
        heading: (n,) receives the headings, rad in (-pi, pi].

    Examples:
        >>> import numpy as np
        >>> from sim.road.cells import cells_of
        >>> axles = np.full((1, 4), np.nan)
        >>> agent, nowhere = np.zeros(1, np.int64), np.empty((0, 4))
        >>> cells, xy, heading = cells_of(nowhere, agent[:0], 50.0), np.empty((1, 2)), np.empty(1)
        >>> for x, y in ((5.0, 0.0), (5.0, 1.0)):  # the front jumps sideways: so does the car
        ...     find_poses(
        ...         agent, agent, np.array([x, y]), np.array([90.0]), np.array([4.0]),
        ...         np.zeros(1, np.bool_), nowhere, cells, axles, xy, heading)
        >>> xy.tolist(), heading.tolist()
        ([[3.0, 1.0]], [0.0])
    """
    x0, y0, size, columns, lines, first, items = cells
    for i in range(rows.size):
        row, at = rows[i], order[i]
        x, y = front[2 * at], front[2 * at + 1]
        reach = AXLE_SHARE * length[row]
        if pedestrian[row] or math.isnan(axles[row, 0]):
            heading_east = math.radians(90.0 - angle[at])
            east, north = math.cos(heading_east), math.sin(heading_east)
        else:
            fx, fy, ax, ay = axles[row, 0], axles[row, 1], axles[row, 2], axles[row, 3]
            old_east, old_north = (fx - ax) / reach, (fy - ay) / reach
            ahead = (x - fx) * old_east + (y - fy) * old_north
            aside = (y - fy) * old_east - (x - fx) * old_north
            column, line = math.floor((x - x0) / size), math.floor((y - y0) / size)
            turning = False
            if 0 <= column < columns and 0 <= line < lines:
                cell = line * columns + column
                for p in range(first[cell], first[cell + 1]):
                    a = items[p]
                    # how far outside the area the front is, and whether it drives away from it
                    out_x = x - min(max(x, areas[a, 0]), areas[a, 2])
                    out_y = y - min(max(y, areas[a, 1]), areas[a, 3])
                    leaves = out_x * old_east + out_y * old_north >= 0.0
                    turning |= leaves and max(abs(out_x), abs(out_y)) < STRAIGHTENING_M
            most = (TURNING if turning else KEEPING) * max(ahead, 0.0)
            slid = aside - min(max(aside, -most), most)
            east, north = x - ax + slid * old_north, y - ay - slid * old_east
            far = max(math.hypot(east, north), 1e-9)
            east, north = east / far, north / far
        axles[row, 0], axles[row, 1] = x, y
        axles[row, 2], axles[row, 3] = x - reach * east, y - reach * north
        xy[i, 0], xy[i, 1] = x - 0.5 * length[row] * east, y - 0.5 * length[row] * north
        heading[i] = math.atan2(north, east)
        if heading[i] == -math.pi:
            heading[i] = math.pi
