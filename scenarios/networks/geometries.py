"""The shapes of the shipped roads, as the plain XML that netconvert turns into a SUMO net.

Each function writes the sources of a road from a few numbers: text by file name, for nodes, edges,
connections and netconvert's settings. Axes: straight roads and motorways run along +x from x = 0;
intersections and roundabouts have their centre at the origin. Motorways and roundabouts have no
sidewalks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final

from behaviors.errors import InputError

SIDEWALK_WIDTH_M: Final = 2.0
LANE_WIDTH_M, CROSSING_WIDTH_M = 3.2, 4.0
"""Widths, m; those of lanes and crossings are SUMO's defaults."""

LIMIT_MPS, MOTORWAY_LIMIT_MPS = 13.89, 33.33
"""The usual limit in towns is 50 km/h; the most common one of European motorways is 120 km/h."""

RAMP_LIMIT_MPS, RING_LIMIT_MPS = 22.22, 8.33
"""A usual limit on ramps is 80 km/h; the bend of a small roundabout allows 30 km/h."""

TWO_WAY_LENGTH_M: Final = 1200.0
"""Length of the shipped two-way roads, m: overtaking against oncoming traffic takes room."""

ARM_M: Final = 250.0
"""Length of an intersection's arm, m."""

RAMP_M: Final = 250.0
"""Length of a ramp outside the motorway, m (enough to speed up on)."""

RAMP_SLOPE: Final = 0.12
"""How far a ramp departs from the road per metre (seven degrees)."""

CONTROLS: Final = ("traffic_light", "priority", "allway_stop", "right_before_left")
"""How a four-way intersection can be controlled (SUMO's node types)."""

ARMS: Final[dict[str, tuple[float, float]]] = {
    "east": (1.0, 0.0),
    "north": (0.0, 1.0),
    "west": (-1.0, 0.0),
    "south": (0.0, -1.0),
}
"""The arms of an intersection or roundabout, and the direction that each points in."""

MOST_LANES: Final = 5
"""The most lanes per direction that a road may have."""

_NO_WALKING: Final = 'disallow="pedestrian bicycle"'

SOURCE_FILES: Final = ("road.nod.xml", "road.edg.xml", "road.con.xml", "road.netccfg")
"""The files of a road's sources: nodes, edges, connections and netconvert's settings."""

Sources = dict[str, str]
Point = tuple[float, float]
Link = tuple[str, int, str, int]
"""A way between lanes: first edge and lane, last edge and lane."""


def straight_sources(
    lanes: int = 3,
    two_way: bool = False,
    crossing: bool = True,
    length_m: float = 800.0,
    limit_mps: float = LIMIT_MPS,
) -> Sources:
    """A straight road with a sidewalk on either side and a crossing half-way."""
    _check(lanes, length_m=length_m, limit_mps=limit_mps)
    places = {"west": 0.0, "middle": length_m / 2, "east": length_m}
    nodes = [_node(name, x, 0.0) for name, x in places.items()]
    width = f'"{SIDEWALK_WIDTH_M:g}" spreadType="right"'
    road = f'priority="2" numLanes="{lanes}" speed="{limit_mps:g}" sidewalkWidth={width}'
    walk = f'priority="1" numLanes="1" speed="{limit_mps:g}" allow="pedestrian" '
    back = road if two_way else f"{walk}width={width}"
    edges = [
        _edge("east_in", "west", "middle", road),
        _edge("east_out", "middle", "east", road),
        _edge("west_in", "east", "middle", back),
        _edge("west_out", "middle", "west", back),
    ]
    crossed = "east_in west_out" if two_way else "east_in"
    zebra = (
        f'    <crossing node="middle" edges="{crossed}" priority="true" '
        f'width="{CROSSING_WIDTH_M:g}"/>'
    )
    return _sources(nodes, edges, [zebra] if crossing else [], opposites=two_way)


