"""One behaviour label per road-agent, from the traits that people noted or that detectors found.

The paper's protocol takes the majority of the traits inside one parent class (aggressive or
conservative). Annotators who disagree about the parent class are asked again. Recordings cannot
ask. ``strict`` drops those agents. ``lenient`` (our choice) follows the majority of the annotators
and drops ties.

Annotators tick what is characteristic of a driver. A detector finds some odd trait in almost every
driver, so a detected trait counts only once enough of it was shown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from typing import Final, Literal, TypeVar

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, TRAITS, Behavior, Style, Trait
from behaviors.traits import ShownTrait

T = TypeVar("T", bound=Hashable)

Resolution = Literal["strict", "lenient"]

RESOLUTIONS: Final[tuple[Resolution, ...]] = ("strict", "lenient")
"""How annotators' disagreement is resolved."""


IN_SECONDS: Final[dict[Trait, float]] = {
    Trait.OVER_SPEEDING: 10.0,
    Trait.TAILGATING: 10.0,
    Trait.DRIVING_CLOSE: 4.0,
    Trait.KEEPING_NEIGHBORS: 30.0,
    Trait.UNIFORM_SPEED: 20.0,
}
"""For how long in all a trait that lasts has to be shown to count as characteristic, s."""

THRESHOLDS: Final[dict[Trait, float]] = {
    **dict.fromkeys(Trait, 1.0), Trait.OVERTAKING: 3.0, Trait.WEAVING: 2.0, **IN_SECONDS
}  # fmt: skip
"""How often each trait has to be shown, or for how long (our choice: the paper has no numbers)."""

_RAREST_FIRST: Final = (
    Behavior.RECKLESS,
    Behavior.THREATENING,
    Behavior.IMPATIENT,
    Behavior.TIMID,
    Behavior.CAUTIOUS,
    Behavior.CAREFUL,
)
"""With equally many traits, the earlier behaviour wins: recklessness shows in a single act,
carefulness all day."""


def style_of(traits: Sequence[Trait]) -> Style:
    """The parent class that one annotator's traits belong to.

    Args:
        traits: in the annotator's order, at least one.

    Returns:
        The parent class of most of them; in a tie, that of the first.

    Raises:
        InputError: if ``traits`` is empty.

    Examples:
        >>> style_of([Trait.OVERTAKING, Trait.UNIFORM_SPEED, Trait.FOLLOWING_RULES])
        <Style.CONSERVATIVE: 'conservative'>
    """
    if not traits:
        raise InputError("traits: found none, expected at least one")
    return _most_common([TRAITS[trait].style for trait in traits])


def resolve(
    annotations: Sequence[Sequence[Trait]], rule: Resolution = "lenient"
) -> Behavior | None:
    """One label for an agent from the traits that several annotators noted.

    Args:
        annotations: the traits that each annotator noted, at least one each.
        rule: "strict" or "lenient".

    Returns:
        The behaviour with most traits inside the winning parent class (in a tie, the one noted
        first), or None where the annotators' conflict is not resolved.

    Raises:
        InputError: if the rule is unknown, or an annotator noted nothing.

    Examples:
        >>> both = [[Trait.OVERTAKING], [Trait.UNIFORM_SPEED]]
        >>> resolve(both) is None
        True
        >>> resolve([*both, [Trait.OVER_SPEEDING]])
        <Behavior.IMPATIENT: 'impatient'>
        >>> resolve([*both, [Trait.OVER_SPEEDING]], "strict") is None
        True
    """
    if rule not in RESOLUTIONS:
        raise InputError(f"rule: found {rule!r}, expected {' or '.join(RESOLUTIONS)}")
    votes = Counter(style_of(traits) for traits in annotations)
    if not votes or (rule == "strict" and len(votes) > 1):
        return None
    if len(set(votes.values())) < len(votes):
        return None
    parent = max(votes, key=lambda style: votes[style])
    behaviors = [TRAITS[trait] for traits in annotations for trait in traits]
    return _most_common([b for b in behaviors if b.style is parent])


def characteristic_traits(shown: Iterable[ShownTrait]) -> tuple[Trait, ...]:
    """The traits that one road-agent showed enough of to be ticked.

    Args:
        shown: everything that it showed.

    Returns:
        Traits in the order of the trait table.

    Examples:
        >>> once = ShownTrait(Trait.CUTTING_IN, 0, 1.0, 2.0, 0.5)
        >>> brief = ShownTrait(Trait.UNIFORM_SPEED, 0, 0.0, 15.0, 0.01)
        >>> characteristic_traits([once, brief])
        (<Trait.CUTTING_IN: 'cutting in front'>,)
    """
    amount = dict.fromkeys(TRAITS, 0.0)
    for one in shown:
        amount[one.trait] += one.end_s - one.begin_s if one.trait in IN_SECONDS else 1.0
    return tuple(trait for trait in TRAITS if amount[trait] >= THRESHOLDS[trait])


def label_from_traits(shown: Iterable[ShownTrait]) -> Behavior | None:
    """The behaviour that most characteristic traits belong to, inside one parent class.

    Args:
        shown: everything that one road-agent showed.

    Returns:
        The behaviour; None if no trait is characteristic, or if both parent classes have equally
        many (the paper asks another annotator then).

    Examples:
        >>> label_from_traits([ShownTrait(Trait.CUTTING_IN, 0, 1.0, 2.0, 0.5)])
        <Behavior.THREATENING: 'threatening'>
        >>> label_from_traits([]) is None
        True
    """
    votes = Counter(TRAITS[trait] for trait in characteristic_traits(shown))
    aggressive = sum(votes[b] for b in BEHAVIORS if b.style is Style.AGGRESSIVE)
    conservative = votes.total() - aggressive
    if aggressive == conservative:
        return None
    style = Style.AGGRESSIVE if aggressive > conservative else Style.CONSERVATIVE
    return max((b for b in _RAREST_FIRST if b.style is style), key=lambda behavior: votes[behavior])


def _most_common(items: Sequence[T]) -> T:
    """The most frequent item; in a tie, the first of them."""
    counts = Counter(items)
    return max(counts, key=lambda item: counts[item])  # a dict keeps the order of insertion
