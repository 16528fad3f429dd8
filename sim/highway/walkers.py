"""Pedestrians of the highway engine: their ways on foot, and where they are on them.

They keep to the sidewalks of their route and cross where the road has crossings. When they wait and
when they walk is decided by `sim.highway.crossings`.
"""

from __future__ import annotations

import bisect
import functools
import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from highway_env.vehicle.objects import Landmark
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.frames import AgentKind
from sim.highway.tables import Records, listed, record_type
from sim.highway.vehicle import column, move_to, position_of
from sim.road import Road
from sim.scenario import WALK_START_M, AgentSpec

FloatArray = NDArray[np.float64]

LINK_M: Final = 12.0
"""Sidewalk ends and crossing ends this near to each other are joined on foot (the widest
corner)."""

SETBACK_M: Final = 1.6
"""Pedestrians wait this far back from the kerb, m (out of the way of turning vehicles); a crossover
begins and ends there."""

OFFSET_M: Final = 0.6
"""Pedestrians keep up to this far to either side of the path's middle, m."""


@dataclass(frozen=True, slots=True)
class Crossover:
    """A stretch of a pedestrian's way that is a crossing.

    Attributes:
        crossing: index into ``Road.crossings``.
        begin_s: distance along the way at which the pedestrian waits before it, m.
        end_s: at which the pedestrian has left it, m.
        forward: whether it is walked along its centre line, not against it.
    """

    crossing: int
    begin_s: float
    end_s: float
    forward: bool


@dataclass(frozen=True)
class Footway:
    """A pedestrian's whole way.

    Attributes:
        points: (P, 2) in highway-env's axes, m.
        at: (P,) distance along the way of each point, m.
        crossovers: the crossings on it, in order.
    """

    points: FloatArray
    at: FloatArray
    crossovers: tuple[Crossover, ...]

    @property
    def length(self) -> float:
        """How long it is, m."""
        return float(self.at[-1])

    @functools.cached_property
    def pieces(self) -> list[tuple[float, float, float, float, float]]:
        """The beginning of each piece, m, its direction, and its heading, rad."""
        found = []
        for begin, end in itertools.pairwise(self.points):
            x, y = (end - begin) / np.hypot(*(end - begin))
            found.append((float(begin[0]), float(begin[1]), float(x), float(y), math.atan2(y, x)))
        return found

    @functools.cached_property
    def _begins(self) -> list[float]:
        begins: list[float] = self.at.tolist()
        return begins

    def place(self, s: float, aside: float) -> tuple[FloatArray, float]:
        """Position, m, and heading, rad, at a distance along the way."""
        i = min(max(bisect.bisect_right(self._begins, s) - 1, 0), len(self._begins) - 2)
        x, y, ahead, beside, heading = self.pieces[i]
        along = s - self._begins[i]
        xy = (x + ahead * along + aside * -beside, y + beside * along + aside * ahead)
        return np.array(xy), heading


@functools.lru_cache(maxsize=256)
def find_footway(road: Road, route: tuple[str, ...]) -> Footway:
    """The way on foot along a route of edges: its sidewalks and the shortest way between them.

    It is found once for each road and route, and kept.

    Args:
        road: where it is.
        route: edge ids; each edge must have a sidewalk.

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
    points = [leave + share * (begin - leave), leave]
    crossed: list[tuple[int, int, bool]] = []  # point index at which it begins
    for (_, leave), (enter, onward) in itertools.pairwise(ends):
        for xy, crossing, forward in _walk(road, leave, enter):
            if crossing >= 0:
                crossed.append((len(points) - 1, crossing, forward))
            points.append(xy)
        points.append(onward)
    kept, index_of = [0], {0: 0}
    for i in range(1, len(points)):
        if np.hypot(*(points[i] - points[kept[-1]])) > 1e-6:
            kept.append(i)
        index_of[i] = len(kept) - 1
    line = np.array([points[i] for i in kept]) * np.array([1.0, -1.0])
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    return Footway(
        points=line,
        at=at,
        crossovers=tuple(
            Crossover(c, float(at[index_of[i]]), float(at[index_of[i + 1]]), forward)
            for i, c, forward in crossed
        ),
    )


def _orient(lines: list[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
    """Beginning and end of each sidewalk, in the order that connects the route."""
    if len(lines) == 1:
        return [(lines[0][0], lines[0][-1])]
    found = []
    for i, line in enumerate(lines):
        a, b = line[0], line[-1]
        if i + 1 < len(lines):
            then = lines[i + 1]
            to = min((then[0], then[-1]), key=lambda p: min(_far(p, a), _far(p, b)))
            found.append((a, b) if _far(b, to) <= _far(a, to) else (b, a))
        else:
            before = found[-1][1]
            found.append((a, b) if _far(a, before) <= _far(b, before) else (b, a))
    return found


def _unit(step: FloatArray) -> FloatArray:
    return np.asarray(step / np.hypot(*step), dtype=np.float64)


def _far(a: FloatArray, b: FloatArray) -> float:
    return float(np.hypot(*(a - b)))


def _walk(road: Road, begin: FloatArray, end: FloatArray) -> list[tuple[FloatArray, int, bool]]:
    """Points from one place to another: (point, crossing walked to reach it or -1, forward)."""
    places = [begin, end]
    for each in road.crossings:
        line = each.centerline
        places += [
            line[0] - SETBACK_M * _unit(line[1] - line[0]),
            line[-1] + SETBACK_M * _unit(line[-1] - line[-2]),
        ]
    roads = [lane.centerline for lane in road.lanes if not lane.walking]
    best, before = {0: 0.0}, {}
    queue = [(0.0, 0)]
    while queue:
        cost, i = heapq.heappop(queue)
        if i == 1:
            break
        if cost > best.get(i, math.inf):
            continue
        for j, place in enumerate(places):
            crossing = (i - 2) // 2 if i >= 2 and j >= 2 and i != j and i // 2 == j // 2 else -1
            size = _far(places[i], place)
            joined = j != i and size <= LINK_M and not _crosses(places[i], place, roads)
            if crossing < 0 and not joined:
                continue
            new = cost + size + (5.0 if crossing >= 0 else 0.0)  # nobody crosses without need
            if new < best.get(j, math.inf):
                best[j], before[j] = new, (i, crossing)
                heapq.heappush(queue, (new, j))
    if 1 not in before:
        raise InputError(
            f"route: found no way on foot from {np.round(begin, 1)} to {np.round(end, 1)}, "
            f"expected crossings of road {road.name!r} to join them"
        )
    way: list[tuple[FloatArray, int, bool]] = []
    j = 1
    while j != 0:
        i, crossing = before[j]
        way.append((places[j], crossing, i < j))
        j = i
    return way[::-1]


def _crosses(a: FloatArray, b: FloatArray, roads: list[FloatArray]) -> bool:
    """Whether the straight way between two places runs over a lane's centre line."""
    for line in roads:
        p, q = line[:-1], line[1:]
        step, other = b - a, q - p
        det = step[0] * other[:, 1] - step[1] * other[:, 0]
        ok = np.abs(det) > 1e-12
        gap = p - a
        t = np.full(len(p), -1.0)
        u = np.full(len(p), -1.0)
        t[ok] = (gap[ok, 0] * other[ok, 1] - gap[ok, 1] * other[ok, 0]) / det[ok]
        u[ok] = (gap[ok, 0] * step[1] - gap[ok, 1] * step[0]) / det[ok]
        if ((t > 0) & (t < 1) & (u >= 0) & (u <= 1)).any():
            return True
    return False


