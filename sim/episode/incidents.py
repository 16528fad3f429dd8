"""What happened in an episode or recording: rules kept and broken, near misses, who caused what.

Found from positions and the road alone; collisions come from the engine's own events too, and are
given a cause here.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.row_index import RowIndex
from behaviors.traits import Exhibit, Seen, cutting_in
from sim.episode.contacts import Contact, contacts
from sim.episode.observables import Observables, observe
from sim.episode.rows import TrajectoryRows
from sim.episode.shown_traits import see
from sim.frames import PEDESTRIAN, BoolArray, Event, EventKind, Signal, says_stop
from sim.road import Crossing, Road
from sim.road.lane_search import along

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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

PATH_S: Final = 2.5
"""Passing in front of a pedestrian who would be there within this is not yielding (our choice:
about the time that a car needs to clear a crossing, and a second)."""

WALKING_MPS: Final = 1.3
"""At this speed a pedestrian's time to the vehicle's path is reckoned (Weidmann 1993)."""

COULD_STOP_MPS2: Final = 3.4
"""Who would have to brake harder than this, comfortable to most (AASHTO Green Book 2018), when the
pedestrian steps on the crossing could not have yielded: no encounter."""

PULLING_AWAY_MPS2: Final = 1.5
"""How a driver who is not hindered would get going (our choice: an average driver)."""

FORESIGHT_S: Final = 2.0
"""Who waits for a vehicle sees it enter the junction this soon (our choice)."""

ON_CROSSING_M: Final = 0.3
"""Who is this far beyond the kerb has stepped on the crossing (our choice: half a stride)."""

RECENT_S: Final = 8.0
"""A rule broken at a junction this long before a collision caused it (our choice: the time to
cross the junction)."""

CUT_IN_S: Final = 3.0
"""A cut-in causes a collision within this."""

TURNED_M: Final = 6.0
"""Whose rear is no farther beyond a junction may still be straightening up (our choice: a car's
length and more)."""

STOOD_M: Final = 0.5
"""Who has moved less than this since stood where it was hit (our choice)."""

REACTION_S: Final = 1.0
"""A driver reacts to who stands in the way after this (Green 2000, Transportation Human Factors
2(3): 0.7 s when expected, 1.25 s when not)."""

APART_S: Final = 3.0
"""Two who touch again within this have not collided anew (our choice)."""

BETWEEN_LANES_M: Final = 0.2
"""Whose box reaches this far over the marking of its lane is between lanes (our choice: cars that
keep their lane stay 0.7 m from it)."""


def incidents(
    steps: TrajectoryRows,
    road: Road,
    observed: Observables | None = None,
    arrays: Seen | None = None,
    *,
    recorded: bool = False,
) -> tuple[Event, ...]:
    """All events of an episode or recording.

    Args:
        steps: what was seen; its own events (collisions, removals) are kept.
        road: where it happened.
        observed: its observables, if they are at hand.
        arrays: what the trait detectors look at (`sim.episode.shown_traits.see`), if it is at hand.
        recorded: whether boxes were measured, not simulated: then two that overlap have not
            collided, but were measured a little wrong.

    Returns:
        Events in order of time; of each collision, ``agent`` is the party that caused it and
        ``rule`` says why.
    """
    seen = observe(steps, road) if observed is None else observed
    found = [
        *_lines_passed(steps, road, seen),
        *_crossings_passed(steps, road, seen),
        *_wrong_way(steps, seen),
        *_near_misses(steps, seen),
    ]
    collisions = _collisions(steps, () if recorded else contacts(steps))
    if collisions:
        arrays = see(steps, road, seen) if arrays is None else arrays
        cuts, forbidden = cutting_in(arrays), arrays.off_crossing | arrays.on_red
    for pair, columns in collisions:
        first = Event(EventKind.COLLISION, float(steps.time_s[columns[0]]), *pair)
        collision = _blame(steps, road, seen, first, found, cuts, forbidden)
        found.append(collision)
        found += [
            dataclasses.replace(collision, kind=EventKind.CONTACT, time_s=float(time_s))
            for time_s in steps.time_s[columns[1:]]
        ]
    # an engine's other events are found here, alike
    found += [event for event in steps.events if event.kind is EventKind.REMOVAL]
    return tuple(sorted(found, key=lambda e: (e.time_s, e.agent, e.kind)))


def _lines_passed(steps: TrajectoryRows, road: Road, seen: Observables) -> list[Event]:
    """Red lights run, stop lines rolled over, and both obeyed."""
    stops = np.zeros(len(road.lanes) + 1, dtype=bool)
    for link in road.connections:
        stops[road.lane_index[link.from_lane]] |= link.must_stop
    row_index, distance = steps.row_index, seen.stop_distance
    red = seen.signal == Signal.RED.code
    grace = round(GRACE_S / steps.step_s)
    passed = (distance[:-1] >= 0) & (distance[:-1] < 10.0) & ~row_index.begins[1:]
    passed &= (distance[1:] < 0) | (distance[1:] > 30.0)
    found = []
    for row in np.flatnonzero(passed).tolist():  # the last before the line
        number, column = int(row_index.agent[row]), int(row_index.step[row])
        agent, time_s = int(steps.ids[number]), float(steps.time_s[column + 1])
        zone = _zone(row_index, distance, row)
        if row_index.over(red, number, max(column - grace, 0), column + 1, False).all():
            found.append(Event(EventKind.RED_RUN, time_s, agent))
        elif _stood_at_red(steps, seen, zone):
            found.append(Event(EventKind.STOPPED, time_s, agent, rule="red light"))
        if stops[seen.lane[row]]:
            rolled = steps.speed[zone].min() > ROLLING_MPS
            kind = EventKind.STOP_ROLLED if rolled else EventKind.STOPPED
            found.append(Event(kind, time_s, agent, rule="" if rolled else "stop line"))
    return found


def _zone(row_index: RowIndex, distance: FloatArray, row: int) -> slice:
    """The rows up to ``row`` in which the line was within reach."""
    begin = row
    while not row_index.begins[begin] and 0 <= distance[begin - 1] < STOP_ZONE_M:
        begin -= 1
    return slice(begin, row + 1)


def _stood_at_red(steps: TrajectoryRows, seen: Observables, zone: slice) -> bool:
    """Whether somebody stood first in line at a red light before passing the line."""
    red = seen.signal[zone] == Signal.RED.code
    first = seen.gap[zone] > seen.stop_distance[zone]
    return bool((red & first & (steps.speed[zone] < ROLLING_MPS)).any())


def _crossings_passed(steps: TrajectoryRows, road: Road, seen: Observables) -> list[Event]:
    """Pedestrians let go first or not, at every passing of a crossing that they have a right to."""
    walking, row_index = steps.walking, steps.row_index
    walkers = np.flatnonzero(walking)
    if not walkers.size:
        return []
    found = []
    driving = np.flatnonzero(~walking)
    xy = steps.xy[driving]
    longest = float(steps.length.max())
    ways = _ways(road)[seen.lane]
    for crossing in road.crossings:
        if crossing.signal < 0 and not crossing.priority:
            continue
        people = _people(steps, crossing, walkers)
        if not people:
            continue
        near = driving[_near(crossing, xy, longest / 2)]
        facing = steps.heading[near]
        forward = np.stack([np.cos(facing), np.sin(facing)], axis=1)
        front = steps.xy[near] + 0.5 * steps.length[row_index.agent[near], None] * forward
        u, across, total = along(crossing.centerline, front)
        inside = (np.abs(across) <= crossing.width_m / 2) & (u >= 0) & (u <= total)
        on = np.zeros(steps.speed.size, dtype=bool)
        on[near[inside]] = True
        for run in row_index.runs(on):
            if row_index.begins[run.start]:
                continue
            path = float(u[np.searchsorted(near, run.start)])
            verdict = _verdict(steps, road, seen, people, run.start, path, ways)
            if verdict is not None:
                kind, other = verdict
                agent, time_s = _who_and_when(steps, run.start)
                found.append(Event(kind, time_s, agent, other))
    return found


def _near(crossing: Crossing, xy: FloatArray, beyond_m: float) -> NDArray[np.int64]:
    """(k,) which of some places are at most so far beyond a crossing, and few others."""
    reach = crossing.width_m + beyond_m
    low, high = crossing.centerline.min(axis=0) - reach, crossing.centerline.max(axis=0) + reach
    return np.flatnonzero(((xy >= low) & (xy <= high)).all(axis=1))


_Person = tuple[int, int, int, FloatArray, float]
"""Id, first and last column on a crossing, distance along it at all times, and direction."""


def _people(steps: TrajectoryRows, crossing: Crossing, walkers: IntArray) -> list[_Person]:
    """Everyone who walks over a crossing and may: who enters it on red may not.

    Args:
        steps: the episode.
        crossing: the crossing.
        walkers: (k,) rows of pedestrians.
    """
    row_index = steps.row_index
    u = np.full(steps.speed.size, np.nan)
    u[walkers], across, total = along(crossing.centerline, steps.xy[walkers])
    on = np.zeros(u.size, dtype=bool)
    on[walkers] = np.abs(across) <= crossing.width_m / 2 + 1.0
    on &= (u > ON_CROSSING_M) & (u < total - ON_CROSSING_M)
    found = []
    for run in row_index.runs(on, 10):
        agent, begin = int(row_index.agent[run.start]), int(row_index.step[run.start])
        if crossing.signal >= 0 and steps.signals[crossing.signal, begin] == Signal.RED.code:
            continue
        way = float(np.sign(u[run.stop - 1] - u[run.start]))
        if way != 0.0:
            at = row_index.over(u, agent, 0, row_index.times, np.nan)
            last = int(row_index.step[run.stop - 1])
            found.append((int(steps.ids[agent]), begin, last, at, way))
    return found


def _verdict(
    steps: TrajectoryRows,
    road: Road,
    seen: Observables,
    people: Sequence[_Person],
    row: int,
    path: float,
    ways: IntArray,
) -> tuple[EventKind, int] | None:
    """Whether a vehicle that enters a crossing let those on it go first; None if nobody was.

    An encounter is with somebody who is in the vehicle's way, or would be, had it driven on
    unhindered from when the pedestrian stepped on the crossing; the driver could have stopped then;
    and nothing but the pedestrian held it: no red light, no leader, no vehicle on a way that
    crosses or joins its own.

    Args:
        steps: the episode.
        road: where it happened.
        seen: its observables.
        people: who walked over the crossing.
        row: in which the vehicle's front comes to the crossing.
        path: where it drives, as a distance along the crossing, m.
        ways: (m,) what `_ways` says of the lane of each row.
    """
    row_index, step_s = steps.row_index, steps.step_s
    agent, entry = int(row_index.agent[row]), int(row_index.step[row])
    half = steps.width[agent] / 2 + 0.3
    yielded: tuple[EventKind, int] | None = None
    for one in people:
        person, begin, end, u, way = one
        if not begin < entry or end < entry - round(20.0 / step_s):
            continue
        come = row - (entry - begin)  # the row of when the person stepped on the crossing,
        if come < row_index.first[agent] or row_index.step[come] != begin:
            continue  # if the vehicle was seen ever since

        speed = steps.speed[come : row + 1]
        left_m = float(speed.sum()) * step_s - np.cumsum(speed) * step_s
        if _in_the_way(one, path, half, entry):
            if _could_stop(float(speed[0]), float(left_m[0])):
                return EventKind.NOT_YIELDED, person
            continue
        walked = np.flatnonzero((path - u[begin : entry + 1]) * way + half <= 0)
        if not walked.size:
            continue
        clear = int(walked[0])  # counted from begin: when the person had left the vehicle's path
        span = slice(come, come + clear + 1)
        held = (seen.stop_distance[span] >= 0) & says_stop(seen.signal[span])
        held |= seen.gap[span] < left_m[: clear + 1]
        since = int(np.flatnonzero(held)[-1]) + 1 if held.any() else 0
        if since >= clear or not _could_stop(float(speed[since]), float(left_m[since])):
            continue
        limit = float(seen.limit[come + since : row + 1].min(initial=np.inf))
        pulled_s = _unhindered_s(float(speed[since]), float(left_m[since]), limit)
        if not _in_the_way(one, path, half, begin + since + round(pulled_s / step_s)):
            continue
        until = begin + clear + round(FORESIGHT_S / step_s)
        if not _others_cross(steps, road, ways, come + since, row, until):
            yielded = EventKind.YIELDED, person
    return yielded


def _in_the_way(person: _Person, path: float, half: float, column: int) -> bool:
    """Whether a pedestrian is in a vehicle's path, or would soon be, at one time."""
    _, begin, end, u, way = person
    if not begin < column <= end:
        return False
    to_path = float(path - u[column]) * way - half  # m still to walk to it
    return -2 * half < to_path < PATH_S * WALKING_MPS


