"""The events of an episode or recording: rules kept and broken, near misses, collisions.

They are found from positions and the road alone. Collisions come from the engine's own events too,
and are given a cause (`sim.episode.collisions`).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from behaviors.row_index import RowIndex
from behaviors.traits import DetectorInputs
from sim.episode.collisions import collisions
from sim.episode.observables import Observables, observe
from sim.episode.yielding import ROLLING_MPS, crossings_passed
from sim.frames import Event, EventKind, FloatArray, IntArray, Signal, Tracks
from sim.road import Road
from sim.safety import (
    CONFLICT_KINDS,
    NEAR_MISS_PET_S,
    NEAR_MISS_TTC_S,
    ConflictKind,
    Conflicts,
    conflicts,
)

GRACE_S: Final = 0.3
"""Passing a light this soon after it turned red is not a red run (one glance)."""

STOP_ZONE_M: Final = 8.0
"""Stopping counts within this distance before the line (a car's length and more)."""


def incidents(
    tracks: Tracks,
    road: Road,
    observed: Observables | None = None,
    inputs: DetectorInputs | None = None,
    met: Conflicts | None = None,
    *,
    recorded: bool = False,
) -> tuple[Event, ...]:
    """All events of an episode or recording.

    Args:
        tracks: the trajectories; of their own events, collisions and removals are used.
        road: where it happened.
        observed: the observables of ``tracks``, if the caller has them.
        inputs: what the trait detectors read, if the caller has it.
        met: the conflicts of ``tracks``, if the caller has them.
        recorded: whether sizes and positions were measured, not simulated: then two outlines that
            overlap are a measurement error, not a collision.

    Returns:
        Events in order of time; a collision is one event, ``agent`` is the party that caused it
        and ``rule`` says why.
    """
    observed = observe(tracks, road) if observed is None else observed
    found = [
        *_lines_passed(tracks, road, observed),
        *crossings_passed(tracks, road, observed),
        *_wrong_way(tracks, observed),
        *near_misses(conflicts(tracks, road) if met is None else met),
    ]
    found += collisions(tracks, road, observed, inputs, found, recorded=recorded)
    # an engine's events of other kinds are found again by the rules above
    found += [event for event in tracks.events if event.kind is EventKind.REMOVAL]
    return tuple(sorted(found, key=lambda e: (e.time_s, e.agent, e.kind)))


def _lines_passed(tracks: Tracks, road: Road, observed: Observables) -> list[Event]:
    """Red lights run, stop lines rolled over, and both obeyed."""
    stops = np.zeros(len(road.lanes) + 1, dtype=bool)
    for link in road.connections:
        stops[road.lane_index[link.from_lane]] |= link.must_stop
    row_index, distance = tracks.index, observed.stop_distance
    red, first = observed.signal == Signal.RED.code, observed.gap > distance
    stands = tracks.row_speed < ROLLING_MPS
    grace = round(GRACE_S / tracks.step_s)
    passed = (distance[:-1] >= 0) & (distance[:-1] < 10.0) & ~row_index.begins[1:]
    passed &= (distance[1:] < 0) | (distance[1:] > 30.0)
    last = np.flatnonzero(passed)  # the last row before each line
    found = []
    for row, zone in zip(last.tolist(), _zones(row_index, distance, last), strict=True):
        number, column = int(row_index.agent[row]), int(row_index.step[row])
        agent, time_s = int(tracks.ids[number]), float(tracks.time_s[column + 1])
        if row_index.over(red, number, max(column - grace, 0), column + 1, False).all():
            found.append(Event(EventKind.RED_RUN, time_s, agent))
        elif (stands[zone] & red[zone] & first[zone]).any():
            found.append(Event(EventKind.STOPPED, time_s, agent, rule="red light"))
        if stops[observed.lane[row]]:
            rolled = tracks.row_speed[zone].min() > ROLLING_MPS
            kind = EventKind.STOP_ROLLED if rolled else EventKind.STOPPED
            found.append(Event(kind, time_s, agent, rule="" if rolled else "stop line"))
    return found


def _zones(row_index: RowIndex, distance: FloatArray, last: IntArray) -> list[slice]:
    """The rows up to each of ``last`` from where its agent came near the line (`STOP_ZONE_M`)."""
    outside = ~((distance >= 0) & (distance < STOP_ZONE_M))
    comes_near = row_index.begins.copy()
    comes_near[1:] |= outside[:-1]
    first = np.flatnonzero(comes_near)
    begins = first[np.searchsorted(first, last, side="right") - 1]
    return [slice(b, row + 1) for b, row in zip(begins.tolist(), last.tolist(), strict=True)]


def _wrong_way(tracks: Tracks, observed: Observables) -> list[Event]:
    wrong = (np.abs(observed.lane_heading) > np.pi / 2) & (tracks.row_speed > ROLLING_MPS)
    found = []
    for run in tracks.index.runs(wrong, round(1.0 / tracks.step_s)):
        metres = float(tracks.row_speed[run].sum()) * tracks.step_s
        agent, time_s = tracks.agent_and_time(run.start)
        found.append(Event(EventKind.WRONG_WAY, time_s, agent, distance_m=metres))
    return found


def near_misses(met: Conflicts) -> list[Event]:
    """The near misses among conflicts, each at its least time to collision or encroachment.

    ``agent`` is the one that had to yield; where priority is unknown, the one that came later to
    the shared position.
    """
    found = []
    for row in np.flatnonzero(met.near_miss).tolist():
        pair = int(met.first[row]), int(met.second[row])
        before = int(met.priority[row]) if met.priority[row] >= 0 else int(met.passed_first[row])
        agent, other = pair if before == pair[1] else pair[::-1]
        ttc_s, pet_s = float(met.ttc_s[row]), float(met.pet_s[row])
        kind = CONFLICT_KINDS[met.kind[row]]
        soon = ttc_s < NEAR_MISS_TTC_S
        short = pet_s < NEAR_MISS_PET_S and kind is not ConflictKind.FOLLOWING
        found.append(
            Event(
                EventKind.NEAR_MISS,
                float(met.ttc_time_s[row] if soon else met.pet_time_s[row]),
                agent,
                other,
                kind.value,
                time_to_collision_s=ttc_s if soon else None,
                post_encroachment_s=pet_s if short else None,
            )
        )
    return found
