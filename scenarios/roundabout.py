"""A roundabout with four arms, where those on the ring go first."""

from __future__ import annotations

import itertools
from typing import Final, Unpack

from scenarios.demand import PopulationOptions, make_scenario, parse_flow
from scenarios.four_way_intersection import TURNS
from scenarios.networks.geometries import ARMS, LIMIT_MPS, roundabout_sources
from sim.scenario import RouteFlow, Scenario

FLOWS: Final[dict[str, float]] = {"light": 400.0, "medium": 800.0, "dense": 1200.0}
"""Vehicles per hour over all arms of each named flow with one lane (free, interacting, and two
thirds of what a small roundabout carries)."""


def roundabout(
    *,
    flow: str | float = "medium",
    lanes: int = 1,
    radius_m: float = 20.0,
    arm_m: float = 200.0,
    limit_mps: float = LIMIT_MPS,
    **population: Unpack[PopulationOptions],
) -> Scenario:
    """Four arms at 50 km/h, round a ring of 20 m radius with one lane at 30 km/h.

    Args:
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all arms.
        lanes: lanes of each arm per direction and of the ring, 1 or 2.
        radius_m: of the ring, m.
        arm_m: length of each arm, m.
        limit_mps: speed limit of the arms, m/s.
        population: see `scenarios.demand.PopulationOptions`.

    Raises:
        InputError: if an option is out of range; the message names it.

    Examples:
        >>> roundabout().flows[1].route
        ('east_in', 'east_north', 'north_west', 'west_out')
    """
    sources = roundabout_sources(lanes, radius_m, arm_m, limit_mps)
    vehicles = parse_flow(flow, FLOWS) / len(ARMS)
    flows = [
        RouteFlow(_way_round(arm, len(ARMS) - places), vehicles * share)
        for arm in ARMS
        for places, share in TURNS.items()
    ]
    return make_scenario("roundabout", sources, flows, population)


def _way_round(arm: str, places: int) -> tuple[str, ...]:
    """The edges from an arm to the n-th next one, counter-clockwise; 1 for the first exit."""
    arms = list(ARMS)
    begin = arms.index(arm)
    passed = [arms[(begin + k) % len(arms)] for k in range(places + 1)]
    ring = [f"{one}_{then}" for one, then in itertools.pairwise(passed)]
    return (f"{arm}_in", *ring, f"{passed[-1]}_out")


if __name__ == "__main__":
    from scenarios import run_as_command

    run_as_command("roundabout")