def four_way_sources(
    control: str = "traffic_light",
    lanes: int = 2,
    arm_m: float = ARM_M,
    limit_mps: float = LIMIT_MPS,
) -> Sources:
    """A four-way intersection, under one of ``CONTROLS``, with crossings on every arm."""
    if control not in CONTROLS:
        raise InputError(f"control: found {control!r}, expected one of {CONTROLS}")
    _check(lanes, arm_m=arm_m, limit_mps=limit_mps)
    nodes = [f'    <node id="centre" x="0" y="0" type="{control}"/>']
    edges, ways = [], []
    for arm, (dx, dy) in ARMS.items():
        nodes.append(_node(arm, dx * arm_m, dy * arm_m))
        main = control == "priority" and arm in ("east", "west")
        road = (
            f'priority="{3 if main else 2}" numLanes="{lanes}" speed="{limit_mps:g}" '
            f'sidewalkWidth="{SIDEWALK_WIDTH_M:g}"'
        )
        edges.append(_edge(f"{arm}_in", arm, "centre", road))
        edges.append(_edge(f"{arm}_out", "centre", arm, road))
        ways.append(
            f'    <crossing node="centre" edges="{arm}_in {arm}_out" '
            f'width="{CROSSING_WIDTH_M:g}" priority="true"/>'
        )
    return _sources(nodes, edges, ways)


def motorway_sources(
    lanes: int = 3,
    ramps: bool = False,
    length_m: float = 2000.0,
    limit_mps: float = MOTORWAY_LIMIT_MPS,
) -> Sources:
    """One carriageway of a motorway, with or without ramps.

    Edges: ``before``, ``between`` and ``after``; with ramps also ``on``, which joins before
    ``between`` with a lane of its own, and ``off``, which leaves after it.
    """
    _check(lanes, length_m=length_m, limit_mps=limit_mps)
    if ramps and lanes > 4:
        raise InputError(f"lanes: found {lanes}, expected 1 to 4 beside a ramp's lane")
    if ramps and length_m < 3 * RAMP_M:
        raise InputError(f"length_m: found {length_m}, expected {3 * RAMP_M:g} or more")

    def edge(name: str, begin: str, end: str, lanes: int, ramp: Sequence[Point] = ()) -> str:
        limit = min(RAMP_LIMIT_MPS, limit_mps) if ramp else limit_mps
        road = f'numLanes="{lanes}" priority="{1 if ramp else 3}" speed="{limit:g}" '
        shape = f'shape="{" ".join(f"{x:g},{y:g}" for x, y in ramp)}" ' if ramp else ""
        return _edge(name, begin, end, f'{road}spreadType="right" {shape}{_NO_WALKING}')

    first, second, extra = length_m / 3, 2 * length_m / 3, int(ramps)
    places = {"west": 0.0, "join": first, "part": second, "east": length_m}
    nodes = [_node(name, x, 0.0) for name, x in places.items()]
    edges = [
        edge("before", "west", "join", lanes),
        edge("between", "join", "part", lanes + extra),
        edge("after", "part", "east", lanes),
    ]
    links: list[Link] = []
    if ramps:
        y = -lanes * LANE_WIDTH_M  # the left edge of the ramps' own lane
        enter = (first - RAMP_M, y - RAMP_SLOPE * RAMP_M)
        leave = (second + RAMP_M, y - RAMP_SLOPE * RAMP_M)
        nodes += [_node("enter", *enter), _node("leave", *leave)]
        edges += [
            edge("on", "enter", "join", 1, (enter, (first, y))),
            edge("off", "part", "leave", 1, ((second, y), leave)),
        ]
        links = [("on", 0, "between", 0), ("between", 0, "off", 0)]
    for i in range(lanes):
        links += [("before", i, "between", i + extra), ("between", i + extra, "after", i)]
    return _sources(nodes, edges, connection_rows(links), limit_turns=False)


