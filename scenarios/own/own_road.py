"""The scenario of one's own road: any map, with routes from a file or made from the map."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Unpack

from behaviors.errors import InputError
from scenarios.demand import PopulationOptions, parse_flow, parse_population
from scenarios.networks.convert import edited_net, name_of, open_map
from scenarios.own.flows import flows_of
from scenarios.own.route_file import read_routes
from sim.road.net import read_road
from sim.scenario import RouteFlow, Scenario

LOGGER: Final = logging.getLogger("graphrqi")


def own_road(
    *,
    net: str | Path,
    routes: str | Path | None = None,
    flow: str | float | None = None,
    demand: Mapping[str, float] | None = None,
    flows: Sequence[RouteFlow] | None = None,
    signals: bool = True,
    limit_mps: float | None = None,
    left_hand: bool | None = None,
    **population: Unpack[PopulationOptions],
) -> Scenario:
    """Any road: a SUMO net, or a map that netconvert turns into one.

    Args:
        net: the map: a SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2.
        routes: a SUMO route file; None for routes made from the map, as
            `scenarios.own.flows.flows_of` does.
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all routes; None for what
            the route file says, or else ``medium``. Levels need routes made from the map.
        demand: vehicles per hour that enter at each edge, by edge; instead of ``flow``.
        flows: the routes themselves with their flows; instead of ``routes``, ``flow`` and
            ``demand``.
        signals: whether traffic lights work; else priority rules at their junctions.
        limit_mps: greatest speed limit, m/s; None for the map's own.
        left_hand: whether traffic drives on the left, of OpenStreetMap; None for what it says.
        population: see `scenarios.demand.PopulationOptions`.

    Returns:
        The scenario, named after the map.

    Raises:
        InputError: if a file is broken, an option is out of range, or no route exists; one line
            that names it.
    """
    given = [name for name, value in (("routes", routes), ("demand", demand), ("flows", flows))
             if value is not None]  # fmt: skip
    if len(given) > 1 or (given and given[0] != "routes" and flow is not None):
        both = given if len(given) > 1 else [*given, "flow"]
        raise InputError(f"{both[0]}: found {both[1]} beside it, expected one of them")
    found, name = open_map(Path(net), left_hand), name_of(Path(net))
    road = read_road(edited_net(found.net, signals, limit_mps), name)
    for text in found.source.warnings:
        LOGGER.warning("%s: %s", net, text)
    if flows is None and routes is None:
        flows = flows_of(road, "medium" if flow is None else flow, demand)
    elif flows is None:
        flows = read_routes(Path(str(routes)), road)
        if flow is not None:
            vehicles, total = parse_flow(flow, {}), sum(one.per_hour for one in flows)
            if not total > 0:
                raise InputError("flow: found routes without vehicles, expected some to share it")
            flows = [
                dataclasses.replace(one, per_hour=one.per_hour * vehicles / total) for one in flows
            ]
    return Scenario(name, road, tuple(flows), **parse_population(population))
