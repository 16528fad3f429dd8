"""The label that a road-agent's shown traits speak for: the paper's protocol, by detectors.

Observers tick the traits that are characteristic of somebody; a detector never tires and finds the
odd trait of every class in almost everyone. So a trait counts only once enough of it was shown.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from behaviors.labels import BEHAVIORS, TRAITS, Behavior, Trait
from behaviors.traits import Exhibit


@dataclass(frozen=True, slots=True)
class Enough:
    """How much of a trait makes it characteristic.

    Attributes:
        amount: the amount that counts as one vote.
        in_seconds: whether the time for which it was shown counts; else how often.
    """

    amount: float
    in_seconds: bool = False


ENOUGH: Final[dict[Trait, Enough]] = {
    Trait.OVERTAKING: Enough(3.0),
    Trait.OVER_SPEEDING: Enough(10.0, in_seconds=True),
    Trait.TAILGATING: Enough(10.0, in_seconds=True),
    Trait.WEAVING: Enough(2.0),
    Trait.CUTTING_IN: Enough(1.0),
    Trait.DRIVING_CLOSE: Enough(4.0, in_seconds=True),
    Trait.WRONG_DIRECTION: Enough(1.0),
    Trait.JAYWALKING: Enough(1.0),
    Trait.BREAKING_RULES: Enough(1.0),
    Trait.KEEPING_NEIGHBORS: Enough(30.0, in_seconds=True),
    Trait.UNIFORM_SPEED: Enough(20.0, in_seconds=True),
    Trait.FOLLOWING_RULES: Enough(1.0),
    Trait.NOT_MOVING: Enough(1.0),
    Trait.SLOWING: Enough(1.0),
    Trait.WAITING: Enough(1.0),
}
"""How much of each trait an observer needs to see (our choice)."""


def characteristic_traits(exhibits: Iterable[Exhibit]) -> tuple[Trait, ...]:
    """The traits that one road-agent showed enough of to be ticked.

    Args:
        exhibits: everything that it showed.

    Returns:
        Traits in the order of the trait table.

    Examples:
        >>> once = Exhibit(Trait.CUTTING_IN, 0, 1.0, 2.0, 0.5)
        >>> brief = Exhibit(Trait.UNIFORM_SPEED, 0, 0.0, 15.0, 0.01)
        >>> characteristic_traits([once, brief])
        (<Trait.CUTTING_IN: 'cutting in front'>,)
    """
    shown = dict.fromkeys(TRAITS, 0.0)
    for exhibit in exhibits:
        seconds = exhibit.end_s - exhibit.begin_s
        shown[exhibit.trait] += seconds if ENOUGH[exhibit.trait].in_seconds else 1.0
    return tuple(trait for trait in TRAITS if shown[trait] >= ENOUGH[trait].amount)


def shown_label(exhibits: Iterable[Exhibit]) -> Behavior | None:
    """The behaviour that most characteristic traits speak for, inside one parent class.

    Args:
        exhibits: everything that one road-agent showed.

    Returns:
        The behaviour; None if nothing characteristic was shown, or as many traits of one parent
        class as of the other, which the paper leaves to another annotator. Of equals, the one
        whose traits are rarer wins: recklessness shows in a single act, carefulness all day.

    Examples:
        >>> shown_label([Exhibit(Trait.CUTTING_IN, 0, 1.0, 2.0, 0.5)])
        <Behavior.THREATENING: 'threatening'>
        >>> shown_label([]) is None
        True
    """
    votes = dict.fromkeys(BEHAVIORS, 0)
    for trait in characteristic_traits(exhibits):
        votes[TRAITS[trait]] += 1
    aggressive = sum(n for behavior, n in votes.items() if behavior.style == "aggressive")
    conservative = sum(votes.values()) - aggressive
    if aggressive == conservative:
        return None
    style = "aggressive" if aggressive > conservative else "conservative"
    return max((b for b in _RAREST_FIRST if b.style == style), key=lambda behavior: votes[behavior])


_RAREST_FIRST: Final = (
    Behavior.RECKLESS,
    Behavior.THREATENING,
    Behavior.IMPATIENT,
    Behavior.TIMID,
    Behavior.CAUTIOUS,
    Behavior.CAREFUL,
)
"""Which behaviour wins with as many traits as another."""
