"""Scenarios: roads with their demand, by name; ``SCENARIOS["straight_road"]()`` makes one."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, cast

from behaviors.errors import lookup
from sim.scenario import Scenario


@dataclass(frozen=True, slots=True)
class ScenarioEntry:
    """A scenario that is loaded when it is first made.

    Attributes:
        source: the function that makes it, as "module:function".
    """

    source: str

    def __call__(self, **options: Any) -> Scenario:
        """Make the scenario; see the function's own docstring for its options."""
        module, function = self.source.split(":")
        make = cast(Callable[..., Scenario], getattr(importlib.import_module(module), function))
        return make(**options)


SCENARIOS: Final[dict[str, ScenarioEntry]] = {
    "straight_road": ScenarioEntry("scenarios.straight_road:straight_road"),
    "four_way_intersection": ScenarioEntry("scenarios.four_way_intersection:four_way_intersection"),
}
"""Every scenario by name."""


def get_scenario(name: str) -> ScenarioEntry:
    """The scenario of that name.

    Raises:
        InputError: if there is none; the message suggests the nearest name.
    """
    return lookup(SCENARIOS, name, "scenario")


__all__ = ["SCENARIOS", "ScenarioEntry", "get_scenario"]
