"""A look at a map before driving on it: what it holds, what netconvert warns of, and a picture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from scenarios.networks.convert import KINDS, name_of, open_map
from scenarios.own.flows import EdgeGraph
from sim.road import MapKnowledge, Road
from sim.road.net import read_road
from sim.road.road_files import read_road_file

SOURCE, SINK = "#2f7d4f", "#2c5f9e"
"""The colours of the edges at which vehicles enter and leave, in a picture."""


@dataclass(frozen=True)
class Survey:
    """Survey of a map.

    Attributes:
        kind: a key of `scenarios.networks.convert.KINDS`.
        net: the SUMO net that both engines drive on.
        graph: the edges for cars of the road of that net, and the ways between them.
        knows: which facts the map provides.
        warnings: netconvert's warnings, and edges without an entry or an exit.
    """

    kind: str
    net: Path
    graph: EdgeGraph
    knows: MapKnowledge
    warnings: tuple[str, ...]

    @property
    def road(self) -> Road:
        """The road of the net."""
        return self.graph.road

    def rows(self) -> list[dict[str, str | int | float]]:
        """Findings, gaps and every warning, as rows of ``what`` and ``value``."""
        road, graph, routes = self.road, self.graph, self.graph.routes()
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
            "routes": len(routes),
        }
        if routes:
            found["vehicles per hour that it can carry"] = round(graph.capacity_per_h(routes))
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
    found, doubts = open_map(path, left_hand), tuple[str, ...]()
    graph = EdgeGraph(read_road(found.net, name_of(path)))
    if found.kind in ("sumo", "openstreetmap", "opendrive"):
        knows = MapKnowledge(not found.source.unlimited, bool(graph.road.signal_groups))
    else:
        own = read_road_file(path)
        knows, doubts = own.knows, own.doubts
    back: dict[str, list[str]] = {edge: [] for edge in graph.onward}
    for one, ways in graph.onward.items():
        for then in ways:
            back[then].append(one)
    cut_off = [
        f"edge {edge}: found no way {how}"
        for ways, fringe, how in (
            (graph.onward, graph.entries, "to it from any entry"),
            (back, graph.exits, "from it out of the road"),
        )
        for edge in _unreached(ways, fringe)
    ]
    return Survey(found.kind, found.net, graph, knows, (*doubts, *found.warnings, *cut_off))


def _unreached(ways: Mapping[str, Iterable[str]], fringe: list[str]) -> list[str]:
    """The edges to which no way leads from the fringe, if there is one."""
    reached, queue = set(fringe), list(fringe)
    while queue:
        new = set(ways[queue.pop()]) - reached
        reached |= new
        queue += new
    return sorted(set(ways) - reached) if fringe else []
