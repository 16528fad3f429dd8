"""What happens in traffic: collisions, near misses, rules kept and broken."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class EventKind(StrEnum):
    """What can happen to or between agents.

    A collision is one event, when it begins; ``CONTACT`` marks every later step in which the two
    still touch.
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
        rule: the rule by which the agent counts as its cause, in words; "" where there is none.
    """

    kind: EventKind
    time_s: float
    agent: int
    other: int | None = None
    rule: str = ""
