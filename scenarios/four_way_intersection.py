"""Four-way intersections with sidewalks and crossings on every arm, under any control."""

from __future__ import annotations

import functools
from typing import Final, Unpack

from scenarios.demand import PopulationOptions, make_scenario, parse_flow
from scenarios.networks.geometries import ARM_M, ARMS, LIMIT_MPS, four_way_sources
from sim.scenario import RouteFlow, Scenario

SIGNALISED_FLOWS: Final[dict[str, float]] = {"light": 600.0, "medium": 1200.0, "dense": 1800.0}
"""Vehicles per hour over all arms of each named flow, with signals and 2 lanes (free, interacting,
near capacity)."""

OTHER_FLOWS: Final[dict[str, float]] = {"light": 250.0, "medium": 500.0, "dense": 750.0}
"""The same without signals and with 1 lane."""

TURNS: Final[dict[int, float]] = {1: 0.2, 2: 0.6, 3: 0.2}
"""Share of vehicles by how many places clockwise from their own arm they leave: left, straight,
right."""

INTERSECTION_PEDESTRIANS_PER_H: Final = 240.0
"""Pedestrians per hour over all arms."""


def four_way_intersection(
    *,
    flow: str | float = "medium",
    pedestrians_per_h: float = INTERSECTION_PEDESTRIANS_PER_H,
    control: str = "traffic_light",
    lanes: int | None = None,
    arm_m: float = ARM_M,
    limit_mps: float = LIMIT_MPS,
    **population: Unpack[PopulationOptions],
) -> Scenario:
    """Four arms of 250 m at 50 km/h; by default with fixed-time signals.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all arms.
        pedestrians_per_h: pedestrians per hour over all arms.
        control: ``traffic_light``, ``priority`` (of the east-west road), ``allway_stop`` or
            ``right_before_left``.
        lanes: lanes per direction, 1 to 5; by default 2 with signals and 1 without.
        arm_m: length of each arm, m.
        limit_mps: speed limit, m/s.
        population: see `scenarios.demand.PopulationOptions`.

    Raises:
        InputError: if an option is out of range; the message names it.

    Examples:
        >>> len(four_way_intersection().road.signal_groups)
        4
        >>> four_way_intersection(control="priority").road.signal_groups
        ()
    """
    signalised = control == "traffic_light"
    lanes = (2 if signalised else 1) if lanes is None else lanes
    sources = four_way_sources(control, lanes, arm_m, limit_mps)
    vehicles = parse_flow(flow, SIGNALISED_FLOWS if signalised else OTHER_FLOWS) / len(ARMS)
    walkers = parse_flow(pedestrians_per_h, {}, "pedestrians_per_h") / (len(ARMS) * len(TURNS))
    arms = list(ARMS)
    flows = []
    for i, arm in enumerate(arms):
        for places, share in TURNS.items():
            route = (f"{arm}_in", f"{arms[(i - places) % len(arms)]}_out")
            flows.append(RouteFlow(route, vehicles * share))
            flows.append(RouteFlow(route, walkers, walking=True))
    return make_scenario("four_way_intersection", sources, flows, population)


priority_intersection: Final = functools.partial(four_way_intersection, control="priority")
"""The east-west road has priority."""

all_way_stop: Final = functools.partial(four_way_intersection, control="allway_stop")
"""All vehicles stop."""

right_before_left: Final = functools.partial(four_way_intersection, control="right_before_left")
"""Those who come from the right go first."""

if __name__ == "__main__":
    from scenarios import run_as_command

    run_as_command("four_way_intersection")
