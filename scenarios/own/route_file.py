"""Demand from a SUMO route file: how often each route of the file is driven.

Only the routes and their vehicles per hour are taken from a file; departures and vehicles are
drawn as for every scenario. Vehicle types and walks are left out.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from behaviors.errors import InputError, in_file
from scenarios.own.flows import EdgeGraph, Route
from sim.road import Road
from sim.scenario import MAX_DURATION_S, RouteFlow
from sim.xml_tree import read_tree

LEAST_SPAN_S: Final = 60.0
"""Single vehicles count as departing over at least this time, s, so that one vehicle does not
become a large flow."""


def read_routes(path: Path, road: Road) -> list[RouteFlow]:
    """A flow for each route of a SUMO route file (``.rou.xml``, or trips), in the file's order.

    Raises:
        InputError: if the file is broken, names an edge or a route that is not there, joins edges
            that no way joins, or has no vehicle.
    """
    root, graph = read_tree(path), EdgeGraph(road)
    found: dict[Route, float] = defaultdict(float)
    single: dict[Route, float] = defaultdict(float)
    departs_s = []
    with in_file(path):
        if root.tag not in ("routes", "trips"):
            raise InputError(f"found <{root.tag:.40}>, expected <routes>")
        named = {
            one.attrib["id"]: _edges(one, graph) for one in root.iter("route") if one.get("id")
        }
        choices = {one.get("id", ""): one for one in root.iter("routeDistribution")}
        for element in root:
            if element.tag in ("vehicle", "trip"):
                departs_s.append(_number(element, "depart", 0.0))
            elif element.tag != "flow":
                continue
            for way, share in _ways(element, graph, named, choices):
                if element.tag == "flow":
                    found[way] += share * _rate(element)
                else:
                    single[way] += share
        for way, count in single.items():
            found[way] += count * 3600.0 / max(max(departs_s) - min(departs_s), LEAST_SPAN_S)
        if not found:
            raise InputError("found no vehicle, trip or flow, expected at least one")
    return [RouteFlow(way, rate) for way, rate in found.items()]


def _ways(
    element: ET.Element, graph: EdgeGraph, named: dict[str, Route], choices: dict[str, ET.Element]
) -> Iterator[tuple[Route, float]]:
    """The routes of a vehicle or flow, with the share of each."""
    name, inside = element.get("route"), element.find("route")
    several = choices.get(name) if name else element.find("routeDistribution")
    if name in named:
        yield named[name], 1.0
    elif several is not None:
        routes = list(several.iter("route"))
        shares = [_number(one, "probability", 1.0) for one in routes]
        if not sum(shares) > 0:
            raise InputError(f"{_what(element)}: found no route with a probability, expected one")
        for one, share in zip(routes, shares, strict=True):
            way = named.get(one.get("refId", "")) or _edges(one, graph)
            yield way, share / sum(shares)
    elif name is not None:
        raise InputError(f"{_what(element)}: found route {name!r:.60}, expected one of the file")
    else:
        yield (_way_over(element, graph) if inside is None else _edges(inside, graph)), 1.0


def _way_over(trip: ET.Element, graph: EdgeGraph) -> Route:
    """The quickest way over the edges that a trip names."""
    begin, end = trip.get("from"), trip.get("to")
    if begin is None or end is None:
        raise InputError(f"{_what(trip)}: found no route, expected one or from and to")
    stops = [begin, *(trip.get("via") or "").split(), end]
    _check(_what(trip), stops, graph)
    way: Route = (begin,)
    for one, then in itertools.pairwise(stops):
        if one != then:
            leg = graph.ways_from(one, [then]).get(then)
            if leg is None:
                raise InputError(f"{_what(trip)}: found no way from {one!r:.60} to {then!r:.60}")
            way += leg[1:]
    return way


def _edges(route: ET.Element, graph: EdgeGraph) -> Route:
    """The edges of a route, each joined to the next."""
    edges = tuple((route.get("edges") or "").split())
    what = _what(route) if route.get("id") else "route"
    if not edges:
        raise InputError(f"{what}: found no edges, expected at least one")
    _check(what, edges, graph)
    for one, then in itertools.pairwise(edges):
        if (one, then) not in graph.links:
            raise InputError(f"{what}: found no way from {one!r:.60} to {then!r:.60}, expected one")
    return edges


def _check(what: str, edges: list[str] | Route, graph: EdgeGraph) -> None:
    """Refuse edges that the road does not have."""
    for edge in edges:
        if edge not in graph.lanes:
            raise InputError(
                f"{what}: found edge {edge!r:.60}, expected an edge for cars of road "
                f"{graph.road.name!r:.60}"
            )


def _what(element: ET.Element) -> str:
    return f"{element.tag} {element.get('id')!r:.60}"


def _rate(flow: ET.Element) -> float:
    """Vehicles per hour of a flow, by any of SUMO's attributes."""
    for name in ("vehsPerHour", "perHour"):
        if flow.get(name) is not None:
            return _number(flow, name, 0.0)
    period = flow.get("period") or ""
    if period.startswith("exp(") and period.endswith(")"):
        return 3600.0 * _real(flow, "period", period[4:-1])
    if period:
        seconds = _real(flow, "period", period)
        if seconds <= 0:
            raise InputError(f"{_what(flow)} period: found {seconds:g}, expected s > 0")
        return 3600.0 / seconds
    if flow.get("probability") is not None:
        return 3600.0 * _number(flow, "probability", 0.0)
    if flow.get("number") is not None:
        span_s = _number(flow, "end", 3600.0) - _number(flow, "begin", 0.0)
        return 3600.0 * _number(flow, "number", 0.0) / max(span_s, LEAST_SPAN_S)
    raise InputError(
        f"{_what(flow)}: found no rate, expected vehsPerHour, period, probability or number"
    )


def _number(element: ET.Element, name: str, default: float) -> float:
    """A number in an attribute; vehicles that are triggered depart at the default."""
    text = element.get(name)
    if text is None or (name == "depart" and text == "triggered"):
        return default
    return _real(element, name, text)


def _real(element: ET.Element, name: str, text: str) -> float:
    """A number >= 0; SUMO's times are seconds, or hours:minutes:seconds."""
    try:
        parts = [float(part) for part in reversed(text.split(":"))]
        value = math.fsum(part * 60.0**k for k, part in enumerate(parts))
    except (ValueError, OverflowError):
        value = math.nan
    if not 0 <= value <= 100 * MAX_DURATION_S:
        raise InputError(f"{_what(element)} {name}: found {text!r:.40}, expected a number >= 0")
    return value
