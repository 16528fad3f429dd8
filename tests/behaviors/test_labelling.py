"""Labels from what annotators saw."""

from __future__ import annotations

from behaviors.labelling import resolve, style_of
from behaviors.labels import Behavior, Style, Trait

HASTY = [Trait.OVERTAKING]
CLOSE = [Trait.CUTTING_IN, Trait.DRIVING_CLOSE]
CALM = [Trait.UNIFORM_SPEED, Trait.FOLLOWING_RULES]


def test_one_annotator_decides_alone():
    assert resolve([CLOSE]) is Behavior.THREATENING
    assert resolve([CALM], "strict") is Behavior.CAREFUL


def test_majority_inside_the_parent_class():
    assert resolve([HASTY, CLOSE], "strict") is Behavior.THREATENING
    assert resolve([HASTY, CLOSE, HASTY, HASTY], "strict") is Behavior.IMPATIENT


def test_even_behaviours_go_to_the_first_noted():
    assert resolve([[Trait.WAITING, Trait.SLOWING]]) is Behavior.CAUTIOUS
    assert resolve([[Trait.SLOWING, Trait.WAITING]]) is Behavior.TIMID


def test_conflicts_across_parents():
    assert resolve([HASTY, CALM], "lenient") is None
    assert resolve([HASTY, CALM, HASTY], "strict") is None
    assert resolve([HASTY, CALM, HASTY], "lenient") is Behavior.IMPATIENT
    assert resolve([], "lenient") is None


def test_losing_annotators_traits_do_not_name_the_behaviour():
    """The calm annotator's one aggressive trait does count: it is of the winning parent."""
    doubtful = [Trait.UNIFORM_SPEED, Trait.FOLLOWING_RULES, Trait.CUTTING_IN]
    assert style_of(doubtful) is Style.CONSERVATIVE
    assert resolve([HASTY, doubtful, HASTY], "lenient") is Behavior.IMPATIENT
    assert resolve([HASTY, doubtful, CLOSE], "lenient") is Behavior.THREATENING
