"""Demand on a road of one's own: made from the road, or read from a SUMO route file.

Vehicles enter at edges without a predecessor and leave at edges without a successor; turnarounds
are not counted. On a road without such edges, a ring say, or with few of them for its size, every
edge is both. Each pair of edges that a way joins gets a share of the traffic by the lanes of both,
on the way that takes the least time. The busiest lane is loaded to a share of its capacity.

Only the routes and their vehicles per hour are taken from a file. Departures and vehicles are drawn
as for every scenario; vehicle types and walks are left out.
"""

from __future__ import annotations

import heapq
import itertools
import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError, in_file
from scenarios.demand import parse_flow
from sim.input_files import read_tree
from sim.road import Connection, Lane, Road
from sim.scenario import MAX_DURATION_S, MAX_PER_HOUR, RouteFlow

LEVELS: Final[dict[str, float]] = {"light": 0.15, "medium": 0.3, "dense": 0.5}
"""Share of its capacity that the busiest lane carries in each named flow (free, interacting, and as
much as junctions of any shape still pass on both engines)."""

LANE_CAPACITY_PER_H: Final = 1800.0
"""Vehicles per hour that a lane passes where nothing stops them (a headway of 2 s; Highway Capacity
Manual: 1700 to 2400)."""

SIGNAL_SHARE: Final = 0.4
"""Share of the time that a lane at a signal is let go (24 of 60 s)."""

YIELDING_SHARE: Final = 0.35
"""Capacity of a yielding lane over that of a free one (after the capacity of minor roads at
moderate traffic)."""

MOST_ROUTES: Final = 600
"""Most routes of a demand; if there are more pairs, this many are drawn by their weight."""

MOST_EDGES: Final = 120
"""Most edges at which vehicles enter, and most at which they leave; the widest are taken."""

SLOWEST_MPS: Final = 0.5
"""Lanes with a lower limit are on no route."""

TURN_S: Final = 3.0
"""Cost of a turn beside its length, s (routes go straight on where they can)."""

SHORTEST_ENTRY_M: Final = 15.0
"""Vehicles enter and leave at edges at least this long, where there are any (a bus fits)."""

MOST_LANE_M: Final = 2000.0
"""With more metres of lane for each entry, or for each exit, vehicles begin and end inside, too (at
medium traffic a kilometre of lane holds some ten)."""

LEAST_SPAN_S: Final = 60.0
"""Single vehicles count as departing over at least this time, s, so that one is no large flow."""

Route = tuple[str, ...]