def _could_stop(speed: float, distance: float) -> bool:
    return speed**2 <= 2.0 * COULD_STOP_MPS2 * max(distance, 0.0)


def _unhindered_s(speed: float, distance: float, limit: float) -> float:
    """Time to drive a distance, s, by who pulls away to the limit and drives on."""
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
    steps: TrajectoryRows, road: Road, ways: IntArray, since: int, entry: int, until: int
) -> bool:
    """Whether a vehicle was on a way through the junction that crosses or joins another's.

    Args:
        steps: the episode.
        road: where it happened.
        ways: (m,) as in `_verdict`.
        since: row of the vehicle from which on others count.
        entry: row in which it enters the crossing.
        until: last column in which others count.
    """
    row_index = steps.row_index
    agent, begin = int(row_index.agent[entry]), int(row_index.step[since])
    soon = int(row_index.step[entry]) + round(5.0 / steps.step_s)
    near = ways[row_index.rows(agent, begin, soon)]
    mine = near[near >= 0]
    if not mine.size:
        return False
    own = int(mine[0])
    foes = {
        index
        for index, link in enumerate(road.connections)
        if own in link.yields_to or index in road.connections[own].yields_to
    }
    if not foes:
        return False
    others = np.flatnonzero(np.isin(ways, list(foes)))
    step = row_index.step[others]
    others = others[(step >= begin) & (step <= until)]
    return bool((row_index.agent[others] != agent).any())


