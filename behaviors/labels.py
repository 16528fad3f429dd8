"""The six driver behaviours, their two styles, and the traits that show them.

Table I of the paper "GraphRQI: Classifying Driver Behaviors Using Graph Spectrums" (ICRA 2020)
assigns observable traits to behaviours; here it is data. Class codes are defined here and nowhere
else: the position of a behaviour in ``BEHAVIORS``.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final


class Style(StrEnum):
    """The two parent classes of the paper."""

    AGGRESSIVE = "aggressive"
    CONSERVATIVE = "conservative"


class Behavior(StrEnum):
    """How a driver drives; the members' order is the class order everywhere.

    Examples:
        >>> Behavior("timid").style
        <Style.CONSERVATIVE: 'conservative'>
        >>> Behavior.RECKLESS.code
        1
    """

    IMPATIENT = "impatient"
    RECKLESS = "reckless"
    THREATENING = "threatening"
    CAREFUL = "careful"
    CAUTIOUS = "cautious"
    TIMID = "timid"

    @property
    def style(self) -> Style:
        """The parent class."""
        return Style.AGGRESSIVE if self in _AGGRESSIVE else Style.CONSERVATIVE

    @property
    def code(self) -> int:
        """The class code: position in ``BEHAVIORS``."""
        return BEHAVIORS.index(self)


_AGGRESSIVE: Final = frozenset({Behavior.IMPATIENT, Behavior.RECKLESS, Behavior.THREATENING})

BEHAVIORS: Final[tuple[Behavior, ...]] = tuple(Behavior)
"""The class order: code c means ``BEHAVIORS[c]``. Unknown is -1."""


class Trait(StrEnum):
    """Observable actions of a road-agent (rows of the paper's trait table)."""

    OVERTAKING = "overtaking"
    OVER_SPEEDING = "over-speeding"
    TAILGATING = "tailgating"
    WEAVING = "weaving"
    CUTTING_IN = "cutting in front"
    DRIVING_CLOSE = "driving extremely close"
    WRONG_DIRECTION = "driving in the wrong direction"
    JAYWALKING = "jaywalking"
    BREAKING_RULES = "not following rules"
    KEEPING_NEIGHBORS = "maintaining neighbours"
    UNIFORM_SPEED = "uniform speed"
    FOLLOWING_RULES = "following rules"
    NOT_MOVING = "not moving"
    SLOWING = "slowing down or stopping"
    WAITING = "waiting for vehicles or pedestrians"


TRAITS: Final[dict[Trait, Behavior]] = {
    Trait.OVERTAKING: Behavior.IMPATIENT,
    Trait.OVER_SPEEDING: Behavior.IMPATIENT,
    Trait.TAILGATING: Behavior.IMPATIENT,
    Trait.WEAVING: Behavior.IMPATIENT,
    Trait.CUTTING_IN: Behavior.THREATENING,
    Trait.DRIVING_CLOSE: Behavior.THREATENING,
    Trait.WRONG_DIRECTION: Behavior.RECKLESS,
    Trait.JAYWALKING: Behavior.RECKLESS,
    Trait.BREAKING_RULES: Behavior.RECKLESS,
    Trait.KEEPING_NEIGHBORS: Behavior.CAREFUL,
    Trait.UNIFORM_SPEED: Behavior.CAREFUL,
    Trait.FOLLOWING_RULES: Behavior.CAREFUL,
    Trait.NOT_MOVING: Behavior.TIMID,
    Trait.SLOWING: Behavior.TIMID,
    Trait.WAITING: Behavior.CAUTIOUS,
}
"""The paper's trait table: which behaviour each trait belongs to."""
