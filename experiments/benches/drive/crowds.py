"""Whom a policy has to drive among: each behaviour alone, all of them, or clones.

With one seed everybody departs at the same time for the same goal in every crowd; only who drives
how differs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILES, Profile
from sim.scenario import AgentSpec

STANDARD: Final = Profile(
    speed_factor=1.0, time_headway_s=1.5, min_gap_m=2.0, max_accel_mps2=1.4,
    comfort_decel_mps2=2.0, politeness=0.2, lane_change_gain=1.0, lane_change_patience_s=0.0,
    lane_change_assertiveness=1.0, gap_acceptance_s=1.0, crossing_gap_s=10.0,
    yield_probability=1.0, red_run_probability=0.0, stop_roll_probability=0.0, yellow_run_s=0.0,
    insistence=0.0, startup_delay_s=0.0, cut_in_rate_per_min=0.0, stop_rate_per_min=0.0,
    wrong_way_rate_per_min=0.0,
)  # fmt: skip
"""The driver of homogeneous traffic: IDM's and MOBIL's usual numbers (Kesting, Treiber and Helbing
2010, Phil. Trans. R. Soc. A 368, table 1), who breaks no rule."""

RECORDED: Final[dict[str, float]] = {
    "time_headway_s": 1.3, "min_gap_m": 2.9, "max_accel_mps2": 2.1, "comfort_decel_mps2": 2.2,
}  # fmt: skip
"""Median drivers of recordings: IDM fitted to NGSIM's I-80 by us, and braking as fitted to highD
(Zhang and Sun 2024, Transportation Research Part C). A stand-in: between drivers, the spread is
that of the behaviours."""


@dataclass(frozen=True, slots=True)
class Crowd:
    """Who the other drivers are.

    Attributes:
        mix: share of each behaviour, as the environments take it.
        changed: what becomes of each drawn agent.
    """

    mix: dict[str, float] | None = None
    changed: Callable[[AgentSpec], AgentSpec] = lambda agent: agent


def standard(agent: AgentSpec) -> AgentSpec:
    """The agent as a clone of the `STANDARD` driver; a pedestrian as it is."""
    if agent.profile is None:
        return agent
    return dataclasses.replace(agent, behavior=None, profile=STANDARD)


_MEDIANS: Final = {
    name: float(np.median([getattr(PROFILES[b], name) for b in BEHAVIORS])) for name in RECORDED
}


def recorded(agent: AgentSpec) -> AgentSpec:
    """The agent with car-following numbers whose medians are `RECORDED`; a pedestrian as it is."""
    if agent.profile is None:
        return agent
    scaled = {
        name: getattr(agent.profile, name) * median / _MEDIANS[name]
        for name, median in RECORDED.items()
    }
    return dataclasses.replace(agent, profile=dataclasses.replace(agent.profile, **scaled))


HOMOGENEOUS, MIXED = "homogeneous", "mixed"

CROWDS: Final[dict[str, Crowd]] = {
    **{b.value: Crowd({b.value: 1.0}) for b in BEHAVIORS},
    MIXED: Crowd(),
    "recorded": Crowd(None, recorded),
    HOMOGENEOUS: Crowd(None, standard),
}
"""By name: the behaviours alone, all of them in equal shares, the same shifted to recorded medians,
and clones."""