@functools.lru_cache(maxsize=32)
def _ways(road: Road) -> NDArray[np.int64]:
    """(L + 1,) the connection that each lane is part of; -1 outside junctions and for no lane."""
    ways = np.full(len(road.lanes) + 1, -1, dtype=np.int64)
    for index, link in enumerate(road.connections):
        for name in link.via:
            if name in road.lane_index and ways[road.lane_index[name]] < 0:
                ways[road.lane_index[name]] = index
    return ways


def _wrong_way(steps: TrajectoryRows, seen: Observables) -> list[Event]:
    wrong = (np.abs(seen.lane_heading) > np.pi / 2) & (steps.speed > ROLLING_MPS)
    found = []
    for run in steps.row_index.runs(wrong, round(1.0 / steps.step_s)):
        metres = float(steps.speed[run].sum()) * steps.step_s
        agent, time_s = _who_and_when(steps, run.start)
        found.append(Event(EventKind.WRONG_WAY, time_s, agent, rule=f"{metres:.0f} m"))
    return found


def _near_misses(steps: TrajectoryRows, seen: Observables) -> list[Event]:
    close = seen.time_to_collision < NEAR_MISS_TTC_S
    close &= (steps.speed > NEAR_MISS_MPS) & (seen.gap > 0)
    found = []
    for run in steps.row_index.runs(close):
        agent, time_s = _who_and_when(steps, run.start)
        other, _ = _who_and_when(steps, int(seen.leader[run.start]))
        least = f"time to collision {seen.time_to_collision[run].min():.2f} s"
        found.append(Event(EventKind.NEAR_MISS, time_s, agent, other, rule=least))
    return found