class EdgeGraph:
    """The edges of a road on which cars may drive, and the ways between them.

    Attributes:
        road: where it came from.
        lanes: the lanes for cars of each edge, from right to left.
        links: the connections between the lanes of two edges, by both edges.
        onward: the edges after each edge, without the way back.
        travel_s: time to drive over each edge at its limit, s.
        entries: the edges that no other edge leads to.
        exits: the edges that lead to no other.
        sources: edges at which vehicles enter.
        sinks: edges at which vehicles leave.
    """

    def __init__(self, road: Road) -> None:
        self.road = road
        lanes = defaultdict[str, list[Lane]](list)
        for lane in road.lanes:
            usable = not lane.speed_limit_mps < SLOWEST_MPS  # unknown limits are not low
            if lane.cars and not lane.walking and not lane.internal and usable:
                lanes[lane.edge].append(lane)
        self.lanes = {edge: sorted(some, key=lambda one: one.index) for edge, some in lanes.items()}
        edge_of = {lane.id: edge for edge, some in lanes.items() for lane in some}
        self.links: dict[tuple[str, str], list[Connection]] = {}
        for link in road.connections:
            if link.from_lane in edge_of and link.to_lane in edge_of:
                between = (edge_of[link.from_lane], edge_of[link.to_lane])
                self.links.setdefault(between, []).append(link)
        self.onward: dict[str, list[str]] = {edge: [] for edge in lanes}
        for (one, then), links in self.links.items():
            if any(link.direction != "turnaround" for link in links):
                self.onward[one].append(then)
        self.travel_s: dict[str, float] = {}
        for edge, some in self.lanes.items():
            limits = [one.speed_limit_mps for one in some if math.isfinite(one.speed_limit_mps)]
            self.travel_s[edge] = some[0].length_m / max([SLOWEST_MPS, *limits])
        entered = {then for ways in self.onward.values() for then in ways}
        self.entries = [edge for edge in self.lanes if edge not in entered]
        self.exits = [edge for edge, ways in self.onward.items() if not ways]
        self.sources, self.sinks = self._chosen(self.entries), self._chosen(self.exits)

    def _chosen(self, fringe: list[str]) -> tuple[str, ...]:
        """The long and wide edges of the fringe, or of all edges where there is little of it."""
        total_m = sum(one.length_m for lanes in self.lanes.values() for one in lanes)
        edges = fringe if total_m <= MOST_LANE_M * len(fringe) else list(self.lanes)
        edges = [e for e in edges if self.lanes[e][0].length_m >= SHORTEST_ENTRY_M] or edges
        return tuple(sorted(sorted(edges, key=lambda e: (-len(self.lanes[e]), e))[:MOST_EDGES]))

    def ways_from(self, start: str, ends: Collection[str]) -> dict[str, Route]:
        """The quickest ways from an edge to those of some others that it reaches, by the other.

        Ways back are left out (Dijkstra 1959).
        """
        best: dict[str, float] = {start: self.travel_s[start]}
        before: dict[str, str] = {}
        queue = [(best[start], start)]
        while queue:
            cost, edge = heapq.heappop(queue)
            if cost > best[edge]:
                continue
            for then in self.onward[edge]:
                straight = any(link.direction == "straight" for link in self.links[edge, then])
                new = cost + self.travel_s[then] + (0.0 if straight else TURN_S)
                if new < best.get(then, math.inf):
                    best[then], before[then] = new, edge
                    heapq.heappush(queue, (new, then))
        found = {}
        for end in ends:
            way = [end]
            while way[-1] != start and way[-1] in before:
                way.append(before[way[-1]])
            if len(way) > 1:
                found[end] = tuple(reversed(way))
        return found

    def ways_out(self, start: str) -> dict[Route, int]:
        """The ways from an edge out of the road, and the lanes at the end of each."""
        ways = self.ways_from(start, self.sinks)
        if start in self.sinks and not (ways and self.onward[start]):
            ways[start] = (start,)
        return {ways[end]: len(self.lanes[end]) for end in sorted(ways)}

    def require(self, edges: Sequence[str], what: str) -> None:
        """Refuse edges that the road does not have."""
        for edge in edges:
            if edge not in self.lanes:
                raise InputError(
                    f"{what}: found edge {edge!r:.60}, expected an edge for cars of road "
                    f"{self.road.name!r:.60}"
                )

    def routes(self) -> dict[Route, float]:
        """The routes of the road and the share of the traffic on each; `MOST_ROUTES` at most."""
        found: dict[Route, float] = {}
        for start in self.sources:
            ways = self.ways_out(start)
            total = sum(ways.values())
            found |= {way: len(self.lanes[start]) * n / total for way, n in ways.items()}
        routes, weights = list(found), np.array(list(found.values()))
        weights = weights / weights.sum()
        if len(routes) > MOST_ROUTES:
            # Gumbel's trick: the largest keys are a draw without replacement
            keys = np.log(weights) + np.random.default_rng(0).gumbel(size=weights.size)
            kept = np.sort(np.argsort(-keys, kind="stable")[:MOST_ROUTES])
            routes, weights = [routes[i] for i in kept], np.full(kept.size, 1.0 / kept.size)
        return dict(zip(routes, weights.tolist(), strict=True))

    def capacity_per_h(self, routes: Mapping[Route, float]) -> float:
        """Vehicles per hour over routes, with their shares, that make the busiest lane full.

        Junctions count by what they pass: the loads of ways that keep each other waiting add up.
        """
        load = defaultdict[tuple[str, str | None], float](float)
        for way, share in routes.items():
            for one, then in itertools.zip_longest(way, way[1:]):
                load[one, then] += share
        of_edge, busiest = defaultdict[str, float](float), 0.0
        for (one, then), share in load.items():
            of_edge[one] += share
            whole = LANE_CAPACITY_PER_H * len(self.lanes[one])
            passed = whole if then is None else self._passed_per_h(one, then)
            busiest = max(busiest, share / passed, of_edge[one] / whole)
        return min(1.0 / busiest, MAX_PER_HOUR)

    def _passed_per_h(self, one: str, then: str) -> float:
        """Vehicles per hour that the lanes from an edge to the next one pass."""
        shares: dict[str, float] = {}
        for link in self.links[one, then]:
            passed = SIGNAL_SHARE if link.signal >= 0 else 1.0
            passed *= YIELDING_SHARE if link.must_yield or link.must_stop else 1.0
            shares[link.from_lane] = max(shares.get(link.from_lane, 0.0), passed)
        return LANE_CAPACITY_PER_H * sum(shares.values())


