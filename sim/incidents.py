"""What happened in an episode or recording: rules kept and broken, near misses, who caused what.

Found from tracks and the road alone; collisions come from the tracks' own events, and are given a
cause here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.traits import Exhibit, cutting_in, runs
from sim.exhibits import see
from sim.frames import PEDESTRIAN, BoolArray, Event, EventKind, Signal, Tracks
from sim.lane_graph import LaneGraph
from sim.observables import Observables, along, observe
from sim.road import Crossing, Road

FloatArray = NDArray[np.float64]

NEAR_MISS_TTC_S: Final = 1.5
"""A time to collision below this is critical in towns (van der Horst and Hogema 1993)."""

NEAR_MISS_MPS: Final = 3.0
"""Near misses are counted above this speed (our choice)."""

GRACE_S: Final = 0.3
"""Passing a light this soon after it turned red is no red run (our choice: one glance)."""

ROLLING_MPS: Final = 0.5
"""Who passes a stop line without having been slower than this has rolled over it (our choice)."""

STOP_ZONE_M: Final = 8.0
"""Stopping counts within this before the line (our choice)."""

APPROACH_M: Final = 25.0
"""An encounter with a pedestrian begins this far before a crossing (our choice)."""

PATH_S: Final = 2.5
"""Passing in front of a pedestrian who would be there within this is not yielding (our choice:
about the time that a car needs to clear a crossing, and a second)."""

WALKING_MPS: Final = 1.3
"""At this speed a pedestrian's time to the vehicle's path is reckoned (Weidmann 1993)."""

HOLD_S: Final = 1.0
"""A yielding driver would have come to the crossing this much earlier, or sooner, unslowed."""

SLOWED: Final = 0.7
"""A yielding driver slows to less than this share of the speed at first sight (our choice)."""

RECENT_S: Final = 8.0
"""A rule broken at a junction this long before a collision caused it (our choice: the time to
cross the junction)."""

CUT_IN_S: Final = 3.0
"""A cut-in causes a collision within this."""


_STOP_SIGNALS: Final = (Signal.RED.code, Signal.YELLOW.code)


def incidents(tracks: Tracks, road: Road, observed: Observables | None = None) -> tuple[Event, ...]:
    """All events of an episode or recording.

    Args:
        tracks: what was seen; its own events (collisions, removals) are kept.
        road: where it happened.
        observed: its observables, if they are at hand.

    Returns:
        Events in order of time; of each collision, ``agent`` is the party that caused it and
        ``rule`` says why.
    """
    seen = observe(tracks, road) if observed is None else observed
    found = [
        *_lines_passed(tracks, road, seen),
        *_crossings_passed(tracks, road, seen),
        *_wrong_way(tracks, seen),
        *_near_misses(tracks, seen),
    ]
    arrays = see(tracks, road, (), seen)
    cuts = cutting_in(arrays)
    forbidden = arrays.off_crossing | arrays.on_red
    for event in tracks.events:
        if event.kind is EventKind.COLLISION and event.other is not None:
            found.append(_blame(tracks, road, seen, event, found, cuts, forbidden))
        elif event.kind is EventKind.REMOVAL:  # an engine's other events are found here, alike
            found.append(event)
    return tuple(sorted(found, key=lambda e: (e.time_s, e.agent, e.kind)))


def _lines_passed(tracks: Tracks, road: Road, seen: Observables) -> list[Event]:
    """Red lights run, stop lines rolled over, and both obeyed."""
    stops = np.zeros(len(road.lanes) + 1, dtype=bool)
    for link in road.connections:
        stops[road.lane_index[link.from_lane]] |= link.must_stop
    distance, red = seen.stop_distance, seen.signal == Signal.RED.code
    grace = round(GRACE_S / tracks.step_s)
    near = (distance[:, :-1] >= 0) & (distance[:, :-1] < 10.0)
    passed = near & ((distance[:, 1:] < 0) | (distance[:, 1:] > 30.0)) & tracks.valid[:, 1:]
    found = []
    for row, column in zip(*np.nonzero(passed), strict=True):
        agent, time_s = int(tracks.ids[row]), float(tracks.time_s[column + 1])
        before = slice(max(column - grace, 0), column + 1)
        if red[row, before].all():
            found.append(Event(EventKind.RED_RUN, time_s, agent))
        elif _stood_at_red(tracks, seen, int(row), int(column)):
            found.append(Event(EventKind.STOPPED, time_s, agent, rule="red light"))
        if stops[seen.lane[row, column]]:
            zone = _zone(distance[row], int(column), STOP_ZONE_M)
            rolled = tracks.speed[row, zone].min() > ROLLING_MPS
            kind = EventKind.STOP_ROLLED if rolled else EventKind.STOPPED
            found.append(Event(kind, time_s, agent, rule="" if rolled else "stop line"))
    return found


def _zone(distance: FloatArray, column: int, reach_m: float) -> slice:
    """The columns up to ``column`` in which the line was within reach."""
    begin = column
    while begin > 0 and 0 <= distance[begin - 1] < reach_m:
        begin -= 1
    return slice(begin, column + 1)


def _stood_at_red(tracks: Tracks, seen: Observables, row: int, column: int) -> bool:
    """Whether somebody stood first in line at a red light before passing the line."""
    zone = _zone(seen.stop_distance[row], column, STOP_ZONE_M)
    red = seen.signal[row, zone] == Signal.RED.code
    first = seen.gap[row, zone] > seen.stop_distance[row, zone]
    return bool((red & first & (tracks.speed[row, zone] < ROLLING_MPS)).any())


def _crossings_passed(tracks: Tracks, road: Road, seen: Observables) -> list[Event]:
    """Pedestrians let go first or not, at every passing of a crossing that they have a right to."""
    walkers = np.flatnonzero(tracks.kind == PEDESTRIAN)
    drivers = np.flatnonzero(tracks.kind != PEDESTRIAN)
    if not walkers.size or not drivers.size:
        return []
    found = []
    forward = np.stack([np.cos(tracks.heading), np.sin(tracks.heading)], axis=2)
    front = tracks.xy + 0.5 * tracks.length[:, None, None] * forward
    for crossing in road.crossings:
        if crossing.signal < 0 and not crossing.priority:
            continue
        people = _people(tracks, crossing, walkers)
        if not people:
            continue
        u, across = _along(crossing, front[drivers])
        _, _, total = along(crossing.centerline, np.zeros((1, 2)))
        inside = (np.abs(across) <= crossing.width_m / 2) & (u >= 0) & (u <= total)
        for k, begin, _ in runs(inside & tracks.valid[drivers]):
            if begin == 0 or not tracks.valid[drivers[k], begin - 1]:
                continue
            row = int(drivers[k])
            verdict = _verdict(tracks, seen, people, row, begin, u[k], across[k])
            if verdict is not None:
                kind, other = verdict
                found.append(Event(kind, float(tracks.time_s[begin]), int(tracks.ids[row]), other))
    return found


_Person = tuple[int, int, int, FloatArray, float]
"""Row, first and last column on a crossing, distance along it at all times, and direction."""


def _along(crossing: Crossing, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    u, across, _ = along(crossing.centerline, np.nan_to_num(xy, nan=1e6).reshape(-1, 2))
    return u.reshape(xy.shape[:-1]), across.reshape(xy.shape[:-1])


def _people(tracks: Tracks, crossing: Crossing, walkers: NDArray[np.int64]) -> list[_Person]:
    """Everyone who walks over a crossing and may: who enters it on red may not."""
    u, across = _along(crossing, tracks.xy[walkers])
    _, _, total = along(crossing.centerline, np.zeros((1, 2)))
    on = (np.abs(across) <= crossing.width_m / 2 + 1.0) & (u > 0) & (u < total)
    found = []
    for k, begin, end in runs(on & tracks.valid[walkers], 10):
        if crossing.signal >= 0 and tracks.signals[crossing.signal, begin] == Signal.RED.code:
            continue
        way = float(np.sign(u[k, end - 1] - u[k, begin]))
        if way != 0.0:
            found.append((int(walkers[k]), begin, end - 1, u[k], way))
    return found


def _verdict(
    tracks: Tracks,
    seen: Observables,
    people: Sequence[_Person],
    row: int,
    entry: int,
    u: FloatArray,
    across: FloatArray,
) -> tuple[EventKind, int] | None:
    """Whether a vehicle that enters a crossing let those on it go first; None if nobody was."""
    half = tracks.width[row] / 2 + 0.3
    path = float(u[entry])
    yielded: tuple[EventKind, int] | None = None
    for person, begin, end, along_crossing, way in people:
        if begin > entry or end < entry - round(20.0 / tracks.step_s):
            continue
        other = int(tracks.ids[person])
        to_path = (path - along_crossing[entry]) * way - half  # m still to walk to the path
        if begin < entry <= end and -2 * half < to_path < PATH_S * WALKING_MPS:
            return EventKind.NOT_YIELDED, other
        if to_path > 0 and end >= entry:
            continue
        walked = np.flatnonzero((path - along_crossing[begin : entry + 1]) * way + half <= 0)
        if not walked.size:
            continue
        clear = begin + int(walked[0])  # when the person had left the vehicle's path
        if not tracks.valid[row, begin]:
            continue
        distance = abs(float(across[begin])) - abs(float(across[entry]))
        speed = max(float(tracks.speed[row, begin]), ROLLING_MPS)
        unslowed = begin + distance / speed / tracks.step_s
        here = abs(float(across[clear])) - abs(float(across[entry]))
        first = seen.gap[row, clear] > here or here < 5.0
        if seen.stop_distance[row, clear] >= 0 and seen.signal[row, clear] in _STOP_SIGNALS:
            continue
        slowed = tracks.speed[row, begin : clear + 1].min() < max(SLOWED * speed, ROLLING_MPS)
        if here <= APPROACH_M and first and slowed and unslowed < clear + HOLD_S / tracks.step_s:
            yielded = EventKind.YIELDED, other
    return yielded


def _wrong_way(tracks: Tracks, seen: Observables) -> list[Event]:
    wrong = (
        tracks.valid
        & (seen.lane >= 0)
        & (np.abs(np.nan_to_num(seen.lane_heading)) > np.pi / 2)
        & (np.nan_to_num(tracks.speed) > ROLLING_MPS)
    )
    found = []
    for row, begin, end in runs(wrong, round(1.0 / tracks.step_s)):
        metres = float(tracks.speed[row, begin:end].sum()) * tracks.step_s
        time_s = float(tracks.time_s[begin])
        agent = int(tracks.ids[row])
        found.append(Event(EventKind.WRONG_WAY, time_s, agent, rule=f"{metres:.0f} m"))
    return found


def _near_misses(tracks: Tracks, seen: Observables) -> list[Event]:
    close = (
        tracks.valid
        & (seen.time_to_collision < NEAR_MISS_TTC_S)
        & (np.nan_to_num(tracks.speed) > NEAR_MISS_MPS)
        & (seen.gap > 0)
    )
    return [
        Event(
            kind=EventKind.NEAR_MISS,
            time_s=float(tracks.time_s[begin]),
            agent=int(tracks.ids[row]),
            other=int(tracks.ids[seen.leader[row, begin]]),
            rule=f"time to collision {seen.time_to_collision[row, begin:end].min():.2f} s",
        )
        for row, begin, end in runs(close)
    ]


def _blame(
    tracks: Tracks,
    road: Road,
    seen: Observables,
    collision: Event,
    events: Sequence[Event],
    cuts: Sequence[Exhibit],
    forbidden: BoolArray,
) -> Event:
    """The collision with its cause.

    In this order: who ran a red light or a stop and has not left the junction, drove the wrong
    way, walked where one may not, did not yield to a pedestrian, cut in just before, took another's
    priority, ran into somebody who stood; else who followed.
    """
    assert collision.other is not None
    pair = (collision.agent, collision.other)
    time_s = collision.time_s
    rows = {agent: int(np.searchsorted(tracks.ids, agent)) for agent in pair}
    column = min(int(np.searchsorted(tracks.time_s, time_s - 1e-6)), tracks.time_s.size - 1)
    for kind, rule, recent_s in (
        (EventKind.RED_RUN, "ran a red light", RECENT_S),
        (EventKind.STOP_ROLLED, "rolled over a stop line", RECENT_S),
        (EventKind.WRONG_WAY, "drove the wrong way", 2 * RECENT_S),
    ):
        for event in reversed(events):
            if event.kind is not kind or event.agent not in pair or event.time_s > time_s + 0.5:
                continue
            still_inside = _way(tracks, road, seen, rows[event.agent], column) is not None
            if still_inside or time_s - event.time_s <= recent_s:
                return _caused(collision, event.agent, rule)
    for agent, other in (pair, pair[::-1]):
        if tracks.kind[rows[agent]] == PEDESTRIAN:
            walks = slice(max(column - 1, 0), column + 1)
            if forbidden[rows[agent], walks].any():
                return _caused(collision, agent, "walked where or when one may not")
            return _caused(collision, other, "did not yield to a pedestrian")
    for cut in reversed(cuts):
        cutter, victim = int(tracks.ids[cut.agent]), int(tracks.ids[cut.other])
        if {cutter, victim} == set(pair) and -0.5 <= time_s - cut.begin_s <= CUT_IN_S:
            return _caused(collision, cutter, f"cut in {cut.value:.2f} s before the other")
    return _priority_or_follower(tracks, road, seen, collision, rows, column)


def _caused(collision: Event, agent: int, rule: str) -> Event:
    other = collision.other if agent == collision.agent else collision.agent
    return Event(EventKind.COLLISION, collision.time_s, agent, other, rule)


def _priority_or_follower(
    tracks: Tracks,
    road: Road,
    seen: Observables,
    collision: Event,
    rows: dict[int, int],
    column: int,
) -> Event:
    assert collision.other is not None
    pair = (collision.agent, collision.other)
    ways = {agent: _way(tracks, road, seen, rows[agent], column) for agent in pair}
    for agent, other in (pair, pair[::-1]):
        mine, theirs = ways[agent], ways[other]
        if mine is None or theirs is None or mine == theirs:
            continue
        if theirs in road.connections[mine].yields_to:
            return _caused(collision, agent, "took another's priority")
    standing = [tracks.speed[rows[agent], column] < ROLLING_MPS for agent in pair]
    if standing[0] != standing[1]:
        return _caused(collision, pair[int(standing[0])], "ran into somebody who stood")
    a, b = (rows[agent] for agent in pair)
    facing = np.array([np.cos(tracks.heading[a, column]), np.sin(tracks.heading[a, column])])
    ahead = float((tracks.xy[b, column] - tracks.xy[a, column]) @ facing)
    follower = pair[0] if not ahead < 0 else pair[1]
    return _caused(collision, follower, "followed too closely")


def _way(tracks: Tracks, road: Road, seen: Observables, row: int, column: int) -> int | None:
    """The connection that a vehicle drives at a junction; None if it is not inside one."""
    graph = LaneGraph.of(road)
    lane = int(seen.lane[row, column])
    if lane < 0 or not graph.internal[lane]:
        return None
    name = road.lanes[lane].id
    for index, link in enumerate(road.connections):
        if name in link.via:
            return index
    return None
