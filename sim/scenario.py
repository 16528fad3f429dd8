"""A scenario: a road, the demand on it, and the road-agents that are drawn from the demand.

The agents are drawn before any engine runs, so that the same drivers drive in every engine.
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeVar

import numpy as np

from behaviors.errors import InputError, counted
from behaviors.labels import BEHAVIORS, Behavior, Style, tables_of
from behaviors.populations import Population
from behaviors.profiles import DEFAULT_SPREAD, Profile, sample_profile
from sim.frames import KINDS, AgentKind
from sim.road import Road

M = TypeVar("M")

MAX_PER_HOUR: Final = 100_000.0
"""Most vehicles, and most pedestrians, per hour over all flows; twice the capacity of the widest
scenario."""

MAX_DURATION_S: Final = 86_400.0
"""Longest episode, s (a day)."""

CarFollowing = Literal["Krauss", "IDM"]
"""The car-following law of all drivers in a run, by SUMO's names."""

IMPERFECTION: Final = 0.2
"""Krauss's sigma, the same for every driver (SUMO's default is 0.5). IDM has none."""

WALK_START_M: Final = 40.0
"""Pedestrians enter this far before the end of their first edge, so that those who cross do so
within an episode and not after minutes of sidewalk."""


@dataclass(frozen=True, slots=True)
class RouteFlow:
    """The demand along one route.

    Attributes:
        route: edge ids from first to last.
        per_hour: agents per hour, with exponential gaps between departures.
        walking: whether the agents are pedestrians.
    """

    route: tuple[str, ...]
    per_hour: float
    walking: bool = False


@dataclass(frozen=True, slots=True)
class AgentSpec:
    """One road-agent, drawn before the engine runs.

    Attributes:
        id: unique within the episode.
        kind: what it is.
        behavior: its driver's true behaviour; None for pedestrians, and where it is not known.
        profile: its driver's own numbers; None for pedestrians.
        route: edge ids from first to last.
        depart_s: when it wants to enter, s.
        length_m: m.
        width_m: m.
        speed_mps: walking speed of a pedestrian, m/s; 0 for those that drive.
        seed: seed of the agent's own chance decisions.
        jaywalks: whether a pedestrian crosses anywhere and on red.
        style_label: the style of a driver whose behaviour is unknown; see `style`.
    """

    id: int
    kind: AgentKind
    behavior: Behavior | None
    profile: Profile | None
    route: tuple[str, ...]
    depart_s: float
    length_m: float
    width_m: float
    speed_mps: float = 0.0
    seed: int = 0
    jaywalks: bool = False
    style_label: Style | None = None

    @property
    def style(self) -> Style | None:
        """The style of its behaviour, or else what is known of it."""
        return self.style_label if self.behavior is None else self.behavior.style


