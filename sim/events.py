"""Events in traffic: collisions, near misses, rules kept and broken."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class EventKind(StrEnum):
    """Kinds of events of one or two agents.

    A collision is one event, when it begins. An engine says ``CONTACT`` in every later step in
    which the two still touch; stored events have no contacts.
    """

    COLLISION = "collision"
    CONTACT = "contact"
    NEAR_MISS = "near miss"
    REMOVAL = "removal"
    RED_RUN = "red run"
    STOP_ROLLED = "stop rolled"
    STOPPED = "stopped"
    YIELDED = "yielded"
    NOT_YIELDED = "did not yield"
    WRONG_WAY = "wrong way"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at one time.

    Attributes:
        kind: what happened.
        time_s: when, s.
        agent: id of the agent that did it (of a collision: the one that caused it).
        other: id of the second party, or None.
        rule: the rule by which the agent counts as its cause, in words; of a near miss: the kind
            of conflict; "" where there is none.
        end_s: of a collision: when the two last touch, s; None for other events.
        time_to_collision_s: of a near miss: the least one, s; None if they never were on a
            collision course.
        post_encroachment_s: of a near miss: the time after which one came where the other had
            been, s; None if that was never soon.
        distance_m: of driving the wrong way: how far, m.
        cut_in_headway_s: of a collision after a cut-in: the headway that it left, s.
    """

    kind: EventKind
    time_s: float
    agent: int
    other: int | None = None
    rule: str = ""
    end_s: float | None = None
    time_to_collision_s: float | None = None
    post_encroachment_s: float | None = None
    distance_m: float | None = None
    cut_in_headway_s: float | None = None

    @property
    def words(self) -> str:
        """The rule and the event's number, for people.

        Examples:
            >>> Event(EventKind.NEAR_MISS, 2.0, 1, 2, "crossing", time_to_collision_s=1.4).words
            'crossing, time to collision 1.40 s'
        """
        if self.kind is EventKind.NEAR_MISS:
            ttc_s, pet_s = self.time_to_collision_s, self.post_encroachment_s
            parts = [self.rule] if self.rule else []
            parts += [] if ttc_s is None else [f"time to collision {ttc_s:.2f} s"]
            parts += [] if pet_s is None else [f"post-encroachment time {pet_s:.2f} s"]
            return ", ".join(parts)
        if self.distance_m is not None:
            return f"{self.distance_m:.0f} m"
        if self.cut_in_headway_s is not None:
            return f"{self.rule}, {self.cut_in_headway_s:.2f} s before the other"
        return self.rule
