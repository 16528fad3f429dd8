"""A signalised four-way intersection with sidewalks and crossings on every arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from behaviors.labels import Behavior
from behaviors.profiles import DEFAULT_SPREAD
from scenarios.demand import parse_flow, parse_mix
from scenarios.networks.build import shipped_net
from scenarios.networks.geometry import ARMS
from sim.net import read_road
from sim.scenario import Scenario, Stream

FLOWS: Final[dict[str, float]] = {"light": 600.0, "medium": 1200.0, "dense": 1800.0}
"""Vehicles per hour over all arms of each named flow (our choice: free, interacting, near
capacity)."""

TURNS: Final[dict[int, float]] = {1: 0.2, 2: 0.6, 3: 0.2}
"""Share of vehicles that leave by the arm that many places clockwise round from theirs: left,
straight, right (our choice)."""

PEDESTRIANS_PER_H: Final = 240.0
"""Pedestrians per hour over all arms (our choice)."""


def four_way_intersection(
    *,
    flow: str | float = "medium",
    mix: str | Mapping[Behavior, float] | Mapping[str, float] | None = None,
    spread: float = DEFAULT_SPREAD,
    duration_s: float = 300.0,
    step_s: float = 0.1,
    pedestrians_per_h: float = PEDESTRIANS_PER_H,
) -> Scenario:
    """Four arms of 250 m, 2 lanes per direction, 50 km/h, fixed-time signals of 60 s.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all arms.
        mix: share of each behaviour, as a mapping or ``"impatient=.2,..."``; None for equal.
        spread: how much drivers of one behaviour differ.
        duration_s: s.
        step_s: time between frames, s.
        pedestrians_per_h: pedestrians per hour over all arms.

    Returns:
        The scenario.

    Raises:
        InputError: if an option is out of range; the message names it.

    Example:
        >>> len(four_way_intersection().road.signal_groups)
        4
    """
    vehicles = parse_flow(flow, FLOWS) / len(ARMS)
    walkers = parse_flow(pedestrians_per_h, {}) / (len(ARMS) * len(TURNS))
    arms = list(ARMS)
    streams = []
    for i, arm in enumerate(arms):
        for places, share in TURNS.items():
            to = arms[(i - places) % len(arms)]
            streams.append(Stream((f"{arm}_in", f"{to}_out"), vehicles * share))
            streams.append(Stream((f"{arm}_in", f"{to}_out"), walkers, walking=True))
    return Scenario(
        name="four_way_intersection",
        road=read_road(shipped_net("four_way_intersection"), "four_way_intersection"),
        streams=tuple(streams),
        mix=parse_mix(mix),
        spread=spread,
        duration_s=duration_s,
        step_s=step_s,
    )


if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("four_way_intersection"))
