"""A look at a map before driving on it: what it holds, lacks and has wrong, and a picture."""

from __future__ import annotations

import html
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from scenarios.networks.convert import KINDS, drivable_net, kind_of, name_of
from scenarios.own import source_check
from scenarios.own.check import Defect, defects_of
from scenarios.own.demand import EdgeGraph, capacity_per_h, routes_of
from sim.road import MapKnowledge, Road
from sim.road.files import read_road_file
from sim.road.net import read_road

MARGIN_M: Final = 10.0
"""White round a picture, m."""

COLORS: Final[dict[str, str]] = {
    "lane": "#5b6470", "path": "#a9b1bb", "walk": "#d9d4c7", "crossing": "#e8c468",
    "source": "#2f7d4f", "sink": "#2c5f9e", "defect": "#c0392b",
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
        knows: what the map itself tells.
        defects: what is wrong with it, and with the net made from it.
    """

    name: str
    kind: str
    net: Path
    road: Road
    knows: MapKnowledge
    defects: tuple[Defect, ...]

    @cached_property
    def graph(self) -> EdgeGraph:
        """The road's edges for cars and the ways between them."""
        return EdgeGraph(self.road)

    def rows(self) -> list[dict[str, str | int | float]]:
        """What was found, what is lacking and every defect, as rows of ``what`` and ``value``."""
        road, graph = self.road, self.graph
        cars = [lane for lane in road.lanes if lane.cars and not lane.walking and not lane.internal]
        limits = sorted({round(lane.speed_limit_mps, 2) for lane in cars})
        x0, y0, x1, y1 = road.bounds
        found: list[tuple[str, str | int | float]] = [
            ("map", KINDS[self.kind]),
            ("edges for cars", len(graph.lanes)),
            ("lanes for cars", len(cars)),
            ("length of these lanes, km", round(sum(one.length_m for one in cars) / 1000, 3)),
            ("extent, m", f"{x1 - x0:.0f} x {y1 - y0:.0f}"),
            ("limits, m/s", f"{limits[0]:g} to {limits[-1]:g}" if limits else "none"),
            ("junction paths", sum(lane.internal and not lane.walking for lane in road.lanes)),
            ("connections", len(road.connections)),
            ("signal groups", len(road.signal_groups)),
            ("crossings", len(road.crossings)),
            ("sidewalks", sum(lane.walking and not lane.internal for lane in road.lanes)),
            ("entries", len(graph.sources)),
            ("exits", len(graph.sinks)),
        ]
        try:
            routes = routes_of(graph)
        except InputError:
            found.append(("routes", 0))
        else:
            found += [
                ("routes", len(routes)),
                ("vehicles per hour that it can carry", round(capacity_per_h(graph, routes))),
            ]
        found.append(("lacks", ", ".join(self.knows.unknown) or "nothing"))
        found.append(("defects", len(self.defects)))
        found += [(f"{one.kind}: {one.place}", one.found) for one in self.defects]
        return [{"what": what, "value": value} for what, value in found]

    def picture(self) -> str:
        """The road as an SVG: lanes, crossings, entries green, exits blue, defects red."""
        sources, sinks = set(self.graph.sources), set(self.graph.sinks)
        wrong = {one.place.split(" ", 1)[-1] for one in self.defects}
        x0, y0, x1, y1 = self.road.bounds
        wide, high = x1 - x0 + 2 * MARGIN_M, y1 - y0 + 2 * MARGIN_M
        parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x0 - MARGIN_M:.1f} '
            f'{-y1 - MARGIN_M:.1f} {wide:.1f} {high:.1f}" width="1000" '
            f'height="{max(1000 * high / wide, 80):.0f}">',
            f"<title>{html.escape(self.name)}</title>",
            '<rect x="-1e7" y="-1e7" width="2e7" height="2e7" fill="white"/>',
        ]
        for lane in sorted(self.road.lanes, key=lambda one: not one.internal):
            color = COLORS["walk" if lane.walking else "path" if lane.internal else "lane"]
            if lane.edge in sinks and not lane.walking:
                color = COLORS["sink"]
            if lane.edge in sources and not lane.walking:
                color = COLORS["source"]
            if lane.id in wrong or lane.edge in wrong:
                color = COLORS["defect"]
            parts.append(_line(lane.centerline, 0.85 * lane.width_m, color))
        for crossing in self.road.crossings:
            parts.append(_line(crossing.centerline, crossing.width_m, COLORS["crossing"]))
        return "\n".join([*parts, "</svg>", ""])


def _line(points: np.ndarray, width_m: float, color: str) -> str:
    at = " ".join(f"{x:.2f},{-y:.2f}" for x, y in points)
    return (
        f'<polyline fill="none" stroke="{color}" stroke-width="{width_m:.2f}" '
        f'stroke-linejoin="round" points="{at}"/>'
    )


def survey(path: Path) -> Survey:
    """Look at a map.

    Args:
        path: a SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2 map.

    Raises:
        InputError: if it is no map, or no road can be made of it; one line says why.
    """
    kind, name = kind_of(path), name_of(path)
    found: list[Defect] = []
    if kind == "openstreetmap":
        knows, found = source_check.openstreetmap(path)
    elif kind == "opendrive":
        knows, found = source_check.opendrive(path)
    elif kind == "sumo":
        knows = MapKnowledge()
    else:
        own = read_road_file(path)
        knows, found = own.knows, defects_of(own)
    net = drivable_net(path)
    road = read_road(net, name)
    if kind == "sumo":
        knows = MapKnowledge(signals=bool(road.signal_groups))
    told = {(one.kind, one.place) for one in found}
    found += [one for one in defects_of(road) if (one.kind, one.place) not in told]
    return Survey(name, kind, net, road, knows, tuple(found))
