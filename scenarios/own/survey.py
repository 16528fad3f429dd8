"""A look at a map before driving on it: what it holds, what netconvert warns of, and a picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order

from behaviors.errors import InputError
from scenarios.networks.convert import KINDS, drivable_net, name_of, source_of, warnings_of
from scenarios.own.flows import EdgeGraph, capacity_per_h, routes_of
from sim.road import MapKnowledge, Road
from sim.road.files import read_road_file
from sim.road.net import read_road

SOURCE, SINK = "#2f7d4f", "#2c5f9e"
"""The colours of the edges at which vehicles enter and leave, in a picture."""


@dataclass(frozen=True)
class Survey:
    """Survey of a map.

    Attributes:
        name: what it is called.
        kind: a key of `scenarios.networks.convert.KINDS`.
        net: the SUMO net that both engines drive on.
        road: read from it.
        knows: which facts the map provides.
        warnings: netconvert's warnings, and edges without an entry or an exit.
    """

    name: str
    kind: str
    net: Path
    road: Road
    knows: MapKnowledge
    warnings: tuple[str, ...]

    @cached_property
    def graph(self) -> EdgeGraph:
        """The road's edges for cars and the ways between them."""
        return EdgeGraph(self.road)

    def rows(self) -> list[dict[str, str | int | float]]:
        """Findings, gaps and every warning, as rows of ``what`` and ``value``."""
        road, graph = self.road, self.graph
        cars = [lane for lanes in graph.lanes.values() for lane in lanes]
        limits = [lane.speed_limit_mps for lane in cars]
        found: dict[str, str | int | float] = {
            "map": KINDS[self.kind],
            "traffic": "on the left" if road.left_hand else "on the right",
            "edges for cars": len(graph.lanes),
            "lanes for cars": len(cars),
            "length of these lanes, km": round(sum(one.length_m for one in cars) / 1000, 3),
            "limits, m/s": f"{min(limits):.4g} to {max(limits):.4g}" if limits else "none",
            "signal groups": len(road.signal_groups),
            "crossings": len(road.crossings),
            "entries": len(graph.sources),
            "exits": len(graph.sinks),
            "routes": 0,
        }
        try:
            routes = routes_of(graph)
        except InputError:
            pass
        else:
            found["routes"] = len(routes)
            found["vehicles per hour that it can carry"] = round(capacity_per_h(graph, routes))
        found["lacks"] = ", ".join(self.knows.unknown) or "nothing"
        found["warnings"] = len(self.warnings)
        rows = [{"what": what, "value": value} for what, value in found.items()]
        return rows + [{"what": "warning", "value": text} for text in self.warnings]

    def picture(self) -> str:
        """The road as an SVG: lanes, crossings, entries green, exits blue."""
        colors = dict.fromkeys(self.graph.sinks, SINK) | dict.fromkeys(self.graph.sources, SOURCE)
        return self.road.svg(colors)


def survey(path: Path, left_hand: bool | None = None) -> Survey:
    """Look at a map.

    Args:
        path: a SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2 map.
        left_hand: whether traffic drives on the left, of OpenStreetMap; None for what it says.

    Raises:
        InputError: if it is not a map, or no road can be made of it; one line says why.
    """
    kind, source = source_of(path, left_hand)
    net, doubts = drivable_net(path, left_hand), tuple[str, ...]()
    road = read_road(net, name_of(path))
    if kind in ("sumo", "openstreetmap", "opendrive"):
        knows = MapKnowledge(not source.unlimited, bool(road.signal_groups))
    else:
        own = read_road_file(path)
        knows, doubts = own.knows, own.doubts
    warnings = (*doubts, *warnings_of(path, left_hand), *_unreachable(EdgeGraph(road)))
    return Survey(name_of(path), kind, net, road, knows, warnings)


def _unreachable(graph: EdgeGraph) -> list[str]:
    """Edges that no way from an entry leads to, and edges from which no way leads out."""
    number = {edge: i for i, edge in enumerate(graph.lanes)}
    pairs = [(number[one], number[then]) for one, ways in graph.onward.items() for then in ways]
    begin, end = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    size = (len(number), len(number))
    onward = coo_array((np.ones(begin.size), (begin, end)), shape=size).tocsr()
    found = []
    for fringe, ways, text in (
        (graph.entries, onward, "found no way to it from any entry"),
        (graph.exits, onward.T.tocsr(), "found no way from it out of the road"),
    ):
        reached = {i for edge in fringe for i in _reached(ways, number[edge])}
        left = sorted(edge for edge, i in number.items() if i not in reached) if fringe else []
        found += [f"edge {edge}: {text}" for edge in left]
    return found


def _reached(ways: csr_array, begin: int) -> list[int]:
    """Everything that can be reached from an edge, itself included."""
    return breadth_first_order(ways, begin, return_predecessors=False).tolist()