def flows_of(road: Road, flow: str | float, demand: Mapping[str, float] | None) -> list[RouteFlow]:
    """A flow for each route of a road.

    The flow is a key of ``LEVELS``, or vehicles per hour over all routes. Instead of it, the demand
    gives vehicles per hour that enter at each edge.
    """
    graph = EdgeGraph(road)
    if demand is None:
        routes = graph.routes()
        if not routes:
            raise InputError(
                f"road {road.name!r:.60}: found no edge from which another one can be reached, "
                "expected at least one"
            )
        capacity = graph.capacity_per_h(routes)
        vehicles = parse_flow(flow, {name: share * capacity for name, share in LEVELS.items()})
        return [RouteFlow(way, vehicles * share) for way, share in routes.items()]
    flows = []
    graph.require(list(demand), "demand")
    for start, per_hour in demand.items():
        ways = graph.ways_out(start)
        if not ways:
            raise InputError(f"demand: found edge {start!r:.60}, from which no way leads out")
        total = sum(ways.values())
        flows += [RouteFlow(way, per_hour * lanes / total) for way, lanes in ways.items()]
    return flows


def read_routes(path: Path, road: Road) -> list[RouteFlow]:
    """A flow for each route of a SUMO route file (``.rou.xml``, or trips), in the file's order."""
    root, graph = read_tree(path), EdgeGraph(road)
    found, single = defaultdict[Route, float](float), defaultdict[Route, float](float)
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
                departs_s.append(_number(element, "depart"))
                rates, per_hour = single, 1.0
            elif element.tag == "flow":
                rates, per_hour = found, _per_hour(element)
            else:
                continue
            for way, share in _ways(element, graph, named, choices):
                rates[way] += share * per_hour
        span_s = max(max(departs_s, default=0.0) - min(departs_s, default=0.0), LEAST_SPAN_S)
        for way, count in single.items():
            found[way] += count * 3600.0 / span_s
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
            yield named.get(one.get("refId", "")) or _edges(one, graph), share / sum(shares)
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
    graph.require(stops, _what(trip))
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
    edges, what = tuple((route.get("edges") or "").split()), _what(route)
    if not edges:
        raise InputError(f"{what}: found no edges, expected at least one")
    graph.require(edges, what)
    for one, then in itertools.pairwise(edges):
        if (one, then) not in graph.links:
            raise InputError(f"{what}: found no way from {one!r:.60} to {then!r:.60}, expected one")
    return edges


def _what(element: ET.Element) -> str:
    return f"{element.tag} {element.get('id')!r:.60}" if element.get("id") else element.tag


def _per_hour(flow: ET.Element) -> float:
    """Vehicles per hour of a flow, by any of SUMO's attributes."""
    for name, factor in (("vehsPerHour", 1.0), ("perHour", 1.0), ("probability", 3600.0)):
        if flow.get(name) is not None:
            return factor * _number(flow, name)
    period = flow.get("period") or ""
    if period.startswith("exp("):  # exp(rate per second): exponential gaps
        return 3600.0 * _number(flow, "period", text=period[4:].removesuffix(")"))
    if period:
        return 3600.0 / max(_number(flow, "period"), 1e-9)
    if flow.get("number") is not None:
        span_s = _number(flow, "end", 3600.0) - _number(flow, "begin")
        return 3600.0 * _number(flow, "number") / max(span_s, LEAST_SPAN_S)
    raise InputError(
        f"{_what(flow)}: found no rate, expected vehsPerHour, period, probability or number"
    )


def _number(element: ET.Element, name: str, default: float = 0.0, text: str | None = None) -> float:
    """A number >= 0 in an attribute, or in a part of it; times may be hours:minutes:seconds."""
    text = text or element.get(name)
    if text is None or text == "triggered":
        return default
    try:
        parts = [float(part) for part in reversed(text.split(":"))]
        value = math.fsum(part * 60.0**k for k, part in enumerate(parts))
    except (ValueError, OverflowError):
        value = math.nan
    if not 0 <= value <= 100 * MAX_DURATION_S:
        raise InputError(f"{_what(element)} {name}: found {text!r:.40}, expected a number >= 0")
    return value
