"""A city to drive in: a grid of blocks with signals, and vehicles that turn at random in it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final, Unpack

import numpy as np

from scenarios.demand import PopulationOptions, parse_flow, parse_population
from scenarios.networks.build import SHIPPED_BLOCKS, grid_net
from sim.road import Road
from sim.road.net import read_road
from sim.scenario import AgentSpec, RouteFlow, Scenario, sample_agents

ROUTE_EDGES: Final = 30
"""Edges of a route, where the city does not end before (4.5 km, ten minutes)."""

MOST_CITY_ROUTES: Final = 2000
"""Different routes at most; vehicles share them (enough to fill every street)."""

JUNCTION_FLOWS: Final[Mapping[str, float]] = {"light": 30.0, "medium": 60.0, "dense": 90.0}
"""Vehicles per hour and junction of each named flow, for trips of about ten minutes."""

JUNCTION_ROUTES: Final = 20
"""Different routes of `city` per junction, at most `MOST_CITY_ROUTES` (every street is the first of
one)."""


def city(
    *,
    flow: str | float = "medium",
    blocks: int = SHIPPED_BLOCKS,
    **population: Unpack[PopulationOptions],
) -> Scenario:
    """A grid of blocks of 150 m, two lanes each way, fixed-time signals at every junction.

    Routes are drawn once and are the same in every episode. They begin on any street, turn at
    random, and end after `ROUTE_EDGES` blocks.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour in the whole city. A trip takes
            some ten minutes: 6000 vehicles an hour are 1000 at a time.
        blocks: junctions along each side; all but 3 need netgenerate.
        population: see `scenarios.demand.PopulationOptions`.

    Raises:
        InputError: if an option is out of range, or netgenerate is needed and missing.

    Examples:
        >>> scenario = city(flow=900)
        >>> len(scenario.road.lanes), round(scenario.per_hour(walking=False))
        (276, 900)
    """
    junctions = blocks**2
    per_hour = parse_flow(flow, {name: each * junctions for name, each in JUNCTION_FLOWS.items()})
    road = read_road(grid_net(blocks), f"grid_{blocks}")
    routes = _random_routes(road, min(JUNCTION_ROUTES * junctions, MOST_CITY_ROUTES))
    flows = tuple(RouteFlow(route, per_hour / len(routes)) for route in routes)
    return Scenario("city", road, flows, **parse_population(population))


def city_agents(
    scenario: Scenario, vehicles: int, seed: int, within_s: float = 30.0
) -> tuple[AgentSpec, ...]:
    """A number of vehicles of a city, in order of departure, which all enter within some seconds.

    The cost of a city is asked per vehicle, so the flow does not matter here.
    """
    long_s = 1.3 * 3600.0 * vehicles / scenario.per_hour(walking=False) + 10.0
    drawn = sample_agents(dataclasses.replace(scenario, duration_s=long_s), seed)[:vehicles]
    departs_s = np.sort(np.random.default_rng((seed, 1)).uniform(0.0, within_s, len(drawn)))
    return tuple(
        dataclasses.replace(agent, depart_s=float(depart_s))
        for agent, depart_s in zip(drawn, departs_s, strict=True)
    )


def _random_routes(road: Road, count: int) -> list[tuple[str, ...]]:
    """Routes that turn at random, and leave the road only where nothing else is left."""
    edge = {lane.id: lane.edge for lane in road.lanes}
    found: dict[str, set[str]] = {}
    for link in road.connections:
        found.setdefault(edge[link.from_lane], set()).add(edge[link.to_lane])
    onward = {start: sorted(ways) for start, ways in found.items()}
    starts, rng = sorted(onward), np.random.default_rng((0, 0))
    routes = []
    for _ in range(count):
        route = [starts[int(rng.integers(len(starts)))]]
        while len(route) < ROUTE_EDGES and route[-1] in onward:
            ways = onward[route[-1]]
            staying = [way for way in ways if way in onward] or ways
            route.append(staying[int(rng.integers(len(staying)))])
        routes.append(tuple(route))
    return routes


if __name__ == "__main__":
    from scenarios import run_as_command

    run_as_command("city")
