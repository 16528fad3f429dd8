"""Straight roads: one-way or two-way, with or without a mid-block crossing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from behaviors.labels import Behavior
from behaviors.profiles import DEFAULT_SPREAD
from scenarios.demand import parse_flow, parse_kinds, parse_mix
from scenarios.networks.build import net_of
from scenarios.networks.geometry import LIMIT_MPS, TWO_WAY_LENGTH_M, StraightGeometry
from sim.frames import AgentKind
from sim.road.net import read_road
from sim.scenario import DEFAULT_JAYWALK_SHARE, Scenario, Stream

FLOWS_PER_LANE: Final[dict[str, float]] = {"light": 300.0, "medium": 700.0, "dense": 1000.0}
"""Vehicles per hour and lane of each named flow on a one-way road (our choice: free, interacting,
near capacity with a crossing in use)."""

TWO_WAY_FLOWS_PER_LANE: Final[dict[str, float]] = {"light": 150.0, "medium": 350.0, "dense": 600.0}
"""The same for two-way roads, where overtaking needs gaps in the oncoming traffic (our choice)."""

PEDESTRIANS_PER_H: Final = 160.0
"""Pedestrians per hour over the crossing (our choice; several hundred jam a dense road)."""


def straight_road(
    *,
    flow: str | float = "medium",
    mix: str | Mapping[Behavior, float] | Mapping[str, float] | None = None,
    kinds: str | Mapping[AgentKind, float] | Mapping[str, float] | None = None,
    spread: float = DEFAULT_SPREAD,
    duration_s: float = 300.0,
    step_s: float = 0.1,
    pedestrians_per_h: float = PEDESTRIANS_PER_H,
    jaywalk_share: float = DEFAULT_JAYWALK_SHARE,
    lanes: int = 3,
    two_way: bool = False,
    crossing: bool = True,
    length_m: float | None = None,
    limit_mps: float = LIMIT_MPS,
) -> Scenario:
    """A straight road; by default 800 m one-way, 3 lanes, 50 km/h, a zebra crossing half-way.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all lanes.
        mix: share of each behaviour, as a mapping or ``"impatient=.2,..."``; None for equal.
        kinds: share of each kind of vehicle, as a mapping or ``"car=.9,truck=.1"``; None for cars.
        spread: how much drivers of one behaviour differ.
        duration_s: s.
        step_s: time between frames, s.
        pedestrians_per_h: pedestrians per hour; those who do not jaywalk use the crossing, and
            where there is none, only jaywalkers cross.
        jaywalk_share: share of pedestrians who cross anywhere.
        lanes: lanes per direction, 1 to 5.
        two_way: whether there is traffic in the other direction too.
        crossing: whether there is a crossing, with priority for pedestrians.
        length_m: m; by default 800 one-way, 1200 two-way.
        limit_mps: speed limit, m/s.

    Returns:
        The scenario. Roads whose net is not shipped are built with netconvert.

    Raises:
        InputError: if an option is out of range; the message names it.

    Examples:
        >>> straight_road(flow="light", lanes=2).road.name
        'straight_road'
    """
    geometry = StraightGeometry(
        lanes=lanes,
        two_way=two_way,
        crossing=crossing,
        length_m=(TWO_WAY_LENGTH_M if two_way else 800.0) if length_m is None else length_m,
        limit_mps=limit_mps,
    )
    per_lane = TWO_WAY_FLOWS_PER_LANE if two_way else FLOWS_PER_LANE
    directions = 2 if two_way else 1
    levels = {name: lanes * directions * value for name, value in per_lane.items()}
    vehicles = parse_flow(flow, levels) / directions
    walkers = parse_flow(pedestrians_per_h, {}, "pedestrians_per_h") / 4
    across = (
        ("east_in", "west_out"),
        ("west_in", "east_out"),
        ("east_in", "west_in"),
        ("west_in", "east_in"),
    )
    along = (("east_in", "east_out"), ("west_in", "west_out"), ("east_in",), ("west_in",))
    streams = [Stream(("east_in", "east_out"), vehicles)]
    if two_way:
        streams.append(Stream(("west_in", "west_out"), vehicles))
    streams += [Stream(r, walkers, walking=True) for r in (across if crossing else along)]
    return Scenario(
        name="straight_road",
        road=read_road(net_of(geometry), "straight_road"),
        streams=tuple(streams),
        mix=parse_mix(mix),
        spread=spread,
        duration_s=duration_s,
        step_s=step_s,
        kinds=parse_kinds(kinds),
        jaywalk_share=jaywalk_share,
    )


if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("straight_road"))
