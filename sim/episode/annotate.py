"""The annotations of an episode or recording on a known road: its events and shown traits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

from behaviors.traits import DetectorInputs, ShownTrait, detect
from sim.episode.detector_inputs import detector_inputs, with_encounters
from sim.episode.incidents import incidents
from sim.episode.observables import observe
from sim.frames import Event, FloatArray, IntArray, Tracks
from sim.road import Road
from sim.safety import Conflicts, conflicts

MIN_FRAMES: Final = 3
"""Fewest frames for annotations: the shortest motion with a change of speed."""

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
    inputs = with_encounters(tracks.ids, inputs, events)
    return Annotations(inputs, events, shown_traits(tracks.ids, inputs), *seen, met)


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


def shown_traits(ids: IntArray, inputs: DetectorInputs) -> tuple[ShownTrait, ...]:
    """Every trait that was shown, in order of time; ``agent`` and ``other`` are ids (-1: none)."""
    return tuple(
        replace(one, agent=int(ids[one.agent]), other=int(ids[one.other]) if one.other >= 0 else -1)
        for one in detect(inputs)
    )
