"""Scenarios: roads with their demand, by name; ``SCENARIOS["straight_road"]()`` makes one."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import runpy
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError, lookup
from behaviors.registry import Registry
from scenarios.environments import ENVIRONMENTS
from sim.scenario import Scenario


@dataclass(frozen=True, slots=True)
class ScenarioEntry:
    """A scenario by its registered name.

    Attributes:
        name: what it is registered as.
        function: makes it from keyword options; those that a `functools.partial` has set are fixed,
            and ``**population`` stands for all of `PopulationOptions`.
        given: options that have another value unless they are given.
        limits_mps: speed limits that the episodes of a dataset take in turn, m/s; empty for none.
    """

    name: str
    function: Callable[..., Scenario]
    given: Mapping[str, Any] = field(default_factory=dict)
    limits_mps: tuple[float, ...] = ()

    @property
    def options(self) -> Mapping[str, Any]:
        """The default of each option that it takes; those of the population are `Scenario`'s."""
        from scenarios.demand import PopulationOptions

        fixed = self.function.keywords if isinstance(self.function, functools.partial) else ()
        found: dict[str, Any] = {}
        for name, parameter in inspect.signature(self.function).parameters.items():
            if parameter.kind is not inspect.Parameter.VAR_KEYWORD:
                found |= {} if name in fixed else {name: parameter.default}
                continue
            for one in dataclasses.fields(Scenario):
                if one.name in PopulationOptions.__annotations__:
                    default = one.default
                    found[one.name] = None if default is dataclasses.MISSING else default
        return found

    def __call__(self, **options: Any) -> Scenario:
        """Make the scenario; the docstring of its function explains the options.

        Raises:
            InputError: if an option is unknown or out of range; the message names it.
        """
        options = {**self.given, **options}
        for name, value in options.items():
            default = lookup(self.options, name, f"option of scenario {self.name!r},")
            if not _fits(value, default):
                raise InputError(f"{name}: found {value!r:.80}, expected a value like {default!r}")
        return dataclasses.replace(self.function(**options), name=self.name)


def _fits(value: object, default: object) -> bool:
    """Whether a value has the type of the default, where that is a truth value or a number."""
    if isinstance(default, bool) or not isinstance(default, int | float):
        return isinstance(value, bool) or not isinstance(default, bool)
    number = int if isinstance(default, int) else int | float
    return isinstance(value, number) and not isinstance(value, bool)


SCENARIOS: Final[Registry[ScenarioEntry]] = Registry(
    "scenario",
    "graphrqi.scenarios",
    {
        "straight_road": "scenarios.straight_road:straight_road",
        "two_way_road": "scenarios.straight_road:two_way_road",
        "four_way_intersection": "scenarios.four_way_intersection:four_way_intersection",
        "priority_intersection": "scenarios.four_way_intersection:priority_intersection",
        "all_way_stop": "scenarios.four_way_intersection:all_way_stop",
        "right_before_left": "scenarios.four_way_intersection:right_before_left",
        "city": "scenarios.city:city",
        "motorway": "scenarios.motorway:motorway",
        "motorway_ramps": "scenarios.motorway:motorway_ramps",
        "roundabout": "scenarios.roundabout:roundabout",
    },
    made=ScenarioEntry,
)
"""Every scenario by name."""


def get_scenario(name: str) -> ScenarioEntry:
    """The scenario of that name, or that a file describes.

    Args:
        name: a key of ``SCENARIOS``, the path of a scenario's file (``.toml``) or that of a map.

    Raises:
        InputError: if there is none; the message suggests the nearest name.
    """
    from scenarios.own.scenario_file import is_path, scenario_at

    return scenario_at(Path(name), SCENARIOS) if is_path(name) else SCENARIOS[name]


def run_as_command(name: str) -> None:
    """Run a key of ``SCENARIOS`` as ``graphrqi run NAME`` does, with this process's options."""
    sys.argv[1:1] = ["run", name]
    runpy.run_module("experiments.cli", run_name="__main__", alter_sys=True)


__all__ = ["ENVIRONMENTS", "SCENARIOS", "ScenarioEntry", "get_scenario"]
