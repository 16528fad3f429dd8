"""The shapes of the shipped roads, as the plain XML that netconvert turns into a SUMO net.

A geometry is a few numbers; `sources` writes nodes, edges and connections for it. Axes: straight
roads and motorways run along +x from x = 0; intersections and roundabouts have their centre at the
origin. Motorways and roundabouts have no sidewalks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from behaviors.errors import InputError

SIDEWALK_WIDTH_M: Final = 2.0
LANE_WIDTH_M: Final = 3.2
"""SUMO's default lane width, m."""

CROSSING_WIDTH_M: Final = 4.0
"""SUMO's default crossing width, m."""

LIMIT_MPS: Final = 13.89
"""50 km/h: the usual limit in towns."""

TWO_WAY_LENGTH_M: Final = 1200.0
"""Length of the shipped two-way roads, m: overtaking against oncoming traffic takes room."""

ARM_M: Final = 250.0
"""Length of an intersection's arm, m."""

MOTORWAY_LIMIT_MPS: Final = 33.33
"""120 km/h: the most common limit of European motorways."""

RAMP_M: Final = 250.0
"""Length of a ramp outside the motorway, m (enough to speed up on)."""

RAMP_SLOPE: Final = 0.12
"""How far a ramp departs from the road per metre (seven degrees)."""

RAMP_LIMIT_MPS: Final = 22.22
"""80 km/h: a usual limit on ramps."""

RING_LIMIT_MPS: Final = 8.33
"""30 km/h: what the bend of a small roundabout allows."""

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
"""The most lanes per direction that a geometry may have."""

_NO_WALKING: Final = 'disallow="pedestrian bicycle"'
Link = tuple[str, int, str, int]
"""A way between lanes: first edge and lane, last edge and lane."""


class Geometry(Protocol):
    """A road's shape: what netconvert makes a net of."""

    @property
    def limit_mps(self) -> float:
        """Speed limit, m/s."""
        ...

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        ...


@dataclass(frozen=True, slots=True)
class StraightGeometry:
    """A straight road with a sidewalk on either side.

    Attributes:
        lanes: lanes per direction, 1 to 5.
        two_way: whether there is oncoming traffic.
        crossing: whether pedestrians cross half-way, with priority.
        length_m: m.
        limit_mps: speed limit, m/s.
    """

    lanes: int = 3
    two_way: bool = False
    crossing: bool = True
    length_m: float = 800.0
    limit_mps: float = LIMIT_MPS

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        _check_lanes(self.lanes)
        _check_positive(length_m=self.length_m, limit_mps=self.limit_mps)

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        nodes = [
            _node("west", 0.0, 0.0), _node("middle", self.length_m / 2, 0.0),
            _node("east", self.length_m, 0.0),
        ]  # fmt: skip
        width = f'"{SIDEWALK_WIDTH_M:g}" spreadType="right"'
        road = (
            f'priority="2" numLanes="{self.lanes}" speed="{self.limit_mps:g}" sidewalkWidth={width}'
        )
        walk = f'priority="1" numLanes="1" speed="{self.limit_mps:g}" allow="pedestrian" '
        back = road if self.two_way else f"{walk}width={width}"
        edges = [
            _edge("east_in", "west", "middle", road),
            _edge("east_out", "middle", "east", road),
            _edge("west_in", "east", "middle", back),
            _edge("west_out", "middle", "west", back),
        ]
        crossed = "east_in west_out" if self.two_way else "east_in"
        crossing = (
            f'    <crossing node="middle" edges="{crossed}" priority="true" '
            f'width="{CROSSING_WIDTH_M:g}"/>'
        )
        ways = [crossing] if self.crossing else []
        return _sources(nodes, edges, ways, opposites=self.two_way)


