"""Whether vehicles let pedestrians go first at crossings where pedestrians have priority.

An encounter needs three things. The pedestrian is in the vehicle's way, or would have been, had the
vehicle driven on unhindered from when the pedestrian stepped on the crossing. The driver could have
stopped then. And only the pedestrian held the vehicle: no red light, no leader, no vehicle on a
connection that crosses or joins its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from sim.episode.observables import Observables
from sim.frames import Event, EventKind, FloatArray, IntArray, Signal, Tracks, says_stop
from sim.road import Crossing, Road
from sim.road.lane_search import along

ROLLING_MPS: Final = 0.5
"""A vehicle below this speed has stopped (slower than walking)."""

PATH_S: Final = 2.5
"""A pedestrian who reaches the vehicle's path within this time is in its way (about the time that a
car needs to clear a crossing, and a second)."""

WALKING_MPS: Final = 1.3
"""Speed at which a pedestrian is assumed to reach the vehicle's path (Weidmann 1993)."""

COULD_STOP_MPS2: Final = 3.4
"""Braking that most drivers find comfortable (AASHTO Green Book 2018). A driver who would need
more than this when the pedestrian steps on the crossing could not have yielded: no encounter."""

PULLING_AWAY_MPS2: Final = 1.5
"""Acceleration of an unhindered driver from a stop (an average driver)."""

FORESIGHT_S: Final = 2.0
"""A driver who waits for another vehicle sees it enter the junction this soon."""

ON_CROSSING_M: Final = 0.3
"""A pedestrian this far beyond the kerb has stepped on the crossing (half a stride)."""

LONGEST_WAIT_S: Final = 20.0
"""A pedestrian who left the crossing this long ago has nothing to do with a passing vehicle."""


class Walk(NamedTuple):
    """One pedestrian's walk over a crossing.

    Attributes:
        person: the pedestrian's id.
        begin, end: column in which it steps on the crossing, and the last one on it.
        along: (T,) distance along the crossing, m; NaN where not seen.
        direction: 1 or -1, the sign of its motion along the crossing.
    """

    person: int
    begin: int
    end: int
    along: FloatArray
    direction: float

    def blocks(self, path: float, half: float, column: int) -> bool:
        """Whether the pedestrian is in a vehicle's path, or soon would be, at one time.

        The path is at a distance along the crossing, m, and has a half width, m.
        """
        if not self.begin < column <= self.end:
            return False
        to_path = float(path - self.along[column]) * self.direction - half  # m left to walk to it
        return -2 * half < to_path < PATH_S * WALKING_MPS


def crossings_passed(tracks: Tracks, road: Road, observed: Observables) -> list[Event]:
    """Events of vehicles that let a pedestrian go first at a crossing, or did not."""
    row_index = tracks.index
    walkers, driving = np.flatnonzero(tracks.walking), np.flatnonzero(~tracks.walking)
    if not walkers.size:
        return []
    found = []
    xy = tracks.row_xy[driving]
    longest = float(tracks.length.max())
    for crossing in road.crossings:
        if crossing.signal < 0 and not crossing.priority:
            continue
        walks = _walks(tracks, crossing, walkers)
        if not walks:
            continue
        line, reach = crossing.centerline, crossing.width_m + longest / 2
        near = (xy >= line.min(axis=0) - reach) & (xy <= line.max(axis=0) + reach)
        near = driving[near.all(axis=1)]
        facing = tracks.row_heading[near]
        forward = np.stack([np.cos(facing), np.sin(facing)], axis=1)
        front = tracks.row_xy[near] + 0.5 * tracks.length[row_index.agent[near], None] * forward
        u, across, total = along(line, front)
        inside = (np.abs(across) <= crossing.width_m / 2) & (u >= 0) & (u <= total)
        on = np.zeros(tracks.row_speed.size, dtype=bool)
        on[near[inside]] = True
        for run in row_index.runs(on):
            if row_index.begins[run.start]:
                continue
            path = float(u[np.searchsorted(near, run.start)])
            verdict = _verdict(tracks, road, observed, walks, run.start, path)
            if verdict is not None:
                agent, time_s = tracks.agent_and_time(run.start)
                found.append(Event(verdict[0], time_s, agent, verdict[1]))
    return found


