"""A look at a map before driving on it: what it holds, what netconvert warns of, and a picture."""

from __future__ import annotations

import html
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from scenarios.networks.convert import KINDS, drivable_net, kind_of, name_of, warnings_of
from scenarios.own.demand import EdgeGraph, capacity_per_h, routes_of
from sim.road import MapKnowledge, Road
from sim.road.files import read_road_file
from sim.road.net import read_road

MARGIN_M: Final = 10.0
"""White round a picture, m."""

COLORS: Final[dict[str, str]] = {
    "lane": "#5b6470", "path": "#a9b1bb", "walk": "#d9d4c7", "crossing": "#e8c468",
    "source": "#2f7d4f", "sink": "#2c5f9e",
}  # fmt: skip
"""What each colour of a picture stands for."""


@dataclass(frozen=True)
class Survey:
    """What is known of a map.

    Attributes:
        name: what it is called.
        kind: a key of `scenarios.networks.convert.KINDS`.
        net: the SUMO net that both engines drive on.
        road: read from it.
        knows: which facts the map provides.
        warnings: what netconvert warned of, and edges that nobody can come to or leave.
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
        """What was found, what is lacking and every warning, as rows of ``what`` and ``value``."""
        road, graph = self.road, self.graph
        cars = [lane for lanes in graph.lanes.values() for lane in lanes]
        limits = [lane.speed_limit_mps for lane in cars]
        found: dict[str, str | int | float] = {
            "map": KINDS[self.kind],
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
        sources, sinks = set(self.graph.sources), set(self.graph.sinks)
        x0, y0, x1, y1 = self.road.bounds
        wide, high = x1 - x0 + 2 * MARGIN_M, y1 - y0 + 2 * MARGIN_M
        lines = []
        for lane in sorted(self.road.lanes, key=lambda one: not one.internal):
            what = "walk" if lane.walking else "path" if lane.internal else "lane"
            if not lane.walking and lane.edge in sources | sinks:
                what = "source" if lane.edge in sources else "sink"
            lines.append(_line(lane.centerline, 0.85 * lane.width_m, COLORS[what]))
        lines += [_line(c.centerline, c.width_m, COLORS["crossing"]) for c in self.road.crossings]
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x0 - MARGIN_M:.1f} '
                f'{-y1 - MARGIN_M:.1f} {wide:.1f} {high:.1f}" width="1000" '
                f'height="{max(1000 * high / wide, 80):.0f}" style="background: white">',
                f"<title>{html.escape(self.name)}</title>",
                *lines,
                "</svg>\n",
            ]
        )


def _line(points: np.ndarray, width_m: float, color: str) -> str:
    at = " ".join(f"{x:.2f},{-y:.2f}" for x, y in points)
    return f'<polyline fill="none" stroke="{color}" stroke-width="{width_m:.2f}" points="{at}"/>'


def survey(path: Path) -> Survey:
    """Look at a map.

    Args:
        path: a SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2 map.

    Raises:
        InputError: if it is no map, or no road can be made of it; one line says why.
    """
    kind, net = kind_of(path), drivable_net(path)
    road = read_road(net, name_of(path))
    if kind in ("sumo", "openstreetmap", "opendrive"):
        knows = MapKnowledge(signals=bool(road.signal_groups))
    else:
        knows = read_road_file(path).knows
    warnings = (*warnings_of(path), *_unreachable(EdgeGraph(road)))
    return Survey(name_of(path), kind, net, road, knows, warnings)


def _unreachable(graph: EdgeGraph) -> list[str]:
    """Edges that no way from an entry leads to, and edges from which no way leads out."""
    backward: dict[str, list[str]] = {edge: [] for edge in graph.lanes}
    for edge, ways in graph.onward.items():
        for then in ways:
            backward[then].append(edge)
    found = []
    for begin, ways, text in (
        (graph.entries, graph.onward, "found no way to it from any entry"),
        (graph.exits, backward, "found no way from it out of the road"),
    ):
        left = sorted(graph.lanes.keys() - _reached(begin, ways)) if begin else []
        found += [f"edge {edge}: {text}" for edge in left]
    return found


def _reached(begin: Collection[str], onward: Mapping[str, Sequence[str]]) -> set[str]:
    """Everything that can be reached from some edges, these included."""
    found, queue = set(begin), list(begin)
    while queue:
        new = set(onward[queue.pop()]) - found
        found |= new
        queue += new
    return found