def _who_and_when(steps: TrajectoryRows, row: int) -> tuple[int, float]:
    """The agent's id and the time, s, of a row."""
    row_index = steps.row_index
    return int(steps.ids[row_index.agent[row]]), float(steps.time_s[row_index.step[row]])


def _collisions(
    steps: TrajectoryRows, touches: Sequence[Contact]
) -> list[tuple[tuple[int, int], NDArray[np.int64]]]:
    """Who collided, and the columns in which they touch: by the engine's word or by their boxes.

    Boxes alone do not tell that a pedestrian was hit: who waits at a kerb stands where a turning
    vehicle's box sweeps over the corner. So pedestrians are hit only if the engine says so.
    """
    flags: dict[tuple[int, int], NDArray[np.bool_]] = {}
    pairs: dict[tuple[int, int], tuple[int, int]] = {}
    for event in steps.events:
        if event.kind in (EventKind.COLLISION, EventKind.CONTACT) and event.other is not None:
            pair = (min(event.agent, event.other), max(event.agent, event.other))
            pairs.setdefault(pair, (event.agent, event.other))
            at = min(int(np.searchsorted(steps.time_s, event.time_s - 1e-6)), steps.time_s.size - 1)
            flags.setdefault(pair, np.zeros(steps.time_s.size, dtype=bool))[at] = True
    for contact in touches:
        pair = (int(steps.ids[contact.agents[0]]), int(steps.ids[contact.agents[1]]))
        if pair not in flags and PEDESTRIAN in steps.kind[list(contact.agents)]:
            continue
        flags.setdefault(pair, np.zeros(steps.time_s.size, dtype=bool))
        flags[pair][contact.begin : contact.end] = True
    found = []
    for pair, touch in flags.items():
        columns = np.flatnonzero(touch)
        anew = np.flatnonzero(np.diff(columns) > round(APART_S / steps.step_s)) + 1
        found += [(pairs.get(pair, pair), part) for part in np.split(columns, anew)]
    return sorted(found, key=lambda one: (int(one[1][0]), one[0]))


