"""Pedestrians of the highway engine: their ways on foot.

They keep to the sidewalks of their route and cross where the road has crossings. When they wait and
when they walk is decided by `sim.highway.crossings`.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from behaviors.errors import InputError
from sim.frames import FloatArray
from sim.highway.state import CROSSOVER, FOOTWAY, STEP, WALKER, Footways, listed
from sim.road import Road
from sim.road.cells import boxes_of, near_pairs
from sim.scenario import WALK_START_M, AgentSpec

LINK_M, DETOUR_M = 12.0, 5.0
"""Sidewalk ends and crossing ends this near to each other are joined on foot (the widest corner).
Pedestrians cross a road only if that saves more than the second length."""

SETBACK_M, OFFSET_M = 1.6, 0.6
"""Pedestrians wait this far back from the kerb (out of the way of turning vehicles); a crossover
begins and ends there. They keep up to the second length to either side of the path's middle."""


class Footway(NamedTuple):
    """A pedestrian's whole way: its length, m, and rows of `STEP` and of `CROSSOVER`."""

    length: float
    steps: list[tuple[float, ...]]
    crossovers: list[tuple[Any, ...]]


@functools.lru_cache(maxsize=256)
def find_footway(road: Road, route: tuple[str, ...]) -> Footway:
    """The way on foot along a route of edges: its sidewalks and the shortest way between them.

    It is found once for each road and route, and kept.

    Raises:
        InputError: if an edge has no sidewalk or two cannot be joined by crossings.
    """
    sidewalks = {lane.edge: lane for lane in road.lanes if lane.walking and not lane.internal}
    lines = []
    for edge in route:
        if edge not in sidewalks:
            raise InputError(f"route: found edge {edge!r} without sidewalk, expected one with")
        lines.append(sidewalks[edge].centerline)
    ends = _orient(lines)
    begin, leave = ends[0]
    share = min(1.0, WALK_START_M / max(float(np.hypot(*(begin - leave))), 1e-9))
    way = [(leave, -1, True)]
    for (_, leave), (enter, onward) in itertools.pairwise(ends):
        way += [*_walk(road, leave, enter), (onward, -1, True)]
    points = [ends[0][1] + share * (begin - ends[0][1])]
    crossed: list[tuple[int, int, int, bool]] = []  # with its first and its last point
    for xy, crossing, forward in way:
        before = len(points) - 1
        if np.hypot(*(xy - points[-1])) > 1e-6:
            points.append(xy)
        if crossing >= 0:
            crossed.append((crossing, before, len(points) - 1, forward))
    line = np.array(points) * np.array([1.0, -1.0])
    size = np.hypot(*np.diff(line, axis=0).T)
    at = np.concatenate([[0.0], np.cumsum(size)]).tolist()
    ahead = (np.diff(line, axis=0) / size[:, None]).tolist()
    return Footway(
        at[-1],
        [
            (*xy, *along, math.atan2(along[1], along[0]), begins)
            for xy, along, begins in zip(line[:-1].tolist(), ahead, at, strict=False)
        ],
        [(crossing, at[i], at[j], forward) for crossing, i, j, forward in crossed],
    )


