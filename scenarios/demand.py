"""What a user writes for a scenario: its name and options, flows, and the population of drivers."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict, TypeVar

from behaviors.errors import InputError, lookup
from behaviors.labels import BEHAVIORS, Behavior, Style, read_behaviors
from behaviors.populations import Population, read_population
from scenarios.networks.build import net_of
from scenarios.networks.geometries import Sources
from sim.frames import AgentKind
from sim.road.net import read_road
from sim.scenario import RouteFlow, Scenario

K = TypeVar("K", bound=str)


class PopulationOptions(TypedDict, total=False):
    """Options that every scenario takes, beside its own; the defaults are those of `Scenario`.

    Attributes:
        mix: shares of behaviours or styles, see `parse_mix`; None for equal.
        kinds: share of each kind of vehicle, as a mapping or ``"car=.9,truck=.1"``; None for cars.
        spread: how much drivers of one behaviour differ.
        duration_s: length of an episode, s.
        step_s: time between frames, s.
        jaywalk_share: share of pedestrians who cross on red and anywhere.
        population: a shipped population's name, a TOML file, or its parsed content; None for
            drivers around the profiles.
        behaviors: behaviours of one's own, as `behaviors.read_behaviors` takes them; None for none.
    """

    mix: str | Mapping[Behavior, float] | Mapping[str, float] | None
    kinds: str | Mapping[AgentKind, float] | Mapping[str, float] | None
    spread: float
    duration_s: float
    step_s: float
    jaywalk_share: float
    population: str | Path | Mapping[str, Any] | Population | None
    behaviors: str | Path | Mapping[str, Any] | None


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


def make_scenario(
    name: str, sources: Sources, flows: Sequence[RouteFlow], options: PopulationOptions
) -> Scenario:
    """A scenario on the road of some sources; netconvert builds nets that are not shipped."""
    road = read_road(net_of(sources), name)
    return Scenario(name, road, tuple(flows), **parse_population(options))


def parse_population(options: PopulationOptions) -> dict[str, Any]:
    """The population as `Scenario` takes it, from options as a user writes them."""
    population, own = options.get("population"), read_behaviors(options.get("behaviors"))
    return {
        **options,
        "behaviors": own,
        "mix": parse_mix(options.get("mix"), own),
        "kinds": parse_kinds(options.get("kinds")),
        "population": None if population is None else read_population(population),
    }


def parse_flow(flow: str | float, levels: Mapping[str, float], field: str = "flow") -> float:
    """Vehicles per hour over all entries of a road together.

    Args:
        flow: a level's name or a number, possibly written as text.
        levels: vehicles per hour of each named level.
        field: what messages call it.

    Raises:
        InputError: if it is neither a level nor a number >= 0.

    Examples:
        >>> parse_flow("medium", {"medium": 2400.0}), parse_flow("900", {})
        (2400.0, 900.0)
    """
    if isinstance(flow, str) and flow in levels:
        return levels[flow]
    value = _number(flow)
    if not 0 <= value < math.inf:
        expected = " or ".join([*levels, "a number per hour >= 0"])
        raise InputError(f"{field}: found {flow!r:.80}, expected {expected}")
    return value


def parse_mix(
    mix: str | Mapping[Behavior, float] | Mapping[str, float] | None,
    own: Sequence[Behavior] = (),
) -> dict[Behavior, float]:
    """The share of each behaviour among drivers.

    Args:
        mix: None for equal shares, a mapping, or text like ``"impatient=.2,timid=.8"``. A style,
            as in ``"aggressive=.2,conservative=.8"``, stands for its three of the six behaviours in
            equal shares. Behaviours that are not named have no share.
        own: behaviours beside the six.

    Raises:
        InputError: if a behaviour is unknown or named twice, a share is negative or no number, or
            the shares do not add to 1.

    Examples:
        >>> parse_mix("reckless=.25, timid=.75")
        {<Behavior.RECKLESS: 'reckless'>: 0.25, <Behavior.TIMID: 'timid'>: 0.75}
        >>> [round(share, 2) for share in parse_mix("aggressive=.3,timid=.7").values()]
        [0.1, 0.1, 0.1, 0.7]
    """
    known = (*BEHAVIORS, *own)
    if mix is None:
        return dict.fromkeys(known, 1.0 / len(known))
    styles = {str(s): [b for b in BEHAVIORS if b.style is s] for s in Style}
    return _shares("mix", mix, known, styles)


def parse_kinds(
    kinds: str | Mapping[AgentKind, float] | Mapping[str, float] | None,
) -> dict[AgentKind, float]:
    """The share of each kind of vehicle; None for cars only, else as `parse_mix` takes shares.

    Examples:
        >>> parse_kinds("car=.9,bus=.1")
        {<AgentKind.CAR: 'car'>: 0.9, <AgentKind.BUS: 'bus'>: 0.1}
    """
    vehicles = [kind for kind in AgentKind if kind is not AgentKind.PEDESTRIAN]
    return {AgentKind.CAR: 1.0} if kinds is None else _shares("kinds", kinds, vehicles, {})


def _number(value: object) -> float:
    """A value as a number; NaN if it is none."""
    try:
        return math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _shares(
    field: str,
    given: str | Mapping[K, float] | Mapping[str, float],
    members: Sequence[K],
    groups: Mapping[str, Sequence[K]],
) -> dict[K, float]:
    """Shares by member; the name of a group gives each of its members an equal part."""
    if isinstance(given, str):
        parts = [part.partition("=") for part in given.split(",")]
        for name, equals, _ in parts:
            if not equals:
                raise InputError(f"{field}: found {name.strip()!r}, expected name=share")
        pairs: list[tuple[str, object]] = [
            (name.strip(), share.strip()) for name, _, share in parts
        ]
    elif isinstance(given, Mapping):
        pairs = [(str(name), share) for name, share in given.items()]
    else:
        raise InputError(f"{field}: found {given!r:.80}, expected shares by name")
    named = {**{str(member): [member] for member in members}, **groups}
    shares: dict[K, float] = {}
    for name, value in pairs:
        if name not in named:
            raise InputError(f"{field}: found {name!r:.80}, expected one of {', '.join(named)}")
        for member in named[name]:
            if member in shares:
                raise InputError(f"{field}: found {str(member)!r} twice, expected it once")
        share = _number(value)
        if not 0 <= share < math.inf:
            raise InputError(f"{field}: found {name}={value!r}, expected a share >= 0")
        shares |= dict.fromkeys(named[name], share / len(named[name]))
    total = sum(shares.values())
    if abs(total - 1.0) > 1e-6:
        raise InputError(f"{field}: found shares adding to {total:g}, expected 1")
    return shares