@dataclass(frozen=True, slots=True)
class FourWayGeometry:
    """A four-way intersection with sidewalks and crossings on every arm.

    Attributes:
        control: one of ``CONTROLS``.
        lanes: lanes per direction, 1 to 5.
        arm_m: length of each arm, m.
        limit_mps: speed limit, m/s.
    """

    control: str = "traffic_light"
    lanes: int = 2
    arm_m: float = ARM_M
    limit_mps: float = LIMIT_MPS

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        if self.control not in CONTROLS:
            raise InputError(f"control: found {self.control!r}, expected one of {CONTROLS}")
        _check_lanes(self.lanes)
        _check_positive(arm_m=self.arm_m, limit_mps=self.limit_mps)

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        nodes = [f'    <node id="centre" x="0" y="0" type="{self.control}"/>']
        edges, ways = [], []
        for arm, (dx, dy) in ARMS.items():
            nodes.append(_node(arm, dx * self.arm_m, dy * self.arm_m))
            main = self.control == "priority" and arm in ("east", "west")
            road = (
                f'priority="{3 if main else 2}" numLanes="{self.lanes}" '
                f'speed="{self.limit_mps:g}" sidewalkWidth="{SIDEWALK_WIDTH_M:g}"'
            )
            edges.append(_edge(f"{arm}_in", arm, "centre", road))
            edges.append(_edge(f"{arm}_out", "centre", arm, road))
            ways.append(
                f'    <crossing node="centre" edges="{arm}_in {arm}_out" '
                f'width="{CROSSING_WIDTH_M:g}" priority="true"/>'
            )
        return _sources(nodes, edges, ways)


@dataclass(frozen=True, slots=True)
class MotorwayGeometry:
    """One carriageway of a motorway, with or without ramps.

    Edges: ``before``, ``between`` and ``after``; with ramps also ``on``, which joins before
    ``between`` with a lane of its own, and ``off``, which leaves after it.

    Attributes:
        lanes: lanes outside the ramps, 1 to 4 with ramps, else 1 to 5.
        ramps: whether there is an on-ramp after a third and an off-ramp after two thirds.
        length_m: m.
        limit_mps: speed limit, m/s.
    """

    lanes: int = 3
    ramps: bool = False
    length_m: float = 2000.0
    limit_mps: float = MOTORWAY_LIMIT_MPS

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        _check_lanes(self.lanes)
        if self.ramps and self.lanes > 4:
            raise InputError(f"lanes: found {self.lanes}, expected 1 to 4 beside a ramp's lane")
        _check_positive(length_m=self.length_m, limit_mps=self.limit_mps)
        if self.ramps and self.length_m < 3 * RAMP_M:
            raise InputError(f"length_m: found {self.length_m}, expected {3 * RAMP_M:g} or more")

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        first, second = self.length_m / 3, 2 * self.length_m / 3
        extra = 1 if self.ramps else 0
        nodes = [
            _node("west", 0.0, 0.0), _node("join", first, 0.0), _node("part", second, 0.0),
            _node("east", self.length_m, 0.0),
        ]  # fmt: skip
        edges = [
            self._edge("before", "west", "join", self.lanes),
            self._edge("between", "join", "part", self.lanes + extra),
            self._edge("after", "part", "east", self.lanes),
        ]
        links: list[Link] = []
        if self.ramps:
            edge_y = -self.lanes * LANE_WIDTH_M  # the left edge of the ramps' own lane
            enter = (first - RAMP_M, edge_y - RAMP_SLOPE * RAMP_M)
            leave = (second + RAMP_M, edge_y - RAMP_SLOPE * RAMP_M)
            nodes += [_node("enter", *enter), _node("leave", *leave)]
            edges += [
                self._edge("on", "enter", "join", 1, (enter, (first, edge_y))),
                self._edge("off", "part", "leave", 1, ((second, edge_y), leave)),
            ]
            links = [("on", 0, "between", 0), ("between", 0, "off", 0)]
        for i in range(self.lanes):
            links += [("before", i, "between", i + extra), ("between", i + extra, "after", i)]
        return _sources(nodes, edges, connection_rows(links), limit_turns=False)

    def _edge(
        self, name: str, begin: str, end: str, lanes: int,
        ramp: Sequence[tuple[float, float]] | None = None,
    ) -> str:  # fmt: skip
        """The element of a piece of the road, or of a ramp along some points."""
        limit = self.limit_mps if ramp is None else min(RAMP_LIMIT_MPS, self.limit_mps)
        shape = "" if ramp is None else " ".join(f"{x:g},{y:g}" for x, y in ramp)
        road = f'numLanes="{lanes}" priority="{3 if ramp is None else 1}" speed="{limit:g}" '
        road += 'spreadType="right" ' + (f'shape="{shape}" ' if shape else "")
        return _edge(name, begin, end, road + _NO_WALKING)


