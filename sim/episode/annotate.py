"""The annotations of an episode or recording on a known road: its events and shown traits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from behaviors.traits import DetectorInputs, RuleEncounter, ShownTrait, detect
from sim.episode.detector_inputs import detector_inputs
from sim.episode.incidents import incidents
from sim.episode.observables import observe
from sim.frames import Event, EventKind, FloatArray, IntArray, Tracks
from sim.road import Road
from sim.safety import Conflicts, conflicts

MIN_FRAMES: Final = 3
"""Fewest frames for annotations: the shortest motion with a change of speed."""

RULES: Final = {
    EventKind.RED_RUN: False,
    EventKind.STOP_ROLLED: False,
    EventKind.NOT_YIELDED: False,
    EventKind.WRONG_WAY: False,
    EventKind.STOPPED: True,
    EventKind.YIELDED: True,
}
"""The events in which a rule applied, and whether it was kept."""

MAX_STEP_S: Final = 1.0
"""Longest time between frames for annotations, s; traits last one second and more."""


@dataclass(frozen=True, slots=True)
class Annotations:
    """Annotations of an episode or recording of m rows.

    Attributes:
        inputs: what the trait detectors read, with the rules that applied.
        events: rules kept and broken, near misses, collisions with their causes.
        shown_traits: the traits that were shown, with agent ids.
        lane: (m,) index into ``Road.lanes``; -1 where unknown.
        lane_s: (m,) distance along the lane, m; NaN where unknown.
        leader: (m,) row of the vehicle ahead; -1 where there is none.
        gap: (m,) bumper to bumper to it, m; +inf where there is none.
        conflicts: the encounters of road users.
    """

    inputs: DetectorInputs
    events: tuple[Event, ...]
    shown_traits: tuple[ShownTrait, ...]
    lane: IntArray
    lane_s: FloatArray
    leader: IntArray
    gap: FloatArray
    conflicts: Conflicts


def annotate(tracks: Tracks, road: Road, *, recorded: bool = False) -> Annotations:
    """Find every event and every shown trait.

    Args:
        tracks: an episode or a recording.
        road: where it happened.
        recorded: as in `sim.episode.incidents.incidents`.
    """
    observed = observe(tracks, road)
    inputs = detector_inputs(tracks, road, observed)
    met = conflicts(tracks, road)
    events = incidents(tracks, road, observed, inputs, met, recorded=recorded)
    seen = observed.lane, observed.s, observed.leader, observed.gap
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
    return Annotations(inputs, events, shown, *seen, met)


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
    events: list[Event] = []
    shown: list[ShownTrait] = []
    for _, found in annotated_parts(tracks, road):
        events += found.events
        shown += found.shown_traits
    return tuple(events), tuple(shown)
