"""Roads lane by lane as the plain XML that netconvert turns into a SUMO net.

Every lane for cars keeps its line, width and limit. Edges whose lanes are joined by connections
meet in one node, whose priorities netconvert derives.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from behaviors.errors import InputError
from scenarios.networks.geometries import LIMIT_MPS, connection_rows, document
from sim.frames import FloatArray
from sim.geometry import pieces_of
from sim.road import Lane, Road

_Link = tuple[str, int, str, int, bool]
"""A way: its first edge and lane, its last edge and lane, and whether a signal controls it."""

LEAST_LENGTH_M: Final = 0.5
"""Lanes shorter than this have no direction of their own, m: their line is drawn out to it."""

LEAST_WIDTH_M: Final = 1.0
"""netconvert gets no narrower lane, m (a motorcycle's)."""

ONCOMING_M: Final = 2.4
"""Lanes of opposite directions are at least this far apart, m (two cars pass)."""

BESIDE_M: Final = 1.1
"""They are at least half a lane's width and this far apart, m: highway-env puts a vehicle that is
up to 1 m beside a lane on it."""

OPPOSED: Final = -0.8
"""Cosine of the angle between two directions below which they are opposite: 143 degrees."""

SAMPLE_M: Final = 1.0
"""Lanes are compared at points this far apart, m."""

MEET_M: Final = 1.0
"""Ends of edges this near to each other meet in one node, m (netconvert refuses nodes that
coincide)."""


def plain_files(road: Road) -> dict[str, bytes]:
    """Nodes, edges and connections of a road's lanes for cars outside junctions, by file name."""
    edges: dict[str, list[Lane]] = {}
    for lane in road.lanes:
        if lane.cars and not lane.walking and not lane.internal:
            edges.setdefault(lane.edge, []).append(lane)
    if not edges:
        raise InputError(f"road {road.name!r:.60}: found no lane for cars, expected at least one")
    lines = _kept_apart([one for lanes in edges.values() for one in lanes], road.left_hand)
    for lanes in edges.values():
        lanes.sort(key=lambda lane: lane.index)
    place = {lane.id: (lane.edge, i) for lanes in edges.values() for i, lane in enumerate(lanes)}
    links = [
        (*place[link.from_lane], *place[link.to_lane], link.signal >= 0)
        for link in road.connections
        if link.from_lane in place and link.to_lane in place
    ]
    nodes, node_rows = _nodes(edges, lines, links)
    while loops := {edge for edge in edges if nodes[edge, False] == nodes[edge, True]}:
        edges = {edge: lanes for edge, lanes in edges.items() if edge not in loops}
        if not edges:
            raise InputError(f"road {road.name!r:.60}: found lanes that lead to themselves only")
        links = _without(links, loops)
        nodes, node_rows = _nodes(edges, lines, links)
    named = {edge: f"e{number}" for number, edge in enumerate(edges)}
    edge_rows = [
        row
        for edge, lanes in edges.items()
        for row in _edge(named[edge], nodes[edge, False], nodes[edge, True], lanes, lines)
    ]
    ways = dict.fromkeys(
        (named[begin], i, named[end], j) for begin, i, end, j, _ in links if begin != end
    )
    return {
        "map.nod.xml": document("nodes", node_rows).encode(),
        "map.edg.xml": document("edges", edge_rows).encode(),
        "map.con.xml": document("connections", connection_rows(ways)).encode(),
    }


def _kept_apart(lanes: list[Lane], left_hand: bool) -> dict[str, FloatArray]:
    """The line of each lane; those too near to an oncoming lane are moved to the kerb."""
    dense = np.concatenate([_sampled(lane.centerline) for lane in lanes])
    tree = cKDTree(dense[:, :2])
    lines: dict[str, FloatArray] = {}
    for lane in lanes:
        step = np.gradient(lane.centerline, axis=0)
        along = step / np.maximum(np.hypot(*step.T), 1e-9)[:, None]
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        line = lane.centerline.copy()
        least_m = max(ONCOMING_M, lane.width_m / 2 + BESIDE_M)
        for k, others in enumerate(tree.query_ball_point(line, least_m)):
            beside = dense[others]
            beside = beside[beside[:, 2:] @ along[k] < OPPOSED]
            if len(beside):
                across = np.abs((beside[:, :2] - line[k]) @ left[k]).min()
                aside = max(least_m - across, 0.0) / 2 * left[k]
                line[k] += aside if left_hand else -aside
        lines[lane.id] = line
    return lines


def _sampled(line: FloatArray) -> FloatArray:
    """(k, 4) points of a line at most `SAMPLE_M` apart, and the direction at each."""
    parts = [np.zeros((0, 4))]
    for start, direction, size, _ in zip(*pieces_of(line), strict=True):
        along = np.linspace(0.0, size, math.ceil(size / SAMPLE_M) + 1)[:, None]
        parts.append(np.hstack([start + along * direction, np.tile(direction, (len(along), 1))]))
    return np.concatenate(parts)


def _without(links: list[_Link], loops: set[str]) -> list[_Link]:
    """The ways between edges, with those that lead over some edges joined to one each."""
    kept = [link for link in links if link[0] not in loops and link[2] not in loops]
    onward: dict[tuple[str, int], list[_Link]] = {}
    for link in links:
        if link[0] in loops:
            onward.setdefault(link[:2], []).append(link)
    for link in links:
        if link[0] in loops or link[2] not in loops:
            continue
        seen, queue = {link[2:4]}, [link[2:4]]
        while queue:
            for then in onward.get(queue.pop(), ()):
                if then[2] not in loops:
                    kept.append((*link[:2], *then[2:4], link[4] or then[4]))
                elif then[2:4] not in seen:
                    seen.add(then[2:4])
                    queue.append(then[2:4])
    return kept


def _nodes(
    edges: dict[str, list[Lane]], lines: dict[str, FloatArray], links: list[_Link]
) -> tuple[dict[tuple[str, bool], str], list[str]]:
    """The node of each end of an edge, and the nodes' elements."""
    ends = [(edge, end) for edge in edges for end in (False, True)]
    points = np.array(
        [
            np.mean([lines[lane.id][-1 if end else 0] for lane in edges[edge]], axis=0)
            for edge, end in ends
        ]
    )
    number = {end: i for i, end in enumerate(ends)}
    meet = [(number[one, True], number[then, False]) for one, _, then, _, _ in links if one != then]
    cells: dict[tuple[int, int], int] = {}
    for i, (x, y) in enumerate(points):
        other = cells.setdefault((math.floor(x / MEET_M), math.floor(y / MEET_M)), i)
        if ends[other][0] != ends[i][0]:
            meet.append((other, i))
    begin, end = np.array(meet, dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(begin.size), (begin, end)), shape=(len(ends), len(ends)))
    _, group = connected_components(graph, directed=False)
    lit = {group[number[one, True]] for one, _, _, _, signal in links if signal}
    of_end: dict[tuple[str, bool], str] = {}
    rows = []
    for node, which in enumerate(dict.fromkeys(group.tolist())):
        members = np.flatnonzero(group == which)
        x, y = np.mean(points[members], axis=0)
        kind = "traffic_light" if which in lit else "priority"
        rows.append(f'    <node id="n{node}" x="{x:.2f}" y="{y:.2f}" type="{kind}"/>')
        of_end |= dict.fromkeys((ends[i] for i in members), f"n{node}")
    return of_end, rows


