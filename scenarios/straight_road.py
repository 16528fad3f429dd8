"""A straight one-way road with a mid-block crossing where pedestrians have priority."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from behaviors.labels import Behavior
from behaviors.profiles import DEFAULT_SPREAD
from scenarios.demand import parse_flow, parse_mix
from scenarios.networks.build import shipped_net
from sim.net import read_road
from sim.scenario import Scenario, Stream

FLOWS_PER_LANE: Final[dict[str, float]] = {"light": 300.0, "medium": 700.0, "dense": 1000.0}
"""Vehicles per hour and lane of each named flow (our choice: free, interacting, near capacity
with a crossing in use)."""

PEDESTRIANS_PER_H: Final = 120.0
"""Pedestrians per hour over the crossing (our choice; several hundred jam a dense road)."""


def straight_road(
    *,
    flow: str | float = "medium",
    mix: str | Mapping[Behavior, float] | Mapping[str, float] | None = None,
    spread: float = DEFAULT_SPREAD,
    duration_s: float = 300.0,
    step_s: float = 0.1,
    pedestrians_per_h: float = PEDESTRIANS_PER_H,
) -> Scenario:
    """800 m of one-way road, 3 lanes, 50 km/h, a zebra crossing half-way.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all lanes.
        mix: share of each behaviour, as a mapping or ``"impatient=.2,..."``; None for equal.
        spread: how much drivers of one behaviour differ.
        duration_s: s.
        step_s: time between frames, s.
        pedestrians_per_h: pedestrians per hour who cross.

    Returns:
        The scenario.

    Raises:
        InputError: if an option is out of range; the message names it.

    Example:
        >>> straight_road(flow="light").name
        'straight_road'
    """
    lanes = 3
    levels = {name: lanes * value for name, value in FLOWS_PER_LANE.items()}
    crossers = parse_flow(pedestrians_per_h, {}) / 4
    return Scenario(
        name="straight_road",
        road=read_road(shipped_net("straight_road"), "straight_road"),
        streams=(
            Stream(("east_in", "east_out"), parse_flow(flow, levels)),
            Stream(("east_in", "west_out"), crossers, walking=True),
            Stream(("west_in", "east_out"), crossers, walking=True),
            Stream(("east_in", "west_in"), crossers, walking=True),
            Stream(("west_in", "east_in"), crossers, walking=True),
        ),
        mix=parse_mix(mix),
        spread=spread,
        duration_s=duration_s,
        step_s=step_s,
    )


if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("straight_road"))
