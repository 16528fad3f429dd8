"""The shapes of the shipped roads, as the plain XML that netconvert turns into a SUMO net.

A geometry is a few numbers; `sources` writes the nodes, edges and connections for it. Axes: the
straight road runs along +x from x = 0; the intersection's centre is the origin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from behaviors.errors import InputError

SIDEWALK_WIDTH_M: Final = 2.0
LANE_WIDTH_M: Final = 3.2
"""SUMO's default lane width, m."""

RAMP_SLOPE: Final = 0.12
"""How far a ramp departs from the road per metre (seven degrees)."""

CROSSING_WIDTH_M: Final = 4.0
"""SUMO's default crossing width, m."""

TWO_WAY_LENGTH_M: Final = 1200.0
"""Length of the shipped two-way roads, m: overtaking against oncoming traffic takes room."""

LIMIT_MPS: Final = 13.89
"""50 km/h: the usual limit in towns."""

ARM_M: Final = 250.0
"""Length of an intersection's arm, m."""

CONTROLS: Final[tuple[str, ...]] = (
    "traffic_light",
    "priority",
    "allway_stop",
    "right_before_left",
)
"""How a four-way intersection can be controlled (SUMO's node types)."""

ARMS: Final[dict[str, tuple[float, float]]] = {
    "east": (1.0, 0.0),
    "north": (0.0, 1.0),
    "west": (-1.0, 0.0),
    "south": (0.0, -1.0),
}
"""The intersection's arms and the direction each points in."""

_MOST_LANES: Final = 5
"""The most lanes per direction that a geometry may have."""


def check_lanes(lanes: int) -> None:
    """Refuse a number of lanes that no geometry has."""
    if not isinstance(lanes, int) or not 1 <= lanes <= _MOST_LANES:
        raise InputError(f"lanes: found {lanes!r:.80}, expected 1 to {_MOST_LANES}")


def check_positive(**values: float) -> None:
    """Refuse lengths and limits that are not above zero."""
    for name, value in values.items():
        if not isinstance(value, int | float) or not math.isfinite(value) or value <= 0:
            raise InputError(f"{name}: found {value!r:.80}, expected a number > 0")


@dataclass(frozen=True, slots=True)
class StraightGeometry:
    """A straight road with a sidewalk on either side.

    Attributes:
        lanes: lanes per direction, 1 to 5.
        two_way: whether there is traffic in the other direction too.
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
        check_lanes(self.lanes)
        check_positive(length_m=self.length_m, limit_mps=self.limit_mps)

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        half = self.length_m / 2
        nodes = [("west", 0.0), ("middle", half), ("east", self.length_m)]
        node_rows = [f'    <node id="{n}" x="{x:g}" y="0" type="priority"/>' for n, x in nodes]
        road = (
            f'priority="2" numLanes="{self.lanes}" speed="{self.limit_mps:g}" '
            f'sidewalkWidth="{SIDEWALK_WIDTH_M:g}" spreadType="right"'
        )
        walk = f'priority="1" numLanes="1" speed="{self.limit_mps:g}" allow="pedestrian" ' + (
            f'width="{SIDEWALK_WIDTH_M:g}" spreadType="right"'
        )
        back = road if self.two_way else walk
        edge_rows = []
        for edge, begin, end, kind in (
            ("east_in", "west", "middle", road),
            ("east_out", "middle", "east", road),
            ("west_in", "east", "middle", back),
            ("west_out", "middle", "west", back),
        ):
            edge_rows.append(f'    <edge id="{edge}" from="{begin}" to="{end}" {kind}/>')
        connection_rows = []
        if self.crossing:
            crossed = "east_in west_out" if self.two_way else "east_in"
            connection_rows.append(
                f'    <crossing node="middle" edges="{crossed}" priority="true" '
                f'width="{CROSSING_WIDTH_M:g}"/>'
            )
        return {
            "road.nod.xml": document("nodes", node_rows),
            "road.edg.xml": document("edges", edge_rows),
            "road.con.xml": document("connections", connection_rows),
            "road.netccfg": settings(opposites=self.two_way),
        }


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
        check_lanes(self.lanes)
        check_positive(arm_m=self.arm_m, limit_mps=self.limit_mps)

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        node_rows = [f'    <node id="centre" x="0" y="0" type="{self.control}"/>']
        edge_rows = []
        for arm, (dx, dy) in ARMS.items():
            x, y = dx * self.arm_m, dy * self.arm_m
            node_rows.append(f'    <node id="{arm}" x="{x:g}" y="{y:g}" type="priority"/>')
            main = self.control == "priority" and arm in ("east", "west")
            road = (
                f'priority="{3 if main else 2}" numLanes="{self.lanes}" '
                f'speed="{self.limit_mps:g}" sidewalkWidth="{SIDEWALK_WIDTH_M:g}"'
            )
            edge_rows += [
                f'    <edge id="{arm}_in" from="{arm}" to="centre" {road}/>',
                f'    <edge id="{arm}_out" from="centre" to="{arm}" {road}/>',
            ]
        connection_rows = [
            f'    <crossing node="centre" edges="{arm}_in {arm}_out" '
            f'width="{CROSSING_WIDTH_M:g}" priority="true"/>'
            for arm in ARMS
        ]
        return {
            "road.nod.xml": document("nodes", node_rows),
            "road.edg.xml": document("edges", edge_rows),
            "road.con.xml": document("connections", connection_rows),
            "road.netccfg": settings(opposites=False),
        }


class Geometry(Protocol):
    """A road's shape: what netconvert makes a net of."""

    @property
    def limit_mps(self) -> float:
        """Speed limit, m/s."""
        ...

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        ...


def document(root: str, rows: Iterable[str]) -> str:
    """An XML document of rows."""
    return "\n".join([f"<{root}>", *rows, f"</{root}>", ""])


def connections(links: Iterable[tuple[str, int, str, int]]) -> str:
    """The document of some ways between lanes: first edge and lane, last edge and lane."""
    return document("connections", [
        f'    <connection from="{a}" fromLane="{i}" to="{b}" toLane="{j}"/>' for a, i, b, j in links
    ])  # fmt: skip


def settings(opposites: bool, *, limit_turns: bool = True) -> str:
    """Netconvert's settings.

    Args:
        opposites: whether lanes may be used against their direction.
        limit_turns: whether turns are as slow as their bends ask for.
    """
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
    return document("configuration", [f'    <{k} value="{v}"/>' for k, v in values.items()])
