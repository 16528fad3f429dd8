"""The annotations of an episode or recording on a known road: its events and shown traits."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from behaviors.detector_inputs import DetectorInputs, ShownTrait
from behaviors.traits import detect
from sim.episode.detector_inputs import detector_inputs, with_encounters
from sim.episode.incidents import incidents
from sim.episode.observables import observe
from sim.episode.rows import TrajectoryRows
from sim.frames import Event, IntArray
from sim.road import Road


@dataclass(frozen=True, slots=True)
class Annotations:
    """What was found in an episode or recording.

    Attributes:
        inputs: what the trait detectors read, with the rules that applied.
        events: rules kept and broken, near misses, collisions with their causes.
        shown_traits: the traits that were shown, with agent ids.
    """

    inputs: DetectorInputs
    events: tuple[Event, ...]
    shown_traits: tuple[ShownTrait, ...]


def annotate(steps: TrajectoryRows, road: Road, *, recorded: bool = False) -> Annotations:
    """Find every event and every shown trait.

    Args:
        steps: an episode or a recording.
        road: where it happened.
        recorded: as in `sim.episode.incidents.incidents`.
    """
    observed = observe(steps, road)
    inputs = detector_inputs(steps, road, observed)
    events = incidents(steps, road, observed, inputs, recorded=recorded)
    inputs = with_encounters(steps.ids, inputs, events)
    return Annotations(inputs, events, shown_traits(steps.ids, inputs))


def shown_traits(ids: IntArray, inputs: DetectorInputs) -> tuple[ShownTrait, ...]:
    """Every trait that was shown, with agent ids in place of indices.

    Args:
        ids: (N,) ids of the agents.
        inputs: what the detectors read, with the rules that applied.

    Returns:
        Shown traits in order of time; their ``agent`` and ``other`` are ids (-1: nobody).
    """
    return tuple(
        dataclasses.replace(
            one,
            agent=int(ids[one.agent]),
            other=int(ids[one.other]) if one.other >= 0 else -1,
        )
        for one in detect(inputs)
    )
