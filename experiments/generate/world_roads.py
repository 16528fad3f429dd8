"""The roads of random worlds, made without netconvert, and the traffic on them.

Nets that are written here have no sidewalks and no lanes inside junctions, so a road of any number
of lanes, length and limit is a few lines of XML. Axes: the road runs along +x from the origin; its
right edge is at y = 0, so lane 0 is the rightmost.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from behaviors.elementwise import log_uniform
from scenarios.four_way_intersection import TURNS
from scenarios.networks.build import FOLDER, NET
from scenarios.networks.geometries import (
    ARMS,
    LANE_WIDTH_M,
    LIMIT_MPS,
    RAMP_SLOPE,
    TWO_WAY_LENGTH_M,
)
from sim.scenario import RouteFlow

FAMILIES: Final = {"straight": 0.45, "junction": 0.25, "ramp": 0.2, "two-way": 0.1}
"""Chance of each family of roads."""

JUNCTIONS: Final[dict[str, dict[int, str]]] = {
    "traffic_light": {1: "four_way_1", 2: "four_way_intersection", 3: "four_way_3"},
    "priority": {1: "four_way_priority", 2: "four_way_priority_2"},
    "right_before_left": {1: "four_way_right_before_left", 2: "four_way_right_before_left_2"},
    "allway_stop": {1: "four_way_allway_stop"},
}
"""The shipped net of each control of a junction, by lanes in each direction."""

MOST_PRESENT: Final = 60.0
"""About the largest number of vehicles at once, which bounds flows: more show nothing new."""

RAMP_SHARE, RAMP_M = (0.1, 0.35), 200.0
"""Share of the traffic that uses each ramp, and a ramp's length beside its acceleration lane, m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldRoad:
    """A road of one of the `FAMILIES` and the demand on it.

    A junction's ``control`` is a key of `JUNCTIONS`. Lanes are those of each direction; a junction
    is ``length_m`` long from end to end. The flow is over all entries, vehicles per hour; of it,
    ``ramp_share`` enters and leaves by a ramp.
    """

    family: str
    control: str = ""
    lanes: int
    limit_mps: float
    length_m: float
    flow: float
    pedestrians_per_h: float = 0.0
    ramp_share: float = 0.0

    def net(self) -> str:
        """The text of the SUMO net."""
        if self.family == "straight":
            return straight_net(self.lanes, self.limit_mps, self.length_m)
        if self.family == "ramp":
            return ramp_net(self.lanes, self.limit_mps, self.length_m)
        if self.family == "two-way":
            return _limited_net(f"two_way_{self.lanes}_plain", self.limit_mps)
        return _limited_net(JUNCTIONS[self.control][self.lanes], self.limit_mps)

    def flows(self) -> tuple[RouteFlow, ...]:
        """The demand along each route."""
        if self.family == "straight":
            return (RouteFlow(("road",), self.flow),)
        if self.family == "two-way":
            routes = ("east_in", "east_out"), ("west_in", "west_out")
            return tuple(RouteFlow(route, self.flow / 2) for route in routes)
        if self.family == "ramp":
            aside = self.flow * self.ramp_share
            return (
                RouteFlow(("before", "between", "after"), self.flow - 2 * aside),
                RouteFlow(("on", "between", "after"), aside),
                RouteFlow(("before", "between", "off"), aside),
            )
        arms, found = list(ARMS), []
        for i, arm in enumerate(arms):
            for places, share in TURNS.items():
                route = (f"{arm}_in", f"{arms[(i - places) % len(arms)]}_out")
                found.append(RouteFlow(route, self.flow / len(arms) * share))
                walkers = self.pedestrians_per_h / (len(arms) * len(TURNS))
                found.append(RouteFlow(route, walkers, walking=True))
        return tuple(found)


def draw_road(rng: np.random.Generator) -> WorldRoad:
    """Draw a road of 20 to 130 km/h with one to five lanes, and light to dense traffic on it."""
    family = str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))
    level = float(rng.uniform(0.0, 1.0))
    if family == "junction":
        control = str(rng.choice(list(JUNCTIONS)))
        signals = control == "traffic_light"
        lanes = int(rng.choice(list(JUNCTIONS[control])))
        limit = float(rng.uniform(20.0, 70.0)) / 3.6
        flow = (200.0 + 700.0 * level) * lanes if signals else 200.0 + 550.0 * level
        walkers = float(rng.choice((0.0, 0.0, 120.0, 300.0)))
        return WorldRoad(
            family=family, control=control, lanes=lanes, limit_mps=round(limit, 2),
            length_m=500.0, flow=round(flow), pedestrians_per_h=walkers,
        )  # fmt: skip
    if family == "two-way":
        lanes = int(rng.integers(1, 3))
        limit = float(rng.uniform(30.0, 100.0)) / 3.6
        return WorldRoad(
            family=family, lanes=lanes, limit_mps=round(limit, 2), length_m=TWO_WAY_LENGTH_M,
            flow=round((250.0 + 800.0 * level) * lanes),
        )  # fmt: skip
    ramp = family == "ramp"
    limit = float(rng.uniform(60.0 if ramp else 20.0, 130.0)) / 3.6
    lanes = int(rng.integers(1, 5 if ramp else 6))
    seconds = log_uniform(rng, 25.0, 80.0)
    length = min(max(limit * seconds, 900.0 if ramp else 250.0), 2500.0)
    flow = (250.0 + 1550.0 * level) * lanes
    present = flow / 3600.0 * length / (0.85 * limit)
    return WorldRoad(
        family=family, lanes=lanes, limit_mps=round(limit, 2), length_m=round(length),
        flow=round(flow * min(1.0, MOST_PRESENT / present)),
        ramp_share=round(float(rng.uniform(*RAMP_SHARE)), 3) if ramp else 0.0,
    )  # fmt: skip


