"""From what annotators saw to one label, and how far annotators agree.

Each annotator notes the traits that an agent shows. The paper's protocol takes the majority inside
one parent class (aggressive or conservative) and sends agents back on which annotators disagree
about the parent. They cannot be sent back here: ``strict`` drops them, ``lenient`` (our choice)
lets the majority of the annotators decide and drops ties.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from typing import Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import TRAITS, Behavior, Style, Trait

T = TypeVar("T", bound=Hashable)

Resolution = Literal["strict", "lenient"]

RESOLUTIONS: Final[tuple[Resolution, ...]] = ("strict", "lenient")
"""The rules by which annotators' disagreement is resolved."""


def _most_common(items: Sequence[T]) -> T:
    """The most frequent item; of several the one that comes first."""
    counts = Counter(items)
    return max(counts, key=lambda item: counts[item])  # dicts keep the order of first sight


def style_of(traits: Sequence[Trait]) -> Style:
    """The parent class that one annotator's traits belong to.

    Args:
        traits: in the annotator's order, at least one.

    Returns:
        The parent of most of them; when they are even, that of the first.

    Raises:
        InputError: if there is no trait.

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
    """One label for an agent from what several annotators saw.

    Args:
        annotations: the traits that each annotator noted, at least one each.
        rule: "strict" or "lenient".

    Returns:
        The behaviour that most of the noted traits of the winning parent class belong to (of
        several the first noted), or None where the annotators' conflict is not resolved.

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


def cohen_kappa(first: Sequence[Hashable], second: Sequence[Hashable]) -> float:
    """Agreement of two annotators beyond what their habits would give by chance.

    Args:
        first: the first annotator's answers.
        second: the other's on the same agents.

    Returns:
        1 for perfect agreement, 0 for chance, negative below it; NaN where both always gave the
        same one answer.

    Raises:
        InputError: if the lengths differ or there is nothing to compare.

    References:
        Cohen (1960), Educational and Psychological Measurement 20, 37.

    Examples:
        >>> cohen_kappa("aabb", "aabb"), cohen_kappa("aabb", "abab")
        (1.0, 0.0)
    """
    n = len(first)
    if n != len(second) or n == 0:
        raise InputError(
            f"annotators: found {n} and {len(second)} answers, expected as many of both, at least 1"
        )
    seen = sum(a == b for a, b in zip(first, second, strict=True)) / n
    left, right = Counter(first), Counter(second)
    by_chance = sum(left[answer] * right[answer] for answer in left) / n**2
    return float("nan") if by_chance == 1.0 else (seen - by_chance) / (1.0 - by_chance)


def fleiss_kappa(counts: NDArray[np.int64]) -> float:
    """Agreement of any number of annotators beyond chance.

    Args:
        counts: (n, k) how many annotators gave agent i the answer j; as many for every agent, at
            least 2.

    Returns:
        1 for perfect agreement, 0 for chance, negative below it; NaN where everybody always gave
        the same one answer.

    Raises:
        InputError: if the agents have not all as many answers, or fewer than 2.

    References:
        Fleiss (1971), Psychological Bulletin 76, 378.

    Examples:
        >>> fleiss_kappa(np.array([[3, 0], [0, 3]]))
        1.0
    """
    table = np.asarray(counts, dtype=np.float64)
    answers = table.sum(axis=1) if table.ndim == 2 else np.empty(0)
    if not answers.size or answers.min() != answers.max() or answers[0] < 2 or table.min() < 0:
        raise InputError(
            "counts: found uneven numbers of answers, expected as many for every agent, at least 2"
        )
    raters = answers[0]
    seen = float((((table**2).sum(axis=1) - raters) / (raters * (raters - 1))).mean())
    by_chance = float(((table.sum(axis=0) / table.sum()) ** 2).sum())
    return float("nan") if by_chance == 1.0 else (seen - by_chance) / (1.0 - by_chance)
