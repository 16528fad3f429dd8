"""Priority between two road users, as far as the map gives it."""

from __future__ import annotations

from typing import Final

import numpy as np

from sim.frames import IntArray, Signal, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.road.lane_search import along
from sim.safety.encounters import Driven

NEAR_S: Final = 60.0
"""A body is on its way over a junction if it is inside within this time, s (a signal cycle)."""

JUNCTION_M: Final = 60.0
"""Bodies that are on connections farther apart than this are in different junctions, m."""


def priorities(
    driven: Driven, tracks: Tracks, road: Road, first: IntArray, second: IntArray
) -> IntArray:
    """(k,) ids of those that have priority, of the bodies in (k,) rows; -1 if unknown.

    A pedestrian on a crossing has priority over vehicles unless the map or its red light says no.
    Between vehicles, one that has or had a red light at the junction has none; otherwise their
    paths decide. Where signals never let both go, the first to enter has priority.
    """
    agents = driven.index.agent[np.concatenate([first, second])]
    rows = np.flatnonzero(np.isin(driven.index.agent, agents))
    link, ahead, crossing = np.full((3, driven.time_s.size), -1)
    begins = np.full(len(road.lanes), -1)
    for number, connection in enumerate(road.connections):
        begins[road.lane_index[connection.from_lane]] = number
    drives = rows[~driven.walking[rows]]
    if drives.size:
        bodies = driven.bodies
        lane = LaneGraph.of(road).project(bodies.xy[drives], bodies.heading[drives]).lane
        link[drives], ahead[drives] = road.connection_of_lane[lane], begins[lane]
    on_link = link >= 0
    walks = rows[driven.walking[rows]]
    for number, place in enumerate(road.crossings):
        u, across, total = along(place.centerline, driven.bodies.xy[walks])
        crossing[walks[(np.abs(across) <= place.width_m / 2) & (u >= 0) & (u <= total)]] = number

    def entered(row: int, on: IntArray) -> int:
        """The row in which a body came to where it is in another row."""
        first = driven.index.first[driven.index.agent[row]]
        while row > first and on[row - 1] == on[row]:
            row -= 1
        return row

    def red(row: int, group: int) -> bool:
        """Whether a light was red in a row."""
        lit = road.knows.signals and 0 <= group < tracks.signals.shape[0]
        return bool(lit and tracks.signals[group, driven.index.step[row]] == Signal.RED.code)

    def way_of(row: int) -> tuple[int, int, bool]:
        """A vehicle's connection, where it enters it, and whether it does while it is seen."""
        begin, end = driven.index.first[driven.index.agent[row] :][:2]
        inside = begin + np.flatnonzero(on_link[begin:end])
        if inside.size:
            came = int(inside[np.abs(driven.time_s[inside] - driven.time_s[row]).argmin()])
            if abs(driven.time_s[came] - driven.time_s[row]) <= NEAR_S:
                return int(link[came]), entered(came, link), True
        return int(ahead[row]), row, False

    def vehicle_first(pair: tuple[int, int]) -> int:
        """Index of the vehicle that has priority, 0 or 1; -1 if unknown."""
        (one, came, seen), (other, came_2, seen_2) = (way_of(row) for row in pair)
        if min(one, other) < 0 or one == other:
            return -1
        if np.hypot(*(driven.bodies.xy[came] - driven.bodies.xy[came_2])) > JUNCTION_M:
            return -1
        ways = road.connections[one], road.connections[other]
        stopped = red(min(pair[0], came), ways[0].signal), red(min(pair[1], came_2), ways[1].signal)
        yields = other in ways[0].yields_to, one in ways[1].yields_to
        since_s = driven.time_s[came], driven.time_s[came_2]
        if stopped[0] != stopped[1]:
            return stopped.index(False)
        if not (road.knows.priority and seen and seen_2):
            return -1
        if road.first_come(one, other):
            return -1 if since_s[0] == since_s[1] else int(since_s[0] > since_s[1])
        return -1 if yields[0] == yields[1] else yields.index(False)

    def has_priority(pair: tuple[int, int]) -> int:
        """Index of the one that has priority, 0 or 1; -1 if unknown."""
        walking = driven.walking[list(pair)]
        if not walking.any():
            return vehicle_first(pair)
        walker = int(walking.argmax())
        row = pair[walker]
        if crossing[row] < 0:
            return -1
        place = road.crossings[crossing[row]]
        goes = place.priority or place.signal >= 0
        return walker if goes and not red(entered(row, crossing), place.signal) else 1 - walker

    pairs = list(zip(first.tolist(), second.tolist(), strict=True))
    before = [(pair, has_priority(pair)) for pair in pairs]
    ids = tracks.ids[driven.index.agent]
    return np.array([ids[pair[one]] if one >= 0 else -1 for pair, one in before], dtype=np.int64)
