"""The drivers of a world: the mix, what all of them have in common, and how they vary."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from behaviors.labels import BEHAVIORS, PROFILES, Behavior
from behaviors.populations import LOWEST_HEADWAY_S
from behaviors.profiles import FARTHEST_SPREADS, Profile
from graphrqi.posterior import AGGRESSIVE
from sim.frames import AgentKind, FloatArray
from sim.scenario import KIND_LIMITS, AgentSpec

TRAF_MIX: Final = (53, 13, 52, 266, 2, 6)
"""Agents of each behaviour in the annotated TRAF videos, in the order of ``BEHAVIORS``."""

VARIED: Final[dict[str, tuple[float, float]]] = {
    "speed_factor": (0.08, 1.0),
    "time_headway_s": (0.22, -1.0),
    "min_gap_m": (0.25, -1.0),
    "max_accel_mps2": (0.2, 1.0),
    "comfort_decel_mps2": (0.15, 1.0),
    "lane_change_gain": (0.5, 1.0),
    "lane_change_patience_s": (0.4, -1.0),
    "lane_change_assertiveness": (0.25, 1.0),
    "gap_acceptance_s": (0.25, -1.0),
    "startup_delay_s": (0.3, -1.0),
}
"""Numbers of the profiles by which whole populations differ: the log-normal spread between
populations, and whether a number grows or falls with how briskly a driver drives."""

MIXES: Final = {
    "equal": 0.25, "any": 0.3, "one-sided": 0.2, "traf": 0.1, "one style": 0.08, "pure": 0.07,
}  # fmt: skip
"""Chance of each way of drawing the mix."""

ACTS: Final = ("cut_in_rate_per_min", "stop_rate_per_min", "wrong_way_rate_per_min")
"""Rates of deliberate acts, which differ between worlds."""


_STREAM: Final = 8
"""Number of a driver's random stream for its numbers in a world."""


@dataclass(frozen=True, slots=True)
class Population:
    """Drivers of a world.

    Attributes:
        mix: share of each behaviour.
        mix_kind: how it was drawn, a key of `MIXES`.
        kinds: share of each kind of vehicle.
        spread: log-normal spread between drivers of one behaviour.
        correlation: share of that spread's variance that all numbers of a driver have in common.
        shifts: factor on a number of every driver, by the number's name.
        acts: factor on how often drivers cut in, stop for no reason or overtake on the wrong side.
    """

    mix: dict[Behavior, float]
    mix_kind: str
    kinds: dict[AgentKind, float]
    spread: float
    correlation: float
    shifts: dict[str, float]
    acts: float

    def options(self) -> dict[str, Any]:
        """Its numbers with words for keys."""
        return {
            **dataclasses.asdict(self),
            "mix": {str(b): share for b, share in self.mix.items()},
            "kinds": {str(k): share for k, share in self.kinds.items()},
        }

    def drivers(self, agents: Sequence[AgentSpec]) -> tuple[AgentSpec, ...]:
        """The same agents with numbers of this world, on which each driver's own seed decides."""
        return tuple(self._driver(agent) for agent in agents)

    def _driver(self, agent: AgentSpec) -> AgentSpec:
        if agent.profile is None or agent.behavior is None:
            return agent
        rng = np.random.default_rng((agent.seed, _STREAM))
        median, limits = PROFILES[agent.behavior], KIND_LIMITS[agent.kind]
        drawn = rng.standard_normal(len(VARIED) + 1).clip(-FARTHEST_SPREADS, FARTHEST_SPREADS)
        common, own = float(drawn[0]), drawn[1:]
        numbers: dict[str, float] = {}
        for z, (name, (_, tendency)) in zip(own, VARIED.items(), strict=True):
            mixed = (1 - self.correlation) ** 0.5 * z
            mixed += self.correlation**0.5 * common * tendency
            factor = math.exp(self.spread * mixed) * self.shifts.get(name, 1.0)
            numbers[name] = getattr(median, name) * factor
        numbers["time_headway_s"] = max(numbers["time_headway_s"], LOWEST_HEADWAY_S)
        numbers["max_accel_mps2"] = min(numbers["max_accel_mps2"], limits.max_accel_mps2)
        numbers["comfort_decel_mps2"] = min(numbers["comfort_decel_mps2"], limits.max_decel_mps2)
        for name in ACTS:
            numbers[name] = getattr(agent.profile, name) * self.acts
        profile: Profile = dataclasses.replace(agent.profile, **numbers)
        return dataclasses.replace(agent, profile=profile)


def draw_population(rng: np.random.Generator) -> Population:
    """Draw the drivers."""
    kind = str(rng.choice(list(MIXES), p=list(MIXES.values())))
    shares = _draw_mix(kind, rng)
    shifted = rng.random() < 0.8
    shifts = {
        name: round(math.exp(deviation * rng.standard_normal()), 3) if shifted else 1.0
        for name, (deviation, _) in VARIED.items()
    }
    trucks = float(rng.choice((0.0, 0.0, 0.05, 0.15)))
    kinds = {AgentKind.CAR: 1.0 - trucks, AgentKind.TRUCK: trucks}
    return Population(
        mix={b: float(s) for b, s in zip(BEHAVIORS, shares, strict=True)},
        mix_kind=kind,
        kinds={k: share for k, share in kinds.items() if share},
        spread=round(float(rng.uniform(0.05, 0.2)), 3),
        correlation=round(float(rng.choice((0.0, 0.0, 0.5, 0.8))), 3),
        shifts=shifts,
        acts=round(float(rng.choice((0.0, rng.uniform(0.2, 1.0), 1.0))), 3),
    )


def _draw_mix(kind: str, rng: np.random.Generator) -> FloatArray:
    """(6,) shares in the order of ``BEHAVIORS``; they sum to 1."""
    n = len(BEHAVIORS)
    if kind == "equal":
        shares = np.full(n, 1.0)
    elif kind == "traf":
        shares = np.array(TRAF_MIX, dtype=np.float64)
    elif kind == "pure":
        shares = np.zeros(n)
        shares[rng.integers(n)] = 1.0
    elif kind == "one style":
        shares = np.where((rng.random() < 0.5) == AGGRESSIVE, rng.dirichlet(np.full(n, 2.0)), 0.0)
    elif kind == "one-sided":
        shares = np.full(n, 0.4 / (n - 1))
        shares[rng.integers(n)] = 0.6
    else:
        shares = rng.dirichlet(np.full(n, 1.0))
    rounded: FloatArray = np.round(shares / shares.sum(), 6)
    rounded[int(rounded.argmax())] += 1.0 - rounded.sum()
    return rounded
