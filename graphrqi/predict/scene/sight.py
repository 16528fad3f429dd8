"""What a history shows of each driver: its place on the road, its neighbours, what it wishes.

The same rules as `sim.episode.observables.observe` has, but only what predictors use, in one
compiled pass over the present and a few moments of the past.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.scene import sight_kernel
from graphrqi.predict.scene.paths import limits
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph, project

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

PAST_EVERY_S: Final = 1.0
"""How far apart the past is looked at to learn a driver's wishes, s (our choice)."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The drivers of a history at its last moment; pedestrians are on no lane and see nothing.

    Attributes:
        lane: (n,) lane that each drives along or is changing to, -1 off the road.
        s: (n,) distance along it, m.
        offset: (n,) distance to the left of its centre line, m.
        sideways: (n,) speed to the left over the last half second, m/s.
        accel: (n,) acceleration over the last half second, m/s2; 0 where unknown.
        free_factor: (n,) mean speed over limit when driving steadily with nothing ahead; NaN if
            that was never seen.
        least_factor: (n,) largest speed over limit seen.
        place: (n,) lane that each is on, -1 off the road.
        limit: (n,) its speed limit, m/s; NaN off the road.
        leader: (n,) row of the vehicle ahead, -1 if none.
        gap: (n,) bumper to bumper to it, m; +inf if none.
        follower: (n,) row of the nearest vehicle that has this one as its leader, -1 if none.
        beside: (n, 4) rows of those ahead and behind on the lane to the left, and to the right.
        beside_gap: (n, 4) bumper to bumper to them, m.
    """

    lane: IntArray
    s: FloatArray
    offset: FloatArray
    sideways: FloatArray
    accel: FloatArray
    free_factor: FloatArray
    least_factor: FloatArray
    place: IntArray
    limit: FloatArray
    leader: IntArray
    gap: FloatArray
    follower: IntArray
    beside: IntArray
    beside_gap: FloatArray


def look(history: Tracks, road: Road) -> Sight:
    """See what a history shows on a road; agents not seen in its last column are on no lane."""
    graph = LaneGraph.of(road)
    ago = np.arange(0.0, np.ptp(history.time_s) + 1e-6, PAST_EVERY_S)[::-1]
    columns = np.searchsorted(history.time_s, history.time_s[-1] - ago - 1e-6)
    drives = history.kind != PEDESTRIAN
    valid, xy = np.ascontiguousarray(history.valid), np.ascontiguousarray(history.xy)
    heading, speed = np.ascontiguousarray(history.heading), np.ascontiguousarray(history.speed)
    # copies: what is strided or read-only only sometimes is compiled for twice
    agent, instant = (x.copy() for x in np.nonzero(valid[:, columns] & drives[:, None]))
    column = columns[instant]
    found = project(road, xy[agent, column], heading[agent, column])
    return Sight(
        *sight_kernel.look(
            history.time_s, valid, xy, heading, speed, history.length.copy(),
            drives, columns, agent, instant, found.lane,
            found.s, found.offset, graph.length, graph.width, limits(graph), graph.internal,
            graph.signal, graph.ahead, graph.behind, graph.left, graph.right, graph.cross_lane,
            graph.cross_id, graph.cross_s, graph.cross_exit_s, graph.segment_start,
            graph.segment_direction, graph.segment_at, graph.segment_first, graph.segment_last,
        )
    )  # fmt: skip