def _edge(
    name: str, begin: str, end: str, lanes: list[Lane], lines: dict[str, FloatArray]
) -> Iterable[str]:
    """An edge's element with a lane's element for each of its lanes."""
    shapes = [_shape(lines[lane.id]) for lane in lanes]
    yield (
        f'    <edge id="{name}" from="{begin}" to="{end}" numLanes="{len(lanes)}" '
        f'priority="1" spreadType="center" shape="{shapes[len(lanes) // 2]}">'
    )
    for i, (lane, shape) in enumerate(zip(lanes, shapes, strict=True)):
        limit = lane.speed_limit_mps
        speed = limit if math.isfinite(limit) and limit > 0 else LIMIT_MPS
        yield (
            f'        <lane index="{i}" speed="{speed:.2f}" width="'
            f'{max(lane.width_m, LEAST_WIDTH_M):.2f}" disallow="pedestrian" shape="{shape}"/>'
        )
    yield "    </edge>"


def _shape(line: FloatArray) -> str:
    """A line as SUMO writes it, without points that coincide."""
    kept = [line[0]]
    for point in line[1:]:
        if math.dist(point, kept[-1]) > 0.05:
            kept.append(point)
    if len(kept) == 1:
        kept.append(line[0] + np.array([LEAST_LENGTH_M, 0.0]))
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in kept)