def _walks(tracks: Tracks, crossing: Crossing, walkers: IntArray) -> list[Walk]:
    """Every walk over a crossing that was not begun on red; ``walkers`` are pedestrians' rows."""
    row_index = tracks.index
    u = np.full(tracks.row_speed.size, np.nan)
    u[walkers], across, total = along(crossing.centerline, tracks.row_xy[walkers])
    on = np.zeros(u.size, dtype=bool)
    on[walkers] = np.abs(across) <= crossing.width_m / 2 + 1.0
    on &= (u > ON_CROSSING_M) & (u < total - ON_CROSSING_M)
    found = []
    for run in row_index.runs(on, 10):
        agent, begin = int(row_index.agent[run.start]), int(row_index.step[run.start])
        lit = 0 <= crossing.signal < tracks.signals.shape[0]  # recordings show no signals
        if lit and tracks.signals[crossing.signal, begin] == Signal.RED.code:
            continue
        direction = float(np.sign(u[run.stop - 1] - u[run.start]))
        if direction != 0.0:
            at = row_index.over(u, agent, 0, row_index.times, np.nan)
            last = int(row_index.step[run.stop - 1])
            found.append(Walk(int(tracks.ids[agent]), begin, last, at, direction))
    return found


def _verdict(
    tracks: Tracks, road: Road, observed: Observables, walks: Sequence[Walk], row: int, path: float
) -> tuple[EventKind, int] | None:
    """Whether a vehicle let a pedestrian go first, and the pedestrian's id; None if none met it.

    The vehicle's front comes to the crossing in ``row``, at ``path`` m along it.
    """
    row_index, step_s = tracks.index, tracks.step_s
    agent, entry = int(row_index.agent[row]), int(row_index.step[row])
    half = tracks.width[agent] / 2 + 0.3
    yielded: tuple[EventKind, int] | None = None
    for walk in walks:
        begin = walk.begin
        if not begin < entry or walk.end < entry - round(LONGEST_WAIT_S / step_s):
            continue
        come = row - (entry - begin)  # the row at which the pedestrian stepped on the crossing,
        if come < row_index.first[agent] or row_index.step[come] != begin:
            continue  # unless the vehicle was lost from sight in between

        speed = tracks.row_speed[come : row + 1]
        left_m = float(speed.sum()) * step_s - np.cumsum(speed) * step_s
        if walk.blocks(path, half, entry):
            if could_stop(float(speed[0]), float(left_m[0])):
                return EventKind.NOT_YIELDED, walk.person
            continue
        walked = np.flatnonzero((path - walk.along[begin : entry + 1]) * walk.direction + half <= 0)
        if not walked.size:
            continue
        clear = int(walked[0])  # columns from begin until it had left the vehicle's path
        span = slice(come, come + clear + 1)
        held = (observed.stop_distance[span] >= 0) & says_stop(observed.signal[span])
        held |= observed.gap[span] < left_m[: clear + 1]
        since = int(np.flatnonzero(held)[-1]) + 1 if held.any() else 0
        if since >= clear or not could_stop(float(speed[since]), float(left_m[since])):
            continue
        limit = float(observed.limit[come + since : row + 1].min(initial=np.inf))
        pulled_s = _unhindered_s(float(speed[since]), float(left_m[since]), limit)
        if not walk.blocks(path, half, begin + since + round(pulled_s / step_s)):
            continue
        until = begin + clear + round(FORESIGHT_S / step_s)
        if not _others_cross(tracks, road, observed, come + since, row, until):
            yielded = EventKind.YIELDED, walk.person
    return yielded


def could_stop(speed: float, distance: float) -> bool:
    """Whether a driver can stop within a distance, m, by braking with `COULD_STOP_MPS2`."""
    return speed**2 <= 2.0 * COULD_STOP_MPS2 * max(distance, 0.0)


def _unhindered_s(speed: float, distance: float, limit: float) -> float:
    """Time in which a driver who accelerates to the limit covers a distance, s."""
    start = min(speed, limit)
    if not np.isfinite(limit):
        return distance / max(start, ROLLING_MPS)
    rising_s = (limit - start) / PULLING_AWAY_MPS2
    rising_m = (start + limit) / 2.0 * rising_s
    if rising_m >= distance:
        root = float(np.sqrt(start**2 + 2.0 * PULLING_AWAY_MPS2 * distance))
        return (root - start) / PULLING_AWAY_MPS2
    return rising_s + (distance - rising_m) / limit


def _others_cross(
    tracks: Tracks, road: Road, observed: Observables, since: int, entry: int, until: int
) -> bool:
    """Whether another vehicle was on a connection that crosses or joins this vehicle's."""
    row_index, link_of = tracks.index, road.connection_of_lane
    agent, begin = int(row_index.agent[entry]), int(row_index.step[since])
    soon = int(row_index.step[entry]) + round(5.0 / tracks.step_s)
    near = link_of[observed.lane[row_index.rows(agent, begin, soon)]]
    mine = near[near >= 0]
    if not mine.size:
        return False
    own = int(mine[0])
    foes = [i for i, link in enumerate(road.connections) if own in link.yields_to]
    rows, begins = row_index.by_time
    rows = rows[begins[begin] : begins[min(until + 1, row_index.times)]]
    others = link_of[observed.lane[rows[row_index.agent[rows] != agent]]]
    return bool(np.isin(others, [*foes, *road.connections[own].yields_to]).any())
