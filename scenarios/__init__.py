"""Scenarios: roads with their demand, by name; ``SCENARIOS["straight_road"]()`` makes one."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, cast

from behaviors.errors import InputError, lookup
from scenarios.registration import ENVIRONMENTS, register_environments
from sim.scenario import Scenario


@dataclass(frozen=True, slots=True)
class ScenarioEntry:
    """A scenario that is loaded when it is first made.

    Attributes:
        name: what it is registered as.
        source: the function that makes it, as "module:function".
        fixed: options that make this scenario what it is.
    """

    name: str
    source: str
    fixed: Mapping[str, Any] = field(default_factory=dict)

    @property
    def options(self) -> Mapping[str, inspect.Parameter]:
        """The options that it takes, with their defaults."""
        parameters = inspect.signature(self._make()).parameters
        return {name: p for name, p in parameters.items() if name not in self.fixed}

    def __call__(self, **options: Any) -> Scenario:
        """Make the scenario; its function's own docstring tells the options.

        Raises:
            InputError: if an option is unknown or out of range; the message names it.
        """
        for name, value in options.items():
            parameter = lookup(self.options, name, f"option of scenario {self.name!r},")
            if not _fits(value, parameter.default):
                raise InputError(
                    f"{name}: found {value!r}, expected a value like {parameter.default!r}"
                )
        return dataclasses.replace(self._make()(**self.fixed, **options), name=self.name)

    def _make(self) -> Callable[..., Scenario]:
        module, function = self.source.split(":")
        return cast(Callable[..., Scenario], getattr(importlib.import_module(module), function))


def _fits(value: object, default: object) -> bool:
    """Whether a value may stand where a default truth value or number stands."""
    if isinstance(default, bool):
        return isinstance(value, bool)
    if isinstance(default, int | float):
        whole = isinstance(default, int)
        return isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    return True


_STRAIGHT: Final = "scenarios.straight_road:straight_road"
_FOUR_WAY: Final = "scenarios.four_way_intersection:four_way_intersection"

SCENARIOS: Final[dict[str, ScenarioEntry]] = {
    entry.name: entry
    for entry in (
        ScenarioEntry("straight_road", _STRAIGHT),
        ScenarioEntry("two_way_road", _STRAIGHT, {"two_way": True, "lanes": 1, "crossing": False}),
        ScenarioEntry("four_way_intersection", _FOUR_WAY),
        ScenarioEntry("priority_intersection", _FOUR_WAY, {"control": "priority"}),
        ScenarioEntry("all_way_stop", _FOUR_WAY, {"control": "allway_stop"}),
        ScenarioEntry("right_before_left", _FOUR_WAY, {"control": "right_before_left"}),
    )
}
"""Every scenario by name."""


def get_scenario(name: str) -> ScenarioEntry:
    """The scenario of that name.

    Raises:
        InputError: if there is none; the message suggests the nearest name.
    """
    return lookup(SCENARIOS, name, "scenario")


register_environments()

__all__ = ["ENVIRONMENTS", "SCENARIOS", "ScenarioEntry", "get_scenario"]
