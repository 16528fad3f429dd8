"""The annotations of an episode or recording on a known road: its events and shown traits.

Rules kept and broken and near misses are found from positions and the road alone. Collisions come
from the engine's own events too, and are given a cause (`sim.episode.collisions`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from behaviors.traits import DetectorInputs, RuleEncounter, ShownTrait, detect
from sim.episode.collisions import collisions
from sim.episode.observables import Observables, detector_inputs, observe
from sim.episode.yielding import ROLLING_MPS, crossings_passed
from sim.frames import Event, EventKind, FloatArray, Signal, Tracks
from sim.road import Road
from sim.safety import (
    CONFLICT_KINDS,
    NEAR_MISS_PET_S,
    NEAR_MISS_TTC_S,
    ConflictKind,
    Conflicts,
    conflicts,
)

MIN_FRAMES: Final = 3
"""Fewest frames for annotations: the shortest motion with a change of speed."""

MAX_STEP_S: Final = 1.0
"""Longest time between frames for annotations, s; traits last one second and more."""

GRACE_S: Final = 0.3
"""Passing a light this soon after it turned red is not a red run (one glance)."""

STOP_ZONE_M: Final = 8.0
"""Stopping counts within this distance before the line (a car's length and more)."""

RULES: Final = {
    EventKind.RED_RUN: False,
    EventKind.STOP_ROLLED: False,
    EventKind.NOT_YIELDED: False,
    EventKind.WRONG_WAY: False,
    EventKind.STOPPED: True,
    EventKind.YIELDED: True,
}
"""The events in which a rule applied, and whether it was kept."""


@dataclass(frozen=True, slots=True)
class Annotations:
    """Annotations of an episode or recording of m rows.

    Attributes:
        inputs: what the trait detectors read, with the rules that applied.
        events: rules kept and broken, near misses, collisions with their causes.
        shown_traits: the traits that were shown, with agent ids.
        lane_s: (m,) distance along the lane, m; NaN where unknown.
        conflicts: the encounters of road users.
    """

    inputs: DetectorInputs
    events: tuple[Event, ...]
    shown_traits: tuple[ShownTrait, ...]
    lane_s: FloatArray
    conflicts: Conflicts


def annotate(tracks: Tracks, road: Road, *, recorded: bool = False) -> Annotations:
    """Find every event and every shown trait; arguments as of `incidents`."""
    observed = observe(tracks, road)
    inputs = detector_inputs(tracks, road, observed)
    met = conflicts(tracks, road)
    events = _incidents(tracks, road, observed, inputs, met, recorded)
    lane_s = observed.s
    del observed  # a fifth of the memory, which the detectors need
    index = {int(agent): i for i, agent in enumerate(tracks.ids)}
    encounters = tuple(
        RuleEncounter(index[event.agent], event.time_s, RULES[event.kind])
        for event in events
        if event.kind in RULES and event.agent in index
    )
    inputs = replace(inputs, encounters=encounters)
    ids = np.append(tracks.ids, -1)  # index -1: nobody
    shown = tuple(
        replace(one, agent=int(ids[one.agent]), other=int(ids[one.other])) for one in detect(inputs)
    )
    return Annotations(inputs, events, shown, lane_s, met)


def annotated_parts(tracks: Tracks, road: Road) -> Iterator[tuple[Tracks, Annotations]]:
    """Each part of a recording between breaks, with what was found in it, in order of time.

    Parts are annotated separately, because the motion in a break is unknown. Parts whose frames are
    more than `MAX_STEP_S` apart are left out.
    """
    for part in tracks.between_breaks():
        if part.time_s.size >= MIN_FRAMES and part.step_s <= MAX_STEP_S:
            yield part, annotate(part, road, recorded=True)


def annotate_recording(
    tracks: Tracks, road: Road
) -> tuple[tuple[Event, ...], tuple[ShownTrait, ...]]:
    """The events and shown traits of the `annotated_parts` of a recording, in order of time."""
    parts = [found for _, found in annotated_parts(tracks, road)]
    return (
        tuple(event for found in parts for event in found.events),
        tuple(trait for found in parts for trait in found.shown_traits),
    )


def incidents(tracks: Tracks, road: Road, *, recorded: bool = False) -> tuple[Event, ...]:
    """All events of an episode or recording.

    Args:
        tracks: the trajectories; of their own events, collisions and removals are used.
        road: where it happened.
        recorded: whether sizes and positions were measured, not simulated: then two outlines that
            overlap are a measurement error, not a collision.

    Returns:
        Events in order of time; a collision is one event, ``agent`` is the party that caused it
        and ``rule`` says why.
    """
    observed, met = observe(tracks, road), conflicts(tracks, road)
    inputs = detector_inputs(tracks, road, observed)
    return _incidents(tracks, road, observed, inputs, met, recorded)


def _incidents(
    tracks: Tracks, road: Road, observed: Observables, inputs: DetectorInputs, met: Conflicts,
    recorded: bool,
) -> tuple[Event, ...]:  # fmt: skip
    """The events of `incidents`, from what was measured of the tracks."""
    found = [
        *_lines_passed(tracks, road, observed),
        *crossings_passed(tracks, road, observed),
        *_wrong_way(tracks, observed),
        *near_misses(met),
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
    comes_near = row_index.begins.copy()
    comes_near[1:] |= ~((distance >= 0) & (distance < STOP_ZONE_M))[:-1]
    near = np.flatnonzero(comes_near)  # the first row in the zone before it
    begins = near[np.searchsorted(near, last, side="right") - 1]
    found = []
    for row, begin in zip(last.tolist(), begins.tolist(), strict=True):
        number, column = int(row_index.agent[row]), int(row_index.step[row])
        zone = slice(begin, row + 1)
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