def _blame(
    steps: TrajectoryRows,
    road: Road,
    seen: Observables,
    collision: Event,
    events: Sequence[Event],
    cuts: Sequence[Exhibit],
    forbidden: BoolArray,
) -> Event:
    """The collision with its cause.

    In this order: who ran a red light or a stop and has not left the junction, drove the wrong
    way, walked where one may not or into a vehicle that stood, did not yield to a pedestrian, cut
    in just before, entered a junction that another was still clearing (where lights never let
    both go, or each yields to the other), was between lanes (who changes lanes answers for it:
    German road traffic act, section 7(5)), ran into somebody who stood though there was room to
    stop, took another's priority, ran into somebody who stood; else who followed.
    """
    assert collision.other is not None
    pair = (collision.agent, collision.other)
    time_s = collision.time_s
    rows = {agent: int(np.searchsorted(steps.ids, agent)) for agent in pair}
    column = min(int(np.searchsorted(steps.time_s, time_s - 1e-6)), steps.time_s.size - 1)
    for kind, rule, recent_s in (
        (EventKind.RED_RUN, "ran a red light", RECENT_S),
        (EventKind.STOP_ROLLED, "rolled over a stop line", RECENT_S),
        (EventKind.WRONG_WAY, "drove the wrong way", 2 * RECENT_S),
    ):
        for event in reversed(events):
            if event.kind is not kind or event.agent not in pair or event.time_s > time_s + 0.5:
                continue
            still_inside = _way(steps, road, seen, rows[event.agent], column) is not None
            if still_inside or time_s - event.time_s <= recent_s:
                return _caused(collision, event.agent, rule)
    for agent, other in (pair, pair[::-1]):
        if steps.kind[rows[agent]] == PEDESTRIAN:
            walks = steps.row_index.rows(rows[agent], column - 1, column + 1)
            if forbidden[walks].any():
                return _caused(collision, agent, "walked where or when one may not")
            second = max(column - round(1.0 / steps.step_s), 0), column + 1
            if (_speed(steps, rows[other], *second) < ROLLING_MPS).all():
                return _caused(collision, agent, "walked into a vehicle that stood")
            return _caused(collision, other, "did not yield to a pedestrian")
    for cut in reversed(cuts):
        cutter, victim = int(steps.ids[cut.agent]), int(steps.ids[cut.other])
        if {cutter, victim} == set(pair) and -0.5 <= time_s - cut.begin_s <= CUT_IN_S:
            return _caused(collision, cutter, f"cut in {cut.value:.2f} s before the other")
    return _priority_or_follower(steps, road, seen, collision, rows, column)


def _caused(collision: Event, agent: int, rule: str) -> Event:
    other = collision.other if agent == collision.agent else collision.agent
    return Event(EventKind.COLLISION, collision.time_s, agent, other, rule)


