"""Demand from a SUMO route file: how often each route of the file is driven.

Departures and vehicles are drawn anew, as for every scenario: of a file counts only which routes
there are and how many vehicles an hour each of them has. Vehicle types and walks are left out.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from scenarios.own.demand import EdgeGraph
from sim.road import Road
from sim.scenario import MAX_DURATION_S, RouteFlow
from sim.xml_tree import read_tree

LEAST_SPAN_S: Final = 60.0
"""Single vehicles count as departing over at least this time, s (so that a file with one vehicle is
no flow of thousands an hour)."""


def read_routes(path: Path, road: Road) -> list[RouteFlow]:
    """The demand of a SUMO route file (``.rou.xml``, or trips).

    Args:
        path: the file.
        road: where its routes lead.

    Returns:
        A flow for each route, in the order of the file.

    Raises:
        InputError: if the file is broken, names an edge or a route that is not there, joins edges
            that no way joins, or has no vehicle.
    """
    root = read_tree(path)
    if root.tag not in ("routes", "trips"):
        raise InputError(f"{path}: found <{root.tag:.40}>, expected <routes>")
    graph = EdgeGraph(road)
    named = {
        str(one.get("id")): _edges(path, one, graph) for one in root.iter("route") if one.get("id")
    }
    chosen = {str(one.get("id")): one for one in root.iter("routeDistribution") if one.get("id")}
    per_hour: dict[tuple[str, ...], float] = {}
    single: list[tuple[tuple[str, ...], float]] = []
    for element in root:
        if element.tag not in ("vehicle", "trip", "flow"):
            continue
        for way, share in _ways(path, element, graph, named, chosen):
            if element.tag == "flow":
                per_hour[way] = per_hour.get(way, 0.0) + share * _rate(path, element)
            else:
                single.append((way, share))
    if single:
        times = [_number(path, e, "depart", 0.0) for e in root if e.tag in ("vehicle", "trip")]
        span_s = max(max(times) - min(times), LEAST_SPAN_S)
        for way, share in single:
            per_hour[way] = per_hour.get(way, 0.0) + share * 3600.0 / span_s
    if not per_hour:
        raise InputError(f"{path}: found no vehicle, trip or flow, expected at least one")
    return [RouteFlow(way, rate) for way, rate in per_hour.items()]


def _ways(
    path: Path,
    element: ET.Element,
    graph: EdgeGraph,
    named: Mapping[str, tuple[str, ...]],
    chosen: Mapping[str, ET.Element],
) -> Iterable[tuple[tuple[str, ...], float]]:
    """The routes of a vehicle or flow, with the share of each."""
    what = _what(element)
    name = element.get("route")
    inside = element.find("route")
    several = chosen.get(str(name)) if name else element.find("routeDistribution")
    if name in named:
        yield named[str(name)], 1.0
    elif several is not None:
        parts = [
            (
                named[str(one.get("refId"))]
                if one.get("refId") in named
                else _edges(path, one, graph),
                _number(path, one, "probability", 1.0),
            )
            for one in several.iter("route")
        ]
        total = sum(share for _, share in parts)
        if not total > 0:
            raise InputError(f"{path}: {what}: found no route with a probability, expected one")
        for way, share in parts:
            yield way, share / total
    elif name is not None:
        raise InputError(f"{path}: {what}: found route {name!r:.60}, expected one of the file")
    elif inside is not None:
        yield _edges(path, inside, graph), 1.0
    else:
        via = (element.get("via") or "").split()
        stops = [element.get("from"), *via, element.get("to")]
        if stops[0] is None or stops[-1] is None:
            raise InputError(f"{path}: {what}: found no route, expected one or from and to")
        yield _way_over(path, what, [str(stop) for stop in stops], graph), 1.0


def _what(element: ET.Element) -> str:
    return f"{element.tag} {element.get('id')!r:.60}"


def _way_over(path: Path, what: str, stops: list[str], graph: EdgeGraph) -> tuple[str, ...]:
    """The quickest way over some edges."""
    _check_edges(path, what, stops, graph)
    way: tuple[str, ...] = (stops[0],)
    for one, then in itertools.pairwise(stops):
        if one == then:
            continue
        leg = graph.ways_from(one, [then]).get(then)
        if leg is None:
            raise InputError(f"{path}: {what}: found no way from {one!r:.60} to {then!r:.60}")
        way += leg[1:]
    return way


def _edges(path: Path, element: ET.Element, graph: EdgeGraph) -> tuple[str, ...]:
    """The edges of a route, each joined to the next."""
    edges = tuple((element.get("edges") or "").split())
    what = _what(element) if element.get("id") else "route"
    if not edges:
        raise InputError(f"{path}: {what}: found no edges, expected at least one")
    _check_edges(path, what, edges, graph)
    for one, then in itertools.pairwise(edges):
        if (one, then) not in graph.links:
            raise InputError(
                f"{path}: {what}: found no way from {one!r:.60} to {then!r:.60}, expected one"
            )
    return edges


def _check_edges(path: Path, what: str, edges: Iterable[str], graph: EdgeGraph) -> None:
    for edge in edges:
        if edge not in graph.lanes:
            raise InputError(
                f"{path}: {what}: found edge {edge!r:.60}, expected an edge for cars of road "
                f"{graph.road.name!r:.60}"
            )


def _rate(path: Path, flow: ET.Element) -> float:
    """Vehicles per hour of a flow, however it says so."""
    for name in ("vehsPerHour", "perHour"):
        if flow.get(name) is not None:
            return _number(path, flow, name, 0.0)
    period = flow.get("period") or ""
    if period.startswith("exp(") and period.endswith(")"):
        return 3600.0 * _real(path, flow, "period", period[4:-1])
    if period:
        seconds = _number(path, flow, "period", 1.0)
        if seconds <= 0:
            raise InputError(f"{path}: {_what(flow)} period: found {seconds:g}, expected s > 0")
        return 3600.0 / seconds
    if flow.get("probability") is not None:
        return 3600.0 * _number(path, flow, "probability", 0.0)
    if flow.get("number") is not None:
        begin, end = (_number(path, flow, n, d) for n, d in (("begin", 0.0), ("end", 3600.0)))
        return 3600.0 * _number(path, flow, "number", 0.0) / max(end - begin, LEAST_SPAN_S)
    raise InputError(
        f"{path}: {_what(flow)}: found no rate, expected vehsPerHour, period, probability or number"
    )


def _number(path: Path, element: ET.Element, name: str, default: float) -> float:
    text = element.get(name)
    if text is None or (name == "depart" and text == "triggered"):
        return default
    return _real(path, element, name, text)


def _real(path: Path, element: ET.Element, name: str, text: str) -> float:
    parts = text.split(":")  # SUMO's times are seconds, or hours:minutes:seconds
    try:
        value = math.fsum(float(part) * 60.0**k for k, part in enumerate(reversed(parts)))
    except (ValueError, OverflowError):
        value = math.nan
    if not 0 <= value <= 100 * MAX_DURATION_S:
        raise InputError(
            f"{path}: {_what(element)} {name}: found {text!r:.40}, expected a number >= 0"
        )
    return value