WALKER: Final = record_type(
    agent="i8", length="f8", width="f8", x="f8", y="f8", heading="f8", speed="f8",
    way="i8", s="f8", aside="f8", free_speed="f8", crossed="i8", stood_s="f8",
    crashed="?", struck_at="f8", leaves="i8", link="i8",
)  # fmt: skip
"""A pedestrian; lengths in m, times in s, highway-env's axes.

``way``: number of its footway; ``s`` and ``aside``: its place on it; ``crossed``: how many of its
crossings it has passed; ``stood_s``: for how long it has stood; ``leaves``: why it goes; ``link``:
the next one at the same crossing.
"""

FOOTWAY: Final = record_type(
    length="f8", step="i8", step_end="i8", crossover="i8", crossover_end="i8"
)
"""A way on foot, with its straight pieces, `STEP`, and its crossings, `CROSSOVER`."""

STEP: Final = record_type(x="f8", y="f8", dx="f8", dy="f8", heading="f8", begin="f8")
CROSSOVER: Final = record_type(crossing="i8", begin_s="f8", end_s="f8", forward="?")


class Footways(NamedTuple):
    """The ways on foot that pedestrians of a road take, as arrays named after their types."""

    ways: Records
    steps: Records
    crossovers: Records


def footways_of(footways: Sequence[Footway]) -> Footways:
    """Ways on foot as arrays."""
    ways = np.zeros(len(footways), FOOTWAY)
    ways["length"] = [way.length for way in footways]
    steps = [
        [(*piece, at) for piece, at in zip(way.pieces, way.at.tolist(), strict=False)]
        for way in footways
    ]
    crossovers = [
        [(c.crossing, c.begin_s, c.end_s, c.forward) for c in way.crossovers] for way in footways
    ]
    return Footways(
        ways, listed(ways, "step", steps, STEP), listed(ways, "crossover", crossovers, CROSSOVER)
    )


class Walker(Landmark):  # type: ignore[misc]
    """One pedestrian: a view of its row, as an object of highway-env.

    Args:
        agent: the pedestrian.
        footway: its way.
        rng_seed: of how far aside it walks.
    """

    kind = AgentKind.PEDESTRIAN
    position = property(position_of, move_to)
    heading = column("heading", float)
    speed = column("speed", float)
    LENGTH = column("length", float)
    WIDTH = column("width", float)
    agent = column("agent", int)
    s = column("s", float)
    stood_s = column("stood_s", float)
    crashed = column("crashed", bool)
    struck_at = column("struck_at", float)
    free_speed = column("free_speed", float)

    road = lane_index = lane = impact = None
    collidable = False
    solid = check_collisions = hit = False

    def __init__(self, agent: AgentSpec, footway: Footway, rng_seed: tuple[int, ...]) -> None:
        self.table, self.row, self.footway = np.zeros(1, WALKER), 0, footway
        self.LENGTH, self.WIDTH = agent.length_m, agent.width_m
        aside = float(np.random.default_rng(rng_seed).uniform(-OFFSET_M, OFFSET_M))
        self.position, self.heading = footway.place(0.0, aside)
        self.table["aside"] = aside
        self.agent, self.free_speed, self.struck_at = agent.id, agent.speed_mps, math.inf

    @property
    def diagonal(self) -> float:
        """From corner to corner, m."""
        return math.hypot(self.LENGTH, self.WIDTH)

    @property
    def crossover(self) -> Crossover | None:
        """The crossing it is on or comes to next."""
        ways, crossed = self.footway.crossovers, int(self.table["crossed"][self.row])
        return ways[crossed] if crossed < len(ways) else None

    def to_walk(self) -> float:
        """How far to the kerb of the next crossing, m; negative on it, infinite without one."""
        way = self.crossover
        return math.inf if way is None else way.begin_s - self.s