def _orient(lines: list[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
    """Beginning and end of each sidewalk, in the order that connects the route."""
    found: list[tuple[FloatArray, FloatArray]] = []
    for line, after in itertools.zip_longest(lines, lines[1:]):
        a, b = line[0], line[-1]
        if after is not None:
            far = [min(math.dist(p, a), math.dist(p, b)) for p in (after[0], after[-1])]
            to = after[0] if far[0] <= far[1] else after[-1]
            turned = math.dist(b, to) > math.dist(a, to)
        else:
            before = found[-1][1] if found else a
            turned = math.dist(a, before) > math.dist(b, before)
        found.append((b, a) if turned else (a, b))
    return found


def _walk(road: Road, begin: FloatArray, end: FloatArray) -> list[tuple[FloatArray, int, bool]]:
    """Points from one place to another: (point, crossing walked to reach it or -1, forward)."""
    ends = [begin, end]
    for each in road.crossings:
        line = each.centerline
        for kerb, inside in ((line[0], line[1]), (line[-1], line[-2])):
            ends.append(kerb + SETBACK_M * (kerb - inside) / np.hypot(*(kerb - inside)))
    places = np.array(ends)
    near = KDTree(places).query_pairs(LINK_M, output_type="ndarray")
    near = near[~_runs_over_a_lane(road, places[near])]
    near = near[(near[:, 0] < 2) | (near[:, 0] // 2 != near[:, 1] // 2)]
    first = np.arange(2, len(places), 2)
    pairs = np.concatenate([near, np.column_stack([first, first + 1])])
    cost = np.hypot(*(places[pairs[:, 0]] - places[pairs[:, 1]]).T)
    cost[len(near) :] += DETOUR_M
    shape = (len(places), len(places))
    graph = coo_array((np.maximum(cost, 1e-9), (pairs[:, 0], pairs[:, 1])), shape=shape)
    away, before = dijkstra(graph.tocsr(), directed=False, indices=[0], return_predecessors=True)
    if not np.isfinite(away[0, 1]):
        raise InputError(
            f"route: found no way on foot from {np.round(begin, 1)} to {np.round(end, 1)}, "
            f"expected crossings of road {road.name!r} to join them"
        )
    way: list[tuple[FloatArray, int, bool]] = []
    j = 1
    while j != 0:
        i = int(before[0, j])
        crosses = i >= 2 and j >= 2 and i // 2 == j // 2
        way.append((places[j], (i - 2) // 2 if crosses else -1, i < j))
        j = i
    return way[::-1]


def _runs_over_a_lane(road: Road, links: FloatArray) -> NDArray[np.bool_]:
    """Whether each straight way, of (n, 2, 2) beginnings and ends, meets a lane's centre line."""
    lines = [lane.centerline for lane in road.lanes if not lane.walking]
    pieces = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    pairs = near_pairs(boxes_of(list(links), 0.0), boxes_of(list(pieces), 0.0), LINK_M)
    (a, b), (p, q) = (ends[pairs[:, i]].swapaxes(0, 1) for i, ends in enumerate((links, pieces)))
    step, other, gap = b - a, q - p, p - a
    det = step[:, 0] * other[:, 1] - step[:, 1] * other[:, 0]
    det = np.where(np.abs(det) > 1e-12, det, np.nan)  # NaN where they are parallel
    t = (gap[:, 0] * other[:, 1] - gap[:, 1] * other[:, 0]) / det
    u = (gap[:, 0] * step[:, 1] - gap[:, 1] * step[:, 0]) / det
    meets = np.zeros(len(links), bool)
    meets[pairs[(t > 0) & (t < 1) & (u >= 0) & (u <= 1), 0]] = True
    return meets


def footways_of(footways: Sequence[Footway]) -> Footways:
    """Ways on foot as arrays."""
    ways = np.zeros(len(footways), FOOTWAY)
    ways["length"] = [way.length for way in footways]
    steps = listed(ways, "step", [way.steps for way in footways], STEP)
    crossovers = listed(ways, "crossover", [way.crossovers for way in footways], CROSSOVER)
    return Footways(ways, steps, crossovers)


def walker_row(spec: AgentSpec, footway: Footway, number: int, seed: int) -> Any:
    """The row of `WALKER` of a pedestrian at the beginning of a way of this number."""
    row = np.zeros(1, WALKER)[0]
    aside = float(np.random.default_rng((seed, spec.seed)).uniform(-OFFSET_M, OFFSET_M))
    x, y, ahead, beside, row["heading"], _ = footway.steps[0]
    row["x"], row["y"] = x + aside * -beside, y + aside * ahead
    row["agent"], row["kind"], row["crashed_at"] = spec.id, spec.kind.code, math.inf
    row["length"], row["width"], row["free_speed"] = spec.length_m, spec.width_m, spec.speed_mps
    row["way"], row["aside"] = number, aside
    return row