@dataclass(frozen=True)
class Scenario:
    """A road with demand and a mix of drivers.

    Attributes:
        name: registered name.
        road: the road network.
        flows: the demand along each route; at most `MAX_PER_HOUR` vehicles and as many pedestrians
            in all.
        mix: share of each behaviour among drivers; sums to 1.
        spread: log-normal spread between drivers of one behaviour, at most 1 (two thirds of them
            are then within a factor of e).
        duration_s: length of an episode, s; at least a step, at most `MAX_DURATION_S`.
        step_s: time between frames, s.
        kinds: share of each vehicle kind; sums to 1.
        jaywalk_share: share of pedestrians who cross where and when they should not.
        population: of which drivers are drawn; None for drivers around the profiles, with numbers
            independent of each other.
        behaviors: those of one's own that its drivers may have, beside the six.
    """

    name: str
    road: Road
    flows: tuple[RouteFlow, ...]
    mix: Mapping[Behavior, float] = field(
        default_factory=lambda: dict.fromkeys(BEHAVIORS, 1.0 / len(BEHAVIORS))
    )
    spread: float = DEFAULT_SPREAD
    duration_s: float = 300.0
    step_s: float = 0.1
    kinds: Mapping[AgentKind, float] = field(default_factory=lambda: {AgentKind.CAR: 1.0})
    jaywalk_share: float = 0.1
    population: Population | None = None
    behaviors: tuple[Behavior, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated, by name."""
        for flow in self.flows:
            if not math.isfinite(flow.per_hour) or flow.per_hour < 0:
                raise InputError(f"flow: found {flow.per_hour}, expected vehicles per hour >= 0")
            if not flow.route:
                raise InputError("flows: found a route without edges, expected at least one")
        if AgentKind.PEDESTRIAN in self.kinds:
            raise InputError("kinds: found pedestrian, expected kinds of vehicles")
        for name, walking in (("flow", False), ("pedestrians_per_h", True)):
            per_hour = self.per_hour(walking=walking)
            if per_hour > MAX_PER_HOUR * (1 + 1e-9):  # the parts of a total may add up to more
                raise InputError(
                    f"{name}: found {per_hour:g} per hour, expected at most {MAX_PER_HOUR:g}"
                )
        for name, shares in (("mix", self.mix), ("kinds", self.kinds)):
            values = list(shares.values())
            if not all(v >= 0 for v in values) or not abs(sum(values) - 1.0) <= 1e-6:
                expected = "shares >= 0 that add up to 1"
                raise InputError(f"{name}: found shares {values}, expected {expected}")
        for name, value, least, most in (
            ("spread", self.spread, 0.0, 1.0),
            ("jaywalk_share", self.jaywalk_share, 0.0, 1.0),
            ("step_s", self.step_s, 0.01, 1.0),
            ("duration_s", self.duration_s, self.step_s, MAX_DURATION_S),
        ):
            if not least <= value <= most:
                raise InputError(f"{name}: found {value}, expected {least:g} to {most:g}")

    @property
    def population_option(self) -> dict[str, Any]:
        """Options of an episode that state the population and behaviours of one's own, if any."""
        population = {} if self.population is None else {"population": self.population.option}
        return population | ({"behaviors": tables_of(self.behaviors)} if self.behaviors else {})

    @property
    def steps(self) -> int:
        """How many frames an episode has: the last is at or just before its end."""
        return math.floor(self.duration_s / self.step_s + 1e-6)

    def per_hour(self, *, walking: bool) -> float:
        """Demand over all routes: pedestrians per hour if ``walking``, else vehicles per hour."""
        return sum(flow.per_hour for flow in self.flows if flow.walking is walking)

    def __repr__(self) -> str:
        """The demand, the duration and the size of the road."""
        return (
            f"Scenario({self.name:.60}: {self.per_hour(walking=False):g} vehicles/h and "
            f"{self.per_hour(walking=True):g} pedestrians/h on {counted(len(self.flows), 'route')}"
            f", {self.duration_s:g} s in steps of {self.step_s:g} s, "
            f"road {self.road.name:.60} with {counted(len(self.road.lanes), 'lane')})"
        )


DIMENSIONS_M: Final[dict[AgentKind, tuple[float, float, float]]] = {
    AgentKind.CAR: (4.6, 1.8, 0.10),
    AgentKind.BUS: (12.0, 2.5, 0.02),
    AgentKind.TRUCK: (8.5, 2.4, 0.10),
    AgentKind.MOTORCYCLE: (2.2, 0.9, 0.05),
    AgentKind.BICYCLE: (1.8, 0.65, 0.03),
    AgentKind.PEDESTRIAN: (0.25, 0.5, 0.0),
}
"""Median length and width, m, and log-normal spread of the length (SUMO's defaults for its vehicle
classes, cars rounded to a European median; the spreads are our choice)."""


@dataclass(frozen=True, slots=True)
class KindLimits:
    """Limits of a kind of vehicle, for all its drivers.

    Attributes:
        max_speed_mps: m/s.
        max_accel_mps2: m/s2.
        max_decel_mps2: largest ordinary braking, m/s2.
        emergency_decel_mps2: hardest braking physically possible, m/s2.
        cruise_mps: speed that an average driver chooses however high the limit, m/s; multiplied by
            the driver's speed factor.
    """

    max_speed_mps: float
    max_accel_mps2: float
    max_decel_mps2: float
    emergency_decel_mps2: float
    cruise_mps: float = math.inf


KIND_LIMITS: Final[dict[AgentKind, KindLimits]] = {
    AgentKind.CAR: KindLimits(55.6, 8.0, 9.0, 9.0),
    AgentKind.BUS: KindLimits(23.6, 1.2, 4.0, 7.0),
    AgentKind.TRUCK: KindLimits(36.1, 1.3, 4.0, 7.0),
    AgentKind.MOTORCYCLE: KindLimits(55.6, 6.0, 10.0, 10.0),
    AgentKind.BICYCLE: KindLimits(13.9, 1.2, 3.0, 7.0, 5.56),
}
"""SUMO's defaults for its vehicle classes; a car's acceleration and ordinary braking are left to
its driver, up to what tyres hold."""

WALKING_SPEED_MPS: Final = (1.34, 0.26)
"""Mean and standard deviation of pedestrians' free speed (Weidmann 1993)."""


def sample_agents(
    scenario: Scenario, seed: int, population: Population | None = None
) -> tuple[AgentSpec, ...]:
    """Draw all agents of an episode, in order of departure, with ids 0, 1, 2, ...

    Each flow draws from its own generator, so changing one flow leaves the agents of the others as
    they were. The same seed draws the same agents.

    Args:
        scenario: whose demand to draw.
        seed: of all chance, as `check_seed` takes it.
        population: of which drivers are drawn; None for the scenario's.
    """
    check_seed(seed)
    if population is not None:
        scenario = dataclasses.replace(scenario, population=population)
    drawn: list[AgentSpec] = []
    children = np.random.SeedSequence(seed).spawn(len(scenario.flows))
    for flow, child in zip(scenario.flows, children, strict=True):
        rng = np.random.default_rng(child)
        time_s = 0.0
        while flow.per_hour > 0:
            time_s += float(rng.exponential(3600.0 / flow.per_hour))
            if time_s >= scenario.duration_s:
                break
            draw = _draw_pedestrian if flow.walking else _draw_driver
            drawn.append(draw(scenario, flow.route, time_s, rng))
    drawn.sort(key=lambda a: a.depart_s)
    return tuple(dataclasses.replace(agent, id=i) for i, agent in enumerate(drawn))


def check_seed(seed: int) -> None:
    """Refuse a seed that an engine does not take."""
    if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**31:
        raise InputError(f"seed: found {seed!r}, expected an integer from 0 to 2**31 - 1")


def check_agents(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> None:
    """Refuse what no engine can drive: a bad seed, an id twice, an edge that is not on the road."""
    check_seed(seed)
    if len({agent.id for agent in agents}) != len(agents):
        raise InputError("agents: found an id twice, expected unique ids")
    edges = {lane.edge for lane in scenario.road.lanes if not lane.internal}
    for agent in agents:
        for edge in agent.route:
            if edge not in edges:
                raise InputError(
                    f"agent {agent.id}: found edge {edge!r} in its route, "
                    f"expected an edge of road {scenario.road.name!r}"
                )


def _draw_pedestrian(
    scenario: Scenario, route: tuple[str, ...], depart_s: float, rng: np.random.Generator
) -> AgentSpec:
    seed = int(rng.integers(2**31))
    length, width, _ = DIMENSIONS_M[AgentKind.PEDESTRIAN]
    speed = float(np.clip(rng.normal(*WALKING_SPEED_MPS), 0.6, 2.2))
    jaywalks = bool(rng.random() < scenario.jaywalk_share)
    kind = AgentKind.PEDESTRIAN
    return AgentSpec(0, kind, None, None, route, depart_s, length, width, speed, seed, jaywalks)


def _draw_driver(
    scenario: Scenario, route: tuple[str, ...], depart_s: float, rng: np.random.Generator
) -> AgentSpec:
    seed = int(rng.integers(2**31))
    behavior = _choose((*BEHAVIORS, *scenario.behaviors), scenario.mix, rng)
    kind = _choose(KINDS, scenario.kinds, rng)
    profile = sample_profile(behavior.profile, rng, scenario.spread)
    if scenario.population is not None:
        own = np.random.default_rng((seed, _POPULATION_STREAM))
        profile = scenario.population.draw(behavior, own, scenario.spread)
    profile = _limited(profile, kind)
    median, width, spread = DIMENSIONS_M[kind]
    length = median * math.exp(spread * rng.standard_normal())
    return AgentSpec(0, kind, behavior, profile, route, depart_s, length, width, 0.0, seed)


def _limited(wanted: Profile, kind: AgentKind) -> Profile:
    """A driver's wishes as far as its vehicle can fulfil them."""
    limits = KIND_LIMITS[kind]
    return dataclasses.replace(
        wanted,
        max_accel_mps2=min(wanted.max_accel_mps2, limits.max_accel_mps2),
        comfort_decel_mps2=min(wanted.comfort_decel_mps2, limits.max_decel_mps2),
    )


_REDRAWN_STREAM: Final = 7
"""Number of a driver's random stream for other behaviours; controllers use smaller ones."""

_POPULATION_STREAM: Final = 9
"""Number of a driver's random stream for its numbers in a population, so that the same departures,
routes and behaviours are drawn whatever the population is (worlds use 8)."""


def with_behavior(
    agent: AgentSpec,
    behavior: Behavior,
    spread: float = DEFAULT_SPREAD,
    population: Population | None = None,
) -> AgentSpec:
    """The same driver, had it been drawn with another behaviour; spread as in `Scenario`.

    The vehicle, route and departure stay. The profile is drawn from the driver's own random stream,
    so the same driver and behaviour give the same profile in every run.
    """
    if agent.profile is None:
        raise InputError(f"agent {agent.id}: found a pedestrian, expected a driver")
    six = behavior in BEHAVIORS
    number = behavior.code if six else zlib.crc32(behavior.encode())  # the same in every file
    rng = np.random.default_rng((agent.seed, _REDRAWN_STREAM, number))
    if population is None:
        profile = sample_profile(behavior.profile, rng, spread)
    else:
        profile = population.draw(behavior, rng, spread)
    limited = _limited(profile, agent.kind)
    return dataclasses.replace(agent, behavior=behavior, profile=limited)


def _choose(members: Sequence[M], shares: Mapping[M, float], rng: np.random.Generator) -> M:
    """Draw one of the members that have a share."""
    shared = [member for member in members if shares.get(member, 0.0) > 0]
    weights = np.array([shares[member] for member in shared])
    return shared[int(rng.choice(len(shared), p=weights / weights.sum()))]
