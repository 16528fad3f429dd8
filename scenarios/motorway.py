"""Motorways: one carriageway, with or without an on-ramp and an off-ramp."""

from __future__ import annotations

import functools
from typing import Final, Unpack

from scenarios.demand import PopulationOptions, make_scenario, parse_flow
from scenarios.networks.geometries import MOTORWAY_LIMIT_MPS, motorway_sources
from sim.scenario import RouteFlow, Scenario

MOTORWAY_FLOWS_PER_LANE: Final = {"light": 500.0, "medium": 1000.0, "dense": 1500.0}
"""Vehicles per hour and lane of each named flow (free, interacting, three quarters of the
capacity)."""

RAMP_SHARE: Final = 0.15
"""Share of the traffic that enters by the on-ramp, and share that leaves by the off-ramp."""


def motorway(
    *,
    flow: str | float = "medium",
    lanes: int = 3,
    ramps: bool = False,
    length_m: float = 2000.0,
    limit_mps: float = MOTORWAY_LIMIT_MPS,
    **population: Unpack[PopulationOptions],
) -> Scenario:
    """One carriageway of a motorway; by default 2 km, 3 lanes, 120 km/h.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all entries.
        lanes: lanes, 1 to 5; 1 to 4 with ramps, between which there is one more.
        ramps: whether there is an on-ramp after a third and an off-ramp after two thirds.
        length_m: m.
        limit_mps: speed limit, m/s.
        population: see `scenarios.demand.PopulationOptions`.

    Raises:
        InputError: if an option is out of range; the message names it.

    Examples:
        >>> [flow.route for flow in motorway(ramps=True).flows][1]
        ('before', 'between', 'off')
    """
    sources = motorway_sources(lanes, ramps, length_m, limit_mps)
    levels = {name: lanes * value for name, value in MOTORWAY_FLOWS_PER_LANE.items()}
    vehicles = parse_flow(flow, levels)
    share = RAMP_SHARE if ramps else 0.0
    shares = {
        ("before", "between", "after"): (1.0 - share) ** 2,
        ("before", "between", "off"): (1.0 - share) * share,
        ("on", "between", "after"): share * (1.0 - share),
        ("on", "between", "off"): share * share,
    }
    flows = [RouteFlow(route, vehicles * part) for route, part in shares.items() if part > 0]
    return make_scenario("motorway", sources, flows, population)


motorway_ramps: Final = functools.partial(motorway, ramps=True)
"""A motorway with an on-ramp and an off-ramp: merging, weaving, leaving."""

if __name__ == "__main__":
    from scenarios import run_as_command

    run_as_command("motorway")
