"""The nets of worlds, made without netconvert: straight roads, ramps, other limits.

The nets have no sidewalks and no lanes inside junctions, so a road of any number of lanes, length
and limit is a few lines of XML. Axes: the road runs along +x from the origin; its right edge is at
y = 0, so lane 0 is the rightmost.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.build import FOLDER, NET, SHIPPED
from scenarios.networks.geometries import LANE_WIDTH_M, RAMP_SLOPE

RAMP_M: Final = 200.0
"""Length of a ramp before or after its acceleration lane, m."""
_HEAD: Final = """<?xml version="1.0" encoding="UTF-8"?>

<net version="1.20" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://sumo.dlr.de/xsd/net_file.xsd">
"""

_LIMITED: Final = re.compile(r'(<lane [^>]*?speed=")([0-9.]+)(")')


@dataclass(frozen=True, slots=True)
class _Edge:
    """A one-way road of parallel lanes between two points of its right edge, m."""

    id: str
    begin: str
    end: str
    lanes: int
    from_xy: tuple[float, float]
    to_xy: tuple[float, float]

    def xml(self, limit_mps: float) -> list[str]:
        """Its element, line by line."""
        (x0, y0), (x1, y1) = self.from_xy, self.to_xy
        length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
        rows = [f'    <edge id="{self.id}" from="{self.begin}" to="{self.end}" priority="2">']
        for lane in range(self.lanes):
            side = (lane + 0.5) * LANE_WIDTH_M
            rows.append(
                f'        <lane id="{self.id}_{lane}" index="{lane}" disallow="pedestrian" '
                f'speed="{limit_mps:.2f}" length="{length:.2f}" '
                f'shape="{x0:.2f},{y0 + side:.2f} {x1:.2f},{y1 + side:.2f}"/>'
            )
        return [*rows, "    </edge>"]


_Link = tuple[str, int, str, int]
"""A lane that goes on in another one: both edges and lanes."""


def _net(edges: Sequence[_Edge], links: Sequence[_Link], limit_mps: float) -> str:
    """The text of a net whose links never cross."""
    nodes: dict[str, tuple[float, float]] = {}
    for edge in edges:
        nodes.setdefault(edge.begin, edge.from_xy)
        nodes.setdefault(edge.end, edge.to_xy)
    rows = [row for edge in edges for row in edge.xml(limit_mps)]
    for node, (x, y) in sorted(nodes.items()):
        into = [edge for edge in edges if edge.end == node]
        lanes = " ".join(f"{edge.id}_{i}" for edge in into for i in range(edge.lanes))
        passed = sum(begin in {edge.id for edge in into} for begin, _, _, _ in links)
        kind = "priority" if passed else "dead_end"
        shape = f"{x:.2f},{y:.2f} {x:.2f},{y + LANE_WIDTH_M:.2f}"
        rows.append(
            f'    <junction id="{node}" type="{kind}" x="{x:.2f}" y="{y:.2f}" incLanes="{lanes}" '
            f'intLanes="" shape="{shape}">'
        )
        none = "0" * passed
        rows += [
            f'        <request index="{i}" response="{none}" foes="{none}" cont="0"/>'
            for i in range(passed)
        ]
        rows.append("    </junction>")
    rows += [
        f'    <connection from="{begin}" to="{end}" fromLane="{i}" toLane="{j}" dir="s" state="M"/>'
        for begin, i, end, j in links
    ]
    corners = [xy for edge in edges for xy in (edge.from_xy, edge.to_xy)]
    x0, x1 = min(x for x, _ in corners), max(x for x, _ in corners)
    y0, y1 = min(y for _, y in corners), max(y for _, y in corners)
    box = f"{x0:.2f},{y0:.2f},{x1:.2f},{y1:.2f}"
    place = (
        f'    <location netOffset="0.00,0.00" convBoundary="{box}" origBoundary="{box}" '
        'projParameter="!"/>'
    )
    return "\n".join([_HEAD + place, *rows, "</net>", ""])


def _check(lanes: int, limit_mps: float, length_m: float) -> None:
    if not 1 <= lanes <= 6:
        raise InputError(f"lanes: found {lanes}, expected 1 to 6")
    for name, value in (("limit_mps", limit_mps), ("length_m", length_m)):
        if not 0 < value < 1e5:
            raise InputError(f"{name}: found {value}, expected a number > 0")


def straight_net(lanes: int, limit_mps: float, length_m: float) -> str:
    """A one-way road without anything on it; its only edge is ``road``.

    Args:
        lanes: 1 to 6.
        limit_mps: speed limit, m/s.
        length_m: m.

    Returns:
        The text of a SUMO net.

    Raises:
        InputError: if a number is out of range.

    Examples:
        >>> straight_net(2, 10.0, 300.0).count("<lane ")
        2
    """
    _check(lanes, limit_mps, length_m)
    road = _Edge("road", "west", "east", lanes, (0.0, 0.0), (length_m, 0.0))
    return _net([road], [], limit_mps)


def ramp_net(lanes: int, limit_mps: float, length_m: float) -> str:
    """A one-way road that an on-ramp joins after a third and an off-ramp leaves after two thirds.

    Between the ramps the road has one lane more, on the right. Edges: ``before``, ``between``,
    ``after``, ``on`` and ``off``.

    Args:
        lanes: of the road outside, 1 to 5.
        limit_mps: speed limit, m/s.
        length_m: of the road, m.

    Returns:
        The text of a SUMO net.

    Raises:
        InputError: if a number is out of range.
    """
    _check(lanes + 1, limit_mps, length_m)
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


def limited_net(name: str, limit_mps: float) -> str:
    """A shipped net with another speed limit; turns stay as slow as they are.

    Args:
        name: a key of ``SHIPPED``.
        limit_mps: speed limit, m/s.

    Returns:
        The text of a SUMO net.

    Raises:
        InputError: if no such net exists.
    """
    if name not in SHIPPED:
        raise InputError(f"net: found {name!r}, expected one of {', '.join(SHIPPED)}")
    old = SHIPPED[name].limit_mps
    text = (FOLDER / name / NET).read_text(encoding="utf-8")

    def limited(found: re.Match[str]) -> str:
        speed = float(found[2])
        new = limit_mps if abs(speed - old) < 0.006 else min(speed, limit_mps)
        return f"{found[1]}{new:.2f}{found[3]}"

    return _LIMITED.sub(limited, text)
