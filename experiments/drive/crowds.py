"""Whom a policy has to drive among: each behaviour alone, all of them, or clones.

With one seed everybody departs at the same time for the same goal in every crowd; only who drives
how differs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from behaviors.errors import lookup
from behaviors.labels import BEHAVIORS
from behaviors.profiles import Profile
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

RECORDED: Final = "us101"
"""The population of the recorded crowd."""


@dataclass(frozen=True, slots=True)
class Crowd:
    """Who the other drivers are.

    Attributes:
        mix: share of each behaviour, as the environments take it.
        changed: what becomes of each drawn agent.
        population: of which drivers are drawn, as the environments take it.
    """

    mix: str | dict[str, float] | None = None
    changed: Callable[[AgentSpec], AgentSpec] = lambda agent: agent
    population: str | None = None


def standard(agent: AgentSpec) -> AgentSpec:
    """The agent as a clone of the `STANDARD` driver; a pedestrian as it is."""
    if agent.profile is None:
        return agent
    return dataclasses.replace(agent, behavior=None, profile=STANDARD)


HOMOGENEOUS, MIXED = "homogeneous", "mixed"

CROWDS: Final[dict[str, Crowd]] = {
    **{str(b): Crowd({str(b): 1.0}) for b in BEHAVIORS},
    MIXED: Crowd(),
    "recorded": Crowd(population=RECORDED),
    HOMOGENEOUS: Crowd(None, standard),
}
"""By name: the behaviours alone, all of them in equal shares, the same with
numbers drawn from a recorded population, and clones."""


def crowd_of(name: str, own: Sequence[str] = ()) -> Crowd:
    """The crowd of a name.

    Args:
        name: a key of `CROWDS`, a behaviour of one's own, or a mix such as
            ``"aggressive=.4,conservative=.5,distracted=.1"``.
        own: names of behaviours of one's own.

    Raises:
        InputError: if there is none; the message suggests the nearest name.
    """
    if "=" in name:
        return Crowd(name)
    return lookup({**CROWDS, **{one: Crowd({one: 1.0}) for one in own}}, name, "crowd")
