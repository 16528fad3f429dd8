"""Entry of a scenario's name: the function that makes it, and its options."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from behaviors.errors import InputError, lookup
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
            if parameter.kind is inspect.Parameter.VAR_KEYWORD:
                for one in dataclasses.fields(Scenario):
                    if one.name in PopulationOptions.__annotations__:
                        found[one.name] = (
                            None if one.default is dataclasses.MISSING else one.default
                        )
            elif name not in fixed:
                found[name] = parameter.default
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