def _priority_or_follower(
    steps: TrajectoryRows,
    road: Road,
    seen: Observables,
    collision: Event,
    rows: dict[int, int],
    column: int,
) -> Event:
    assert collision.other is not None
    pair = (collision.agent, collision.other)
    ways = {agent: _way(steps, road, seen, rows[agent], column) for agent in pair}
    one, two = (ways[agent] for agent in pair)
    if one is not None and two is not None and one != two and road.first_come(one, two):
        entered = [_entered(steps, seen, rows[agent], column) for agent in pair]
        later = pair[int(entered[1] > entered[0])]
        return _caused(collision, later, "entered a junction not yet clear")
    outside = [_over_marking(steps, road, seen, rows[agent], column) for agent in pair]
    if outside[0] != outside[1]:
        return _caused(collision, pair[int(outside[1])], "was between lanes")
    for agent, other in (pair, pair[::-1]):
        if _could_have_stopped(steps, rows[agent], rows[other], column):
            return _caused(collision, agent, "ran into somebody who stood")
    for agent, other in (pair, pair[::-1]):
        mine, theirs = ways[agent], ways[other]
        if mine is None or theirs is None or mine == theirs:
            continue
        if theirs in road.connections[mine].yields_to:
            return _caused(collision, agent, "took another's priority")
    row_index = steps.row_index
    standing = [_speed(steps, rows[agent], column, column + 1)[0] < ROLLING_MPS for agent in pair]
    if standing[0] != standing[1]:
        return _caused(collision, pair[int(standing[0])], "ran into somebody who stood")
    a, b = (row_index.row(rows[agent], column) for agent in pair)
    behind = False  # as it is where one of the two was not seen
    if a >= 0 and b >= 0:
        facing = np.array([np.cos(steps.heading[a]), np.sin(steps.heading[a])])
        behind = float((steps.xy[b] - steps.xy[a]) @ facing) < 0
    return _caused(collision, pair[int(behind)], "followed too closely")


def _speed(steps: TrajectoryRows, agent: int, begin: int, end: int) -> FloatArray:
    """(end - begin,) speeds of one agent, m/s, NaN where it was not seen."""
    return steps.row_index.over(steps.speed, agent, begin, end, np.nan)


def _could_have_stopped(steps: TrajectoryRows, agent: int, other: int, column: int) -> bool:
    """Whether somebody ran into another who stood there long enough to be braked for."""
    speed = _speed(steps, agent, 0, column + 1)
    if column == 0 or not speed[-2] > _speed(steps, other, column - 1, column)[0]:
        return False
    xy = steps.row_index.over(steps.xy, other, 0, column + 1, np.nan)
    away = xy - xy[-1]
    there = np.isfinite(speed) & (np.hypot(away[:, 0], away[:, 1]) < STOOD_M)
    before = np.flatnonzero(~there)
    seen_at = (int(before[-1]) + 1 if before.size else 0) + round(REACTION_S / steps.step_s)
    if seen_at >= column:
        return False
    left_m = float(speed[seen_at:column].sum()) * steps.step_s
    return _could_stop(float(speed[seen_at]), left_m)


def _entered(steps: TrajectoryRows, seen: Observables, agent: int, column: int) -> int:
    """The column in which a vehicle's front came into the junction that it is in."""
    inside = steps.row_index.over(seen.stop_distance, agent, 0, column + 1, np.inf) < 0
    outside = np.flatnonzero(~inside)
    return int(outside[-1]) + 1 if outside.size else 0


def _over_marking(
    steps: TrajectoryRows, road: Road, seen: Observables, agent: int, column: int
) -> bool:
    """Whether a vehicle's box reaches over the marking of the lane that it is on."""
    row = steps.row_index.row(agent, column)
    lane = int(seen.lane[row]) if row >= 0 else -1
    if lane < 0 or road.lanes[lane].internal:
        return False
    length, width = steps.length[agent], steps.width[agent]
    if seen.s[row] < length / 2 + TURNED_M:
        return False
    half = (width + length * abs(float(np.sin(seen.lane_heading[row])))) / 2
    reach = abs(float(seen.offset[row])) + float(half)
    return reach > road.lanes[lane].width_m / 2 + BETWEEN_LANES_M


def _way(
    steps: TrajectoryRows, road: Road, seen: Observables, agent: int, column: int
) -> int | None:
    """The connection that a vehicle drives at a junction; None if no part of it is inside one."""
    row = steps.row_index.row(agent, column)
    soon = round(RECENT_S / steps.step_s) if row >= 0 and seen.stop_distance[row] < 0 else 0
    ways = _ways(road)[seen.lane[steps.row_index.rows(agent, column, column + soon + 1)]]
    inside = np.flatnonzero(ways >= 0)
    return int(ways[inside[0]]) if inside.size else None