def roundabout_sources(
    lanes: int = 1, radius_m: float = 20.0, arm_m: float = 200.0, limit_mps: float = LIMIT_MPS
) -> Sources:
    """A roundabout with four arms and as many lanes on the ring, which has priority.

    Edges: ``east_in``, ``east_out`` and so on for each arm, and the ring's ``east_north``,
    ``north_west``, ``west_south`` and ``south_east``.
    """
    _check(lanes, 2, radius_m=radius_m, arm_m=arm_m, limit_mps=limit_mps)
    if radius_m < 12.0:
        raise InputError(f"radius_m: found {radius_m}, expected 12 or more")
    arms = list(ARMS)
    ring = [f"{arm}_{arms[(k + 1) % 4]}" for k, arm in enumerate(arms)]
    nodes, edges, links = list[str](), list[str](), list[Link]()
    lane = f'numLanes="{lanes}" {_NO_WALKING}'
    arm_road = f'priority="1" speed="{limit_mps:g}" {lane}'
    for k, (arm, (dx, dy)) in enumerate(ARMS.items()):
        for node, away in ((arm, radius_m + arm_m), (f"ring_{arm}", radius_m)):
            nodes.append(_node(node, dx * away, dy * away))
        arc = [math.atan2(dy, dx) + math.pi / 2 * part / 8 for part in range(9)]
        shape = " ".join(f"{radius_m * math.cos(a):.2f},{radius_m * math.sin(a):.2f}" for a in arc)
        ring_road = (
            f'priority="3" speed="{min(RING_LIMIT_MPS, limit_mps):g}" '
            f'spreadType="center" shape="{shape}" {lane}'
        )
        edges += [
            _edge(f"{arm}_in", arm, f"ring_{arm}", arm_road),
            _edge(f"{arm}_out", f"ring_{arm}", arm, arm_road),
            _edge(ring[k], f"ring_{arm}", f"ring_{arms[(k + 1) % 4]}", ring_road),
        ]
        for i in range(lanes):
            links += [(f"{arm}_in", i, ring[k], i), (ring[k - 1], i, ring[k], i)]
        links.append((ring[k - 1], 0, f"{arm}_out", 0))
    ring_nodes = " ".join(f"ring_{arm}" for arm in arms)
    edges.append(f'    <roundabout nodes="{ring_nodes}" edges="{" ".join(ring)}"/>')
    return _sources(nodes, edges, connection_rows(links))


def document(root: str, rows: Iterable[str]) -> str:
    """An XML document of rows."""
    return "\n".join([f"<{root}>", *rows, f"</{root}>", ""])


def connection_rows(links: Iterable[Link]) -> list[str]:
    """The elements of some ways between lanes."""
    return [
        f'    <connection from="{a}" fromLane="{i}" to="{b}" toLane="{j}"/>' for a, i, b, j in links
    ]


def _node(name: str, x: float, y: float) -> str:
    return f'    <node id="{name}" x="{x:g}" y="{y:g}" type="priority"/>'


def _edge(name: str, begin: str, end: str, road: str) -> str:
    return f'    <edge id="{name}" from="{begin}" to="{end}" {road}/>'


def _sources(
    nodes: list[str], edges: list[str], ways: list[str], *,
    opposites: bool = False, limit_turns: bool = True,
) -> Sources:  # fmt: skip
    """Netconvert's files; lanes may be used against their direction, and bends slow turns."""
    values = {
        "node-files": SOURCE_FILES[0],
        "edge-files": SOURCE_FILES[1],
        "connection-files": SOURCE_FILES[2],
        "no-turnarounds": "true",
        "offset.disable-normalization": "true",
        **({"junctions.limit-turn-speed": "5.5"} if limit_turns else {}),
        "tls.default-type": "static",
        "tls.cycle.time": "60",
        "tls.allred.time": "3",
        "no-warnings": "true",
    }
    if opposites:
        values |= {"opposites.guess": "true", "opposites.guess.fix-lengths": "true"}
    settings = [f'    <{key} value="{value}"/>' for key, value in values.items()]
    parts = {"nodes": nodes, "edges": edges, "connections": ways, "configuration": settings}
    return dict(zip(SOURCE_FILES, (document(*part) for part in parts.items()), strict=True))


def _check(lanes: int, most: int = MOST_LANES, **positive: float) -> None:
    """Refuse numbers of which no road can be built."""
    if not isinstance(lanes, int) or not 1 <= lanes <= most:
        raise InputError(f"lanes: found {lanes!r:.80}, expected 1 to {most}")
    for name, value in positive.items():
        if not isinstance(value, int | float) or not math.isfinite(value) or value <= 0:
            raise InputError(f"{name}: found {value!r:.80}, expected a number > 0")
