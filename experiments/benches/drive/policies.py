"""Who drives the ego vehicle: our policies by name, or ``module:function`` of the user's own.

A policy is made for one environment, before its first episode: ``make(env)`` returns a function
that takes an observation and returns an action. The attribute ``config`` of ``make``, if it has
one, changes the environment's configuration: ``{"action": {"type": "ContinuousAction"}}``. A
trained network is loaded inside ``make``, by the library that wrote it: no file of a policy is
opened here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, Protocol

from behaviors.errors import InputError, lookup
from behaviors.registry import own_function
from experiments.benches.navigation import MOST_ACCEL_MPS2, BeliefTracker, PlannedEgo
from graphrqi.stream import DEFAULT_MODEL
from sim.frames import Frame

Act = Callable[[Mapping[str, Any]], Any]
"""From an observation to an action."""


class DrivenEnv(Protocol):
    """What a policy may use of its environment, beside what gymnasium gives."""

    scenario: Any
    time: float
    ego_id: int
    truth: Mapping[int, int]
    on_frame: Callable[[Frame], object] | None


def do_nothing(env: DrivenEnv) -> Act:
    """Keep speed and lane, whatever happens."""
    return lambda observation: 1


def idm_mobil(env: DrivenEnv) -> Act:
    """highway-env's own driver: IDM and MOBIL, no signals, no pedestrians."""
    return lambda observation: 0


def planner(env: DrivenEnv, arm: str = "classified", model: str = DEFAULT_MODEL) -> Act:
    """Our planner, told nothing, the classifier's beliefs or the truth of the other drivers."""
    tracker = BeliefTracker(model if arm == "classified" else None)
    env.on_frame = tracker
    driving: list[PlannedEgo] = []

    def act(observation: Mapping[str, Any]) -> Any:
        if not driving or env.time == 0.0:
            road = env.scenario.road
            driving[:] = [PlannedEgo(arm, tracker, env.truth, road, env.ego_id)]
        return driving[0].action(env.time)

    return act


CONTINUOUS: Final[dict[str, Any]] = {
    "action": {
        "type": "ContinuousAction", "acceleration_range": [-MOST_ACCEL_MPS2, MOST_ACCEL_MPS2]
    },
    "policy_frequency": 10,
}  # fmt: skip
"""How the planner steers."""

POLICIES: Final[dict[str, tuple[Callable[..., Act], dict[str, Any]]]] = {
    "do-nothing": (do_nothing, {}),
    "idm-mobil": (idm_mobil, {"action": {"type": "StockDriver"}}),
    "planner-blind": (partial(planner, arm="blind"), CONTINUOUS),
    "planner-told": (partial(planner, arm="classified"), CONTINUOUS),
    "planner-true": (partial(planner, arm="true"), CONTINUOUS),
}
"""Our policies, with what each changes in an environment's configuration."""

ALIASES: Final = {"planner": "planner-told"}

BLIND: Final = frozenset({*POLICIES, *ALIASES})
"""The policies that look at no observation; the planner sees the frames."""


def get_policy(name: str) -> tuple[Callable[..., Act], dict[str, Any]]:
    """A policy and its environment's configuration.

    Args:
        name: a key of `POLICIES`, "planner", or "module:function" that can be imported from here.

    Raises:
        InputError: if there is none.
    """
    if ":" not in name:
        return lookup(POLICIES, ALIASES.get(name, name), "policy")
    make = own_function("policy", name)
    config = getattr(make, "config", {})
    if not isinstance(config, Mapping):
        raise InputError(f"policy: found {name}.config {config!r}, expected a mapping")
    return make, dict(config)