@dataclass(frozen=True, slots=True)
class RoundaboutGeometry:
    """A roundabout with four arms; those on the ring have priority.

    Edges: ``east_in``, ``east_out`` and so on for each arm, and the ring's ``east_north``,
    ``north_west``, ``west_south`` and ``south_east``.

    Attributes:
        lanes: lanes of each arm per direction and of the ring, 1 or 2.
        radius_m: of the ring, m.
        arm_m: length of each arm, m.
        limit_mps: speed limit of the arms, m/s.
    """

    lanes: int = 1
    radius_m: float = 20.0
    arm_m: float = 200.0
    limit_mps: float = LIMIT_MPS

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        _check_lanes(self.lanes)
        if self.lanes > 2:
            raise InputError(f"lanes: found {self.lanes}, expected 1 or 2")
        _check_positive(radius_m=self.radius_m, arm_m=self.arm_m, limit_mps=self.limit_mps)
        if self.radius_m < 12.0:
            raise InputError(f"radius_m: found {self.radius_m}, expected 12 or more")

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        arms = list(ARMS)
        ring = [f"{arm}_{arms[(k + 1) % 4]}" for k, arm in enumerate(arms)]
        nodes: list[str] = []
        edges: list[str] = []
        links: list[Link] = []
        lane = f'numLanes="{self.lanes}" {_NO_WALKING}'
        arm_road = f'priority="1" speed="{self.limit_mps:g}" {lane}'
        for k, (arm, (dx, dy)) in enumerate(ARMS.items()):
            for node, away in ((arm, self.radius_m + self.arm_m), (f"ring_{arm}", self.radius_m)):
                nodes.append(_node(node, dx * away, dy * away))
            arc = [math.atan2(dy, dx) + math.pi / 2 * part / 8 for part in range(9)]
            shape = " ".join(
                f"{self.radius_m * math.cos(a):.2f},{self.radius_m * math.sin(a):.2f}" for a in arc
            )
            ring_road = (
                f'priority="3" speed="{min(RING_LIMIT_MPS, self.limit_mps):g}" '
                f'spreadType="center" shape="{shape}" {lane}'
            )
            edges += [
                _edge(f"{arm}_in", arm, f"ring_{arm}", arm_road),
                _edge(f"{arm}_out", f"ring_{arm}", arm, arm_road),
                _edge(ring[k], f"ring_{arm}", f"ring_{arms[(k + 1) % 4]}", ring_road),
            ]
            for i in range(self.lanes):
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
) -> dict[str, str]:  # fmt: skip
    """Netconvert's files; lanes may be used against their direction, and bends slow turns."""
    values = {
        "node-files": "road.nod.xml",
        "edge-files": "road.edg.xml",
        "connection-files": "road.con.xml",
        "no-turnarounds": "true",
        "offset.disable-normalization": "true",
        "junctions.limit-turn-speed": "5.5",
        "tls.default-type": "static",
        "tls.cycle.time": "60",
        "tls.allred.time": "3",
        "no-warnings": "true",
    }
    if not limit_turns:
        del values["junctions.limit-turn-speed"]
    if opposites:
        values |= {"opposites.guess": "true", "opposites.guess.fix-lengths": "true"}
    settings = [f'    <{key} value="{value}"/>' for key, value in values.items()]
    return {
        "road.nod.xml": document("nodes", nodes),
        "road.edg.xml": document("edges", edges),
        "road.con.xml": document("connections", ways),
        "road.netccfg": document("configuration", settings),
    }


def _check_lanes(lanes: int) -> None:
    if not isinstance(lanes, int) or not 1 <= lanes <= MOST_LANES:
        raise InputError(f"lanes: found {lanes!r:.80}, expected 1 to {MOST_LANES}")


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not isinstance(value, int | float) or not math.isfinite(value) or value <= 0:
            raise InputError(f"{name}: found {value!r:.80}, expected a number > 0")
