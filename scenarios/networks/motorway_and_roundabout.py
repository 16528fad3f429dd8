"""The shapes of motorways and roundabouts, as the plain XML that netconvert turns into a SUMO net.

Axes: a motorway runs along +x from x = 0; a roundabout's centre is the origin. Neither has
sidewalks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.geometry import (
    ARMS,
    LANE_WIDTH_M,
    LIMIT_MPS,
    RAMP_SLOPE,
    check_lanes,
    check_positive,
    connections,
    document,
    settings,
)

MOTORWAY_LIMIT_MPS: Final = 33.33
"""120 km/h: the most common limit of European motorways."""

RAMP_M: Final = 250.0
"""Length of a ramp outside the motorway, m (enough to speed up on)."""

RAMP_LIMIT_MPS: Final = 22.22
"""80 km/h: a usual limit on ramps."""

RING_LIMIT_MPS: Final = 8.33
"""30 km/h: what the bend of a small roundabout allows."""

MOTORS: Final = 'disallow="pedestrian bicycle"'


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
        check_lanes(self.lanes)
        if self.ramps and self.lanes > 4:
            raise InputError(f"lanes: found {self.lanes}, expected 1 to 4 beside a ramp's lane")
        check_positive(length_m=self.length_m, limit_mps=self.limit_mps)
        if self.ramps and self.length_m < 3 * RAMP_M:
            raise InputError(f"length_m: found {self.length_m}, expected {3 * RAMP_M:g} or more")

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        first, second = self.length_m / 3, 2 * self.length_m / 3
        places = {"west": (0.0, 0.0), "join": (first, 0.0), "part": (second, 0.0),
                  "east": (self.length_m, 0.0)}  # fmt: skip
        extra = 1 if self.ramps else 0
        edges = [
            ("before", "west", "join", self.lanes, self.limit_mps),
            ("between", "join", "part", self.lanes + extra, self.limit_mps),
            ("after", "part", "east", self.lanes, self.limit_mps),
        ]
        links: list[tuple[str, int, str, int]] = []
        shapes: dict[str, str] = {}
        if self.ramps:
            edge_y = -self.lanes * LANE_WIDTH_M  # the left edge of the ramps' own lane
            aside, ramp = edge_y - RAMP_SLOPE * RAMP_M, min(RAMP_LIMIT_MPS, self.limit_mps)
            places |= {"enter": (first - RAMP_M, aside), "leave": (second + RAMP_M, aside)}
            shapes = {
                "on": f"{first - RAMP_M:g},{aside:g} {first:g},{edge_y:g}",
                "off": f"{second:g},{edge_y:g} {second + RAMP_M:g},{aside:g}",
            }
            edges += [("on", "enter", "join", 1, ramp), ("off", "part", "leave", 1, ramp)]
            links = [("on", 0, "between", 0), ("between", 0, "off", 0)]
        for i in range(self.lanes):
            links += [("before", i, "between", i + extra), ("between", i + extra, "after", i)]
        return {
            "road.nod.xml": document("nodes", [
                f'    <node id="{n}" x="{x:g}" y="{y:g}" type="priority"/>'
                for n, (x, y) in places.items()
            ]),
            "road.edg.xml": document("edges", [
                f'    <edge id="{edge}" from="{begin}" to="{end}" numLanes="{lanes}" '
                f'priority="{1 if edge in shapes else 3}" speed="{limit:g}" spreadType="right" '
                + (f'shape="{shapes[edge]}" ' if edge in shapes else "")
                + f"{MOTORS}/>"
                for edge, begin, end, lanes, limit in edges
            ]),
            "road.con.xml": connections(links),
            "road.netccfg": settings(opposites=False, limit_turns=False),
        }  # fmt: skip


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
        check_lanes(self.lanes)
        if self.lanes > 2:
            raise InputError(f"lanes: found {self.lanes}, expected 1 or 2")
        check_positive(radius_m=self.radius_m, arm_m=self.arm_m, limit_mps=self.limit_mps)
        if self.radius_m < 12.0:
            raise InputError(f"radius_m: found {self.radius_m}, expected 12 or more")

    def sources(self) -> dict[str, str]:
        """Text by file name: nodes, edges, connections and netconvert's settings."""
        arms, far = list(ARMS), self.radius_m + self.arm_m
        nodes, edges, links = [], [], []
        lane = f'numLanes="{self.lanes}" {MOTORS}'
        for k, (arm, (dx, dy)) in enumerate(ARMS.items()):
            then, before = arms[(k + 1) % 4], arms[k - 1]
            for node, away in ((arm, far), (f"ring_{arm}", self.radius_m)):
                nodes.append(
                    f'    <node id="{node}" x="{dx * away:g}" y="{dy * away:g}" type="priority"/>'
                )
            angle = math.atan2(dy, dx)
            arc = [angle + math.pi / 2 * part / 8 for part in range(9)]
            shape = " ".join(
                f"{self.radius_m * math.cos(a):.2f},{self.radius_m * math.sin(a):.2f}" for a in arc
            )
            edges += [
                f'    <edge id="{arm}_in" from="{arm}" to="ring_{arm}" priority="1" '
                f'speed="{self.limit_mps:g}" {lane}/>',
                f'    <edge id="{arm}_out" from="ring_{arm}" to="{arm}" priority="1" '
                f'speed="{self.limit_mps:g}" {lane}/>',
                f'    <edge id="{arm}_{then}" from="ring_{arm}" to="ring_{then}" priority="3" '
                f'speed="{min(RING_LIMIT_MPS, self.limit_mps):g}" spreadType="center" '
                f'shape="{shape}" {lane}/>',
            ]
            ring_in, ring_out = f"{before}_{arm}", f"{arm}_{then}"
            for i in range(self.lanes):
                links += [(f"{arm}_in", i, ring_out, i), (ring_in, i, ring_out, i)]
            links.append((ring_in, 0, f"{arm}_out", 0))
        edges.append(
            f'    <roundabout nodes="{" ".join(f"ring_{arm}" for arm in arms)}" '
            f'edges="{" ".join(f"{arm}_{arms[(k + 1) % 4]}" for k, arm in enumerate(arms))}"/>'
        )
        return {
            "road.nod.xml": document("nodes", nodes),
            "road.edg.xml": document("edges", edges),
            "road.con.xml": connections(links),
            "road.netccfg": settings(opposites=False),
        }  # fmt: skip
