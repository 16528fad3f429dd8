"""Straight roads: one-way or two-way, with or without a mid-block crossing."""

from __future__ import annotations

import functools
from typing import Final, Unpack

from scenarios.demand import PopulationOptions, make_scenario, parse_flow
from scenarios.networks.geometries import LIMIT_MPS, TWO_WAY_LENGTH_M, straight_sources
from sim.scenario import RouteFlow, Scenario

FLOWS_PER_LANE: Final[dict[str, float]] = {"light": 300.0, "medium": 700.0, "dense": 1000.0}
"""Vehicles per hour and lane of each named flow on a one-way road (free, interacting, near capacity
with a crossing in use)."""

TWO_WAY_FLOWS_PER_LANE: Final[dict[str, float]] = {"light": 150.0, "medium": 350.0, "dense": 600.0}
"""The same for two-way roads, where overtaking needs gaps in the oncoming traffic."""

PEDESTRIANS_PER_H: Final = 160.0
"""Pedestrians per hour over the crossing (several hundred jam a dense road)."""

CROSSING_ROUTES: Final = (
    ("east_in", "west_out"), ("west_in", "east_out"), ("east_in", "west_in"), ("west_in", "east_in")
)  # fmt: skip
"""The pedestrians' routes on a road with a crossing."""

SIDEWALK_ROUTES: Final = (
    ("east_in", "east_out"), ("west_in", "west_out"), ("east_in",), ("west_in",)
)  # fmt: skip
"""The pedestrians' routes on a road without one, where only jaywalkers cross."""


def straight_road(
    *,
    flow: str | float = "medium",
    pedestrians_per_h: float = PEDESTRIANS_PER_H,
    lanes: int = 3,
    two_way: bool = False,
    crossing: bool = True,
    length_m: float | None = None,
    limit_mps: float = LIMIT_MPS,
    **population: Unpack[PopulationOptions],
) -> Scenario:
    """A straight road with a zebra crossing half-way, by default one-way with 3 lanes.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all lanes.
        pedestrians_per_h: pedestrians per hour; without a crossing, only jaywalkers cross.
        lanes: lanes per direction, 1 to 5.
        two_way: whether there is traffic in the other direction too.
        crossing: whether there is a crossing, with priority for pedestrians.
        length_m: m; by default 800 one-way, 1200 two-way.
        limit_mps: speed limit, m/s.
        population: see `scenarios.demand.PopulationOptions`.

    Raises:
        InputError: if an option is out of range; the message names it.

    Examples:
        >>> straight_road(flow="light", lanes=2).road.name
        'straight_road'
    """
    length_m = (TWO_WAY_LENGTH_M if two_way else 800.0) if length_m is None else length_m
    sources = straight_sources(lanes, two_way, crossing, length_m, limit_mps)
    per_lane = TWO_WAY_FLOWS_PER_LANE if two_way else FLOWS_PER_LANE
    routes = [("east_in", "east_out"), ("west_in", "west_out")][: 2 if two_way else 1]
    levels = {name: lanes * len(routes) * value for name, value in per_lane.items()}
    vehicles = parse_flow(flow, levels) / len(routes)
    walks = CROSSING_ROUTES if crossing else SIDEWALK_ROUTES
    walkers = parse_flow(pedestrians_per_h, {}, "pedestrians_per_h") / len(walks)
    flows = [RouteFlow(route, vehicles) for route in routes]
    flows += [RouteFlow(route, walkers, walking=True) for route in walks]
    return make_scenario("straight_road", sources, flows, population)


two_way_road: Final = functools.partial(straight_road, two_way=True, lanes=1, crossing=False)
"""One lane each way, where overtaking means the oncoming lane."""

if __name__ == "__main__":
    from scenarios import run_as_command

    run_as_command("straight_road")
