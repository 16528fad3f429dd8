"""The vehicles ahead and behind on a lane, also across junctions, for kernels.

The same search as `sim.highway.state.RoadState.neighbours` makes for one vehicle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.highway.kernels.lane_tables import Lanes
from sim.highway.lane_places import LaneLines, OnLanes, project
from sim.highway.state import JOINED_M, LEADER_RANGE_M

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_LANES = 4
"""A leader is looked for on the present lane and on this many after it (as by the vehicles)."""


class Places(NamedTuple):
    """The vehicles' present places on the road's lanes; n vehicles.

    Attributes:
        xy: (n, 2) m.
        lines: of the lanes.
        on: who is on which lane.
        length: (n,) m.
        speed: (n,) m/s.
        way: (n,) the row of ``ways`` that each follows.
        ways: (w, m) numbers of the stretches on each way, -1 after the last.
    """

    xy: FloatArray
    lines: LaneLines
    on: OnLanes
    length: FloatArray
    speed: FloatArray
    way: IntArray
    ways: IntArray


class Beside(NamedTuple):
    """The vehicles ahead and behind: row (-1 for none), bumper gap, m, and speed, m/s, of each."""

    front: int
    front_gap: float
    front_speed: float
    rear: int
    rear_gap: float
    rear_speed: float


@in_place(inner=True)
def along_lane(i: int, lane: int, places: Places) -> float:
    """Distance of a vehicle along a lane, m."""
    return project(places.xy[i, 0], places.xy[i, 1], lane, places.lines)[0]


@in_place(inner=True)
def next_stretch(i: int, lane: int, lanes: Lanes, places: Places) -> int:
    """The stretch that a vehicle wants to reach after a lane's; -1 at the end of its way."""
    ways, way, stretch = places.ways, places.way[i], lanes.stretch[lane]
    for at in range(ways.shape[1] - 1):
        if ways[way, at] == stretch:
            return int(ways[way, at + 1])
    return -1


@in_place(inner=True)
def path_to(lane: int, then: int, lanes: Lanes) -> int:
    """The junction path from a lane to a stretch; -1 if there is none."""
    for at in range(lanes.way_first[lane], lanes.way_first[lane + 1]):
        if lanes.way_stretch[at] == then:
            return int(lanes.way_path[at])
    return -1


@in_place(inner=True)
def onward(i: int, lane: int, lanes: Lanes, places: Places) -> int:
    """The lane that follows on a vehicle's way; -1 at its end or on a wrong lane."""
    if lanes.exit[lane] >= 0:
        return int(lanes.exit[lane])
    then = next_stretch(i, lane, lanes, places)
    return path_to(lane, then, lanes) if then >= 0 else -1


@in_place(inner=True)
def _after(x: float, lane: int, places: Places, equal: bool) -> int:
    """The first entry on a lane beyond a place, or also at it if ``equal``."""
    on = places.on
    low, high = on.first[lane], on.first[lane + 1]
    while low < high:
        middle = (low + high) // 2
        s = on.s[middle]
        if s < x or (s == x and not equal):
            low = middle + 1
        else:
            high = middle
    return int(low)


@in_place(inner=True)
def beside(i: int, lane: int, lanes: Lanes, places: Places) -> Beside:
    """The vehicles ahead of and behind a vehicle on a lane, ahead also along its way."""
    on, order, length = places.on, places.on.row, places.length
    here = along_lane(i, lane, places)
    at = _after(here, lane, places, True)
    rear, rear_gap, rear_speed = -1, np.inf, 0.0
    before = at - 1
    while before >= on.first[lane] and order[before] == i:
        before -= 1
    if before >= on.first[lane]:
        rear = order[before]
        rear_gap = here - on.s[before] - (length[i] + length[rear]) / 2
        rear_speed = on.along[before]
    offset, now, visited = -here, lane, 0
    while True:
        end = on.first[now + 1]
        while at < end and order[at] == i:
            at += 1
        if at < end:
            j = order[at]
            gap = offset + on.s[at] - (length[i] + length[j]) / 2
            if gap < LEADER_RANGE_M:
                return Beside(j, gap, on.along[at], rear, rear_gap, rear_speed)
            break
        offset += lanes.length[now]
        visited += 1
        then = onward(i, now, lanes, places)
        if then < 0 or offset > LEADER_RANGE_M or visited > MOST_LANES:
            break
        now = then
        at = _after(max(-offset, -JOINED_M), now, places, False)
    return Beside(-1, np.inf, 0.0, rear, rear_gap, rear_speed)