class _Edge(NamedTuple):
    """A one-way road of parallel lanes between two points of its right edge, m."""

    id: str
    begin: str
    end: str
    lanes: int
    from_xy: tuple[float, float]
    to_xy: tuple[float, float]


_HEAD: Final = """<?xml version="1.0" encoding="UTF-8"?>

<net version="1.20" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://sumo.dlr.de/xsd/net_file.xsd">
    <location netOffset="0.00,0.00" convBoundary="{box}" origBoundary="{box}" projParameter="!"/>"""


def _net(edges: Sequence[_Edge], links: Sequence[tuple[str, int, str, int]], limit: float) -> str:
    """The text of a net; links, from edge and lane to edge and lane, never cross."""
    corners = np.array([xy for edge in edges for xy in (edge.from_xy, edge.to_xy)])
    box = ",".join(f"{v:.2f}" for v in (*corners.min(axis=0), *corners.max(axis=0)))
    rows = [_HEAD.format(box=box)]
    nodes: dict[str, tuple[float, float]] = {}
    for edge in edges:
        (x0, y0), (x1, y1) = edge.from_xy, edge.to_xy
        nodes.setdefault(edge.begin, edge.from_xy)
        nodes.setdefault(edge.end, edge.to_xy)
        length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
        rows.append(f'    <edge id="{edge.id}" from="{edge.begin}" to="{edge.end}" priority="2">')
        for lane in range(edge.lanes):
            side = (lane + 0.5) * LANE_WIDTH_M
            rows.append(
                f'        <lane id="{edge.id}_{lane}" index="{lane}" disallow="pedestrian" '
                f'speed="{limit:.2f}" length="{length:.2f}" '
                f'shape="{x0:.2f},{y0 + side:.2f} {x1:.2f},{y1 + side:.2f}"/>'
            )
        rows.append("    </edge>")
    for node, (x, y) in sorted(nodes.items()):
        into = {edge.id: edge.lanes for edge in edges if edge.end == node}
        lanes = " ".join(f"{edge}_{i}" for edge, count in into.items() for i in range(count))
        passed = sum(begin in into for begin, _, _, _ in links)
        kind, none = "priority" if passed else "dead_end", "0" * passed
        rows.append(
            f'    <junction id="{node}" type="{kind}" x="{x:.2f}" y="{y:.2f}" incLanes="{lanes}" '
            f'intLanes="" shape="{x:.2f},{y:.2f} {x:.2f},{y + LANE_WIDTH_M:.2f}">'
        )
        rows += [
            f'        <request index="{i}" response="{none}" foes="{none}" cont="0"/>'
            for i in range(passed)
        ]
        rows.append("    </junction>")
    rows += [
        f'    <connection from="{begin}" to="{end}" fromLane="{i}" toLane="{j}" dir="s" state="M"/>'
        for begin, i, end, j in links
    ]
    return "\n".join([*rows, "</net>", ""])


def straight_net(lanes: int, limit_mps: float, length_m: float) -> str:
    """The text of a net of a one-way road without anything on it; its only edge is ``road``."""
    road = _Edge("road", "west", "east", lanes, (0.0, 0.0), (length_m, 0.0))
    return _net([road], [], limit_mps)


def ramp_net(lanes: int, limit_mps: float, length_m: float) -> str:
    """The text of a net of a one-way road that an on-ramp joins after a third of its length.

    An off-ramp leaves it after two thirds. Between the ramps the road has one lane more, on the
    right. Edges: ``before``, ``between``, ``after``, ``on`` and ``off``.
    """
    first, second, aside = length_m / 3, 2 * length_m / 3, -RAMP_SLOPE * RAMP_M
    width = LANE_WIDTH_M
    edges = [
        _Edge("before", "west", "join", lanes, (0.0, width), (first, width)),
        _Edge("between", "join", "part", lanes + 1, (first, 0.0), (second, 0.0)),
        _Edge("after", "part", "east", lanes, (second, width), (length_m, width)),
        _Edge("on", "enter", "join", 1, (first - RAMP_M, aside), (first, 0.0)),
        _Edge("off", "part", "leave", 1, (second, 0.0), (second + RAMP_M, aside)),
    ]
    links = [
        *(("before", i, "between", i + 1) for i in range(lanes)),
        ("on", 0, "between", 0),
        *(("between", i + 1, "after", i) for i in range(lanes)),
        ("between", 0, "off", 0),
    ]
    return _net(edges, links, limit_mps)


def _limited_net(name: str, limit_mps: float) -> str:
    """The text of a shipped net with another speed limit; turns stay as slow as they are."""

    def limited(found: re.Match[str]) -> str:
        speed = float(found[2])
        new = limit_mps if abs(speed - LIMIT_MPS) < 0.006 else min(speed, limit_mps)
        return f"{found[1]}{new:.2f}{found[3]}"

    text = (FOLDER / name / NET).read_text(encoding="utf-8")
    return re.sub(r'(<lane [^>]*?speed=")([0-9.]+)(")', limited, text)
