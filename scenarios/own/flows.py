"""Demand made from a road: from every place where it begins to every place that can be reached.

Vehicles enter at edges without a predecessor and leave at edges without a successor; turnarounds
are not counted. On a road without such edges, a ring say, or with few of them for its size, every
edge is both: vehicles begin and end inside, too. Each pair of edges that a way joins gets a share
of the traffic by the lanes of both, on the way that takes the least time. The total traffic loads
the busiest lane to a given share of its capacity.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Collection, Mapping
from typing import Final

import numpy as np

from behaviors.errors import InputError
from scenarios.demand import parse_flow
from sim.road import Connection, Lane, Road
from sim.scenario import MAX_PER_HOUR, RouteFlow

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
        lanes: dict[str, list[Lane]] = {}
        for lane in road.lanes:
            usable = not lane.speed_limit_mps < SLOWEST_MPS  # unknown limits are not low
            if lane.cars and not lane.walking and not lane.internal and usable:
                lanes.setdefault(lane.edge, []).append(lane)
        self.lanes = {edge: sorted(some, key=lambda one: one.index) for edge, some in lanes.items()}
        edge_of = {lane.id: edge for edge, some in lanes.items() for lane in some}
        self.links: dict[tuple[str, str], list[Connection]] = {}
        for link in road.connections:
            if link.from_lane in edge_of and link.to_lane in edge_of:
                between = (edge_of[link.from_lane], edge_of[link.to_lane])
                self.links.setdefault(between, []).append(link)
        self.onward: dict[str, list[str]] = {edge: [] for edge in lanes}
        for (one, then), links in self.links.items():
            if not all(link.direction == "turnaround" for link in links):
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

    def capacity_per_h(self, one: str, then: str | None) -> float:
        """Vehicles per hour that the lanes from an edge to the next one pass."""
        if then is None:
            return LANE_CAPACITY_PER_H * len(self.lanes[one])
        share: dict[str, float] = {}
        for link in self.links[one, then]:
            passed = SIGNAL_SHARE if link.signal >= 0 else 1.0
            passed *= YIELDING_SHARE if link.must_yield or link.must_stop else 1.0
            share[link.from_lane] = max(share.get(link.from_lane, 0.0), passed)
        return LANE_CAPACITY_PER_H * sum(share.values())


def routes_of(graph: EdgeGraph) -> dict[Route, float]:
    """The routes of a road and the share of the traffic on each; `MOST_ROUTES` at most."""
    found: dict[Route, float] = {}
    for start in graph.sources:
        ways = graph.ways_out(start)
        total = sum(ways.values())
        found |= {way: len(graph.lanes[start]) * n / total for way, n in ways.items()}
    if not found:
        raise InputError(
            f"road {graph.road.name!r:.60}: found no edge from which another one can be reached, "
            "expected at least one"
        )
    routes, weights = list(found), np.array(list(found.values()))
    weights = weights / weights.sum()
    if len(routes) > MOST_ROUTES:
        # Gumbel's trick: the largest keys are a draw without replacement
        keys = np.log(weights) + np.random.default_rng(0).gumbel(size=weights.size)
        kept = np.sort(np.argsort(-keys, kind="stable")[:MOST_ROUTES])
        routes, weights = [routes[i] for i in kept], np.full(kept.size, 1.0 / kept.size)
    return dict(zip(routes, weights.tolist(), strict=True))


def capacity_per_h(graph: EdgeGraph, routes: Mapping[Route, float]) -> float:
    """Vehicles per hour over routes, with their shares, that make the busiest lane full.

    Junctions count by what they pass: the loads of ways that keep each other waiting add up.
    """
    load: dict[tuple[str, str | None], float] = {}
    for way, share in routes.items():
        for one, then in itertools.zip_longest(way, way[1:]):
            load[one, then] = load.get((one, then), 0.0) + share
    of_edge: dict[str, float] = {}
    busiest = 0.0
    for (one, then), share in load.items():
        of_edge[one] = of_edge.get(one, 0.0) + share
        needed = share / graph.capacity_per_h(one, then)
        busiest = max(busiest, needed, of_edge[one] / graph.capacity_per_h(one, None))
    return min(1.0 / busiest, MAX_PER_HOUR)


def flows_of(road: Road, flow: str | float, demand: Mapping[str, float] | None) -> list[RouteFlow]:
    """A flow for each route of a road.

    Args:
        road: where.
        flow: a key of ``LEVELS``, or vehicles per hour over all routes.
        demand: vehicles per hour that enter at each edge, instead of ``flow``.
    """
    graph = EdgeGraph(road)
    if demand is None:
        routes = routes_of(graph)
        capacity = capacity_per_h(graph, routes)
        vehicles = parse_flow(flow, {name: share * capacity for name, share in LEVELS.items()})
        return [RouteFlow(way, vehicles * share) for way, share in routes.items()]
    flows = []
    for start, per_hour in demand.items():
        if start not in graph.lanes:
            raise InputError(
                f"demand: found edge {start!r:.60}, expected an edge for cars of road "
                f"{road.name!r:.60}"
            )
        ways = graph.ways_out(start)
        if not ways:
            raise InputError(f"demand: found edge {start!r:.60}, from which no way leads out")
        total = sum(ways.values())
        flows += [RouteFlow(way, per_hour * lanes / total) for way, lanes in ways.items()]
    return flows
