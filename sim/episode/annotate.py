"""Everything that can be told of an episode or recording on a known road, worked out once."""

from __future__ import annotations

from dataclasses import dataclass

from behaviors.traits import Exhibit, Seen
from sim.episode.incidents import incidents
from sim.episode.observables import observe
from sim.episode.rows import TrajectoryRows
from sim.episode.shown_traits import exhibited, met, see
from sim.frames import Event
from sim.road import Road


@dataclass(frozen=True, slots=True)
class Watched:
    """What was told of an episode or recording.

    Attributes:
        seen: what the trait detectors looked at, with the rules that were met.
        events: rules kept and broken, near misses, collisions with their causes.
        exhibits: the traits that were shown, with agent ids.
    """

    seen: Seen
    events: tuple[Event, ...]
    exhibits: tuple[Exhibit, ...]


def watch(steps: TrajectoryRows, road: Road, *, recorded: bool = False) -> Watched:
    """Find every event and every trait.

    Args:
        steps: an episode or a recording.
        road: where it happened.
        recorded: as in `sim.episode.incidents.incidents`.
    """
    observed = observe(steps, road)
    seen = see(steps, road, observed)
    events = incidents(steps, road, observed, seen, recorded=recorded)
    seen = met(steps.ids, seen, events)
    return Watched(seen, events, exhibited(steps.ids, seen))
