"""Which of two road users has to let the other go first, as far as the map tells."""

from __future__ import annotations

import numpy as np

from sim.frames import IntArray, Signal, Tracks
from sim.road import Road
from sim.road.lane_coordinates import along
from sim.road.lane_graph import LaneGraph
from sim.safety.encounters import Driven

NEAR_S = 10.0
"""A body is on its way over a junction if it is inside within this time, s."""


def priorities(
    driven: Driven, tracks: Tracks, road: Road, first: IntArray, second: IntArray
) -> IntArray:
    """(k,) ids of those that have priority, of the bodies in (k,) rows; -1 where nobody knows.

    A pedestrian on a crossing has priority over vehicles unless the map or its red light says no.
    Between vehicles, who entered the junction on red has none; otherwise their paths decide.
    """
    rows = np.flatnonzero(np.isin(driven.index.agent, driven.index.agent[[*first, *second]]))
    link, crossing = np.full((2, driven.time_s.size), -1)
    drives = rows[~driven.walking[rows]]
    if drives.size:
        lane = (
            LaneGraph.of(road).project(driven.bodies.xy[drives], driven.bodies.heading[drives]).lane
        )
        link[drives] = road.connection_of_lane[lane]
    walks = rows[driven.walking[rows]]
    for number, place in enumerate(road.crossings):
        u, across, total = along(place.centerline, driven.bodies.xy[walks])
        crossing[walks[(np.abs(across) <= place.width_m / 2) & (u >= 0) & (u <= total)]] = number

    def red(row: int, on: IntArray, group: int) -> bool:
        """Whether the light was red when the body came to where it is now."""
        agent = driven.index.agent[row]
        while row > driven.index.first[agent] and on[row - 1] == on[row]:
            row -= 1
        if not road.knows.signals or not 0 <= group < tracks.signals.shape[0]:
            return False
        return bool(tracks.signals[group, driven.index.step[row]] == Signal.RED.code)

    def on_link(row: int) -> int:
        """The row nearest in time in which a vehicle is on a junction; -1 if that is far."""
        mine = driven.index.rows(int(driven.index.agent[row]))
        inside = mine.start + np.flatnonzero(link[mine] >= 0)
        away = np.abs(driven.time_s[inside] - driven.time_s[row])
        return int(inside[away.argmin()]) if away.min(initial=np.inf) <= NEAR_S else -1

    found = np.full(len(first), -1)
    for n, pair in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        ids = tracks.ids[driven.index.agent[list(pair)]].tolist()
        walking = driven.walking[list(pair)]
        if walking.any():
            walker = int(walking.argmax())
            row = pair[walker]
            if crossing[row] >= 0:
                place = road.crossings[crossing[row]]
                goes = place.priority or place.signal >= 0
                goes &= not red(row, crossing, place.signal)
                found[n] = ids[walker if goes else 1 - walker]
            continue
        inside = [on_link(row) for row in pair]
        links = [int(link[row]) for row in inside]
        if min(inside) < 0 or links[0] == links[1]:
            continue
        one, other = (road.connections[number] for number in links)
        stopped = [
            red(row, link, way.signal) for row, way in zip(inside, (one, other), strict=True)
        ]
        if stopped[0] != stopped[1]:
            found[n] = ids[stopped.index(False)]
        elif road.knows.priority and not road.first_come(*links):
            yields = links[1] in one.yields_to, links[0] in other.yields_to
            if yields[0] != yields[1]:
                found[n] = ids[yields.index(False)]
    return found
