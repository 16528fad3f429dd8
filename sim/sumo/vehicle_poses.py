"""From front bumpers to boxes: where a vehicle's centre is and how it is turned.

A vehicle is drawn as a car rolls: its front bumper goes where SUMO puts it, its rear axle follows
after (a tractrix). SUMO's own angle is right in lanes and turns, but it tilts a car that changes
lanes by up to 60 degrees when it crawls, and leaves it so when it stops.
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np

from sim.frames import BoolArray, FloatArray, IntArray

AXLE_SHARE: Final = 0.8
"""The rear axle is this share of the length behind the front bumper (our choice: as in most
cars)."""

TURNING, KEEPING = 0.8, 0.25
"""A front bumper moves aside by at most this share of its way ahead, where the road turns and
elsewhere (our choice: about 40 degrees, the full lock of ordinary cars, and 14 degrees, a hasty
change of lanes); SUMO's cars slide sideways beyond it while they crawl or stand."""

STRAIGHTENING_M: Final = 6.0
"""A car is still straightening up this far after a turn (our choice: a car's length and more)."""


@numba.njit(cache=True)
def draw(
    order: IntArray,
    rows: IntArray,
    front: FloatArray,
    speed: FloatArray,
    angle: FloatArray,
    length: FloatArray,
    walks: BoolArray,
    turns: FloatArray,
    before: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres and headings of boxes, from where the front bumpers are now and were before.

    Args:
        order: (n,) place of each in the next three, which are in SUMO's own order.
        rows: (n,) which agents.
        front: (2n,) centre of each front bumper, x and y by turns, m.
        speed: (n,) m/s.
        angle: (n,) SUMO's angle, degrees clockwise from north, of pedestrians and of the new.
        length: (N,) of every agent, m.
        walks: (N,) whether an agent is a pedestrian: those face where SUMO says.
        turns: (2, 2) south-west and north-east corner of where the road turns, m.
        before: (N, 4) front bumper and rear axle at the last call, m, NaN for the new; updated.

    Returns:
        In the order of ``rows``: (n, 2) centres, m, (n,) headings, rad in (-pi, pi], and (n,)
        speeds, m/s.

    Examples:
        >>> before = np.full((1, 4), np.nan)
        >>> agent, nowhere = np.zeros(1, np.int64), np.array([[np.inf] * 2, [-np.inf] * 2])
        >>> for x, y in ((5.0, 0.0), (5.0, 1.0)):  # the front jumps aside: the car slides
        ...     xy, heading, _ = draw(agent, agent, np.array([x, y]), np.ones(1), np.array([90.0]),
        ...                           np.array([4.0]), np.zeros(1, np.bool_), nowhere, before)
        >>> xy.tolist(), heading.tolist()
        ([[3.0, 1.0]], [0.0])
    """
    n = rows.size
    xy, heading, ordered = np.empty((n, 2)), np.empty(n), np.empty(n)
    for i in range(n):
        row, at = rows[i], order[i]
        x, y = front[2 * at], front[2 * at + 1]
        ordered[i] = speed[at]
        reach = AXLE_SHARE * length[row]
        if walks[row] or math.isnan(before[row, 0]):
            told = math.radians(90.0 - angle[at])
            east, north = math.cos(told), math.sin(told)
        else:
            fx, fy, ax, ay = before[row]
            old_east, old_north = (fx - ax) / reach, (fy - ay) / reach
            ahead = (x - fx) * old_east + (y - fy) * old_north
            aside = (y - fy) * old_east - (x - fx) * old_north
            # a box about the turns, and around it how far a car leaving them straightens up
            out_x = x - min(max(x, turns[0, 0]), turns[1, 0])
            out_y = y - min(max(y, turns[0, 1]), turns[1, 1])
            leaves = out_x * old_east + out_y * old_north >= 0.0
            turning = leaves and max(abs(out_x), abs(out_y)) < STRAIGHTENING_M
            most = (TURNING if turning else KEEPING) * max(ahead, 0.0)
            slid = aside - min(max(aside, -most), most)
            east, north = x - ax + slid * old_north, y - ay - slid * old_east
            far = max(math.hypot(east, north), 1e-9)
            east, north = east / far, north / far
        before[row, 0], before[row, 1] = x, y
        before[row, 2], before[row, 3] = x - reach * east, y - reach * north
        xy[i, 0], xy[i, 1] = x - 0.5 * length[row] * east, y - 0.5 * length[row] * north
        heading[i] = math.atan2(north, east)
        if heading[i] == -math.pi:
            heading[i] = math.pi
    return xy, heading, ordered
