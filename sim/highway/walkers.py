"""Pedestrians of the highway engine: where they walk, when they step out, how they move.

They keep to the sidewalks of their route and cross where the road has crossings. At a signal they
wait for green; at a zebra they step out when everybody who comes near is far enough, stands or is
seen to let them go; on the way they stop before a lane on which somebody comes who does not.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from highway_env.vehicle.objects import Landmark
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.frames import Signal
from sim.road import Road
from sim.scenario import WALK_START_M, AgentSpec

if TYPE_CHECKING:
    from sim.highway.traffic import TrafficRoad

FloatArray = NDArray[np.float64]

LINK_M: Final = 12.0
"""Sidewalk ends and crossing ends this near to each other are joined on foot (our choice: the
widest corner)."""

KERB_M: Final = 0.4
"""How near the kerb one decides whether to step out, m (our choice: half a stride)."""

SETBACK_M: Final = 1.6
"""How far back from the kerb one waits, m (our choice: out of the way of turning vehicles); a
crossover begins and ends there."""

STRIP_M: Final = 0.1
"""The strip of a lane that is closed to one of vehicles and pedestrians while the other is on it
ends this far inside the lane's edges, m: one can stand between two lanes (our choice)."""

WALKED_M: Final = 1.1
"""Half the width of the middle of a crossing on which pedestrians walk, m (`OFFSET_M`, half a
pedestrian and a little)."""

SPARE_S: Final = 0.7
"""Time to spare a pedestrian wants before a vehicle comes, s (our choice)."""

STOOD_S: Final = 0.8
"""A vehicle that has stood this long before a crossing is taken to be waiting, s (our choice)."""

OFFSET_M: Final = 0.6
"""Pedestrians keep up to this far to either side of the path's middle, m (our choice)."""


@dataclass(frozen=True, slots=True)
class Crossover:
    """A stretch of a pedestrian's way that is a crossing.

    Attributes:
        crossing: index into ``Road.crossings``.
        begin_s: distance along the way at which one waits before it, m.
        end_s: at which one has left it, m.
        forward: whether it is walked along its centre line, not against it.
    """

    crossing: int
    begin_s: float
    end_s: float
    forward: bool

    def along(self, u: float) -> float:
        """Distance from its beginning of a place given along the crossing's line, m."""
        u = u + SETBACK_M
        return u if self.forward else (self.end_s - self.begin_s) - u


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

    def place(self, s: float, aside: float) -> tuple[FloatArray, float]:
        """Position, m, and heading, rad, at a distance along the way."""
        i = int(np.clip(np.searchsorted(self.at, s, side="right") - 1, 0, len(self.at) - 2))
        direction = self.points[i + 1] - self.points[i]
        direction = direction / np.hypot(*direction)
        xy = self.points[i] + direction * (s - self.at[i])
        xy = xy + aside * np.array([-direction[1], direction[0]])
        return xy, math.atan2(direction[1], direction[0])


def find_footway(road: Road, route: Sequence[str]) -> Footway:
    """The way on foot along a route of edges: its sidewalks and the shortest way between them.

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
    """Begin and end of each sidewalk, turned so that the route hangs together."""
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


class Walker(Landmark):  # type: ignore[misc]
    """One pedestrian: an object that moves by itself and is seen by vehicles.

    Args:
        agent: who it is.
        footway: its way.
        rng_seed: of how far aside it walks.
    """

    def __init__(self, agent: AgentSpec, footway: Footway, rng_seed: tuple[int, ...]) -> None:
        self.LENGTH, self.WIDTH = agent.length_m, agent.width_m
        aside = float(np.random.default_rng(rng_seed).uniform(-OFFSET_M, OFFSET_M))
        position, heading = footway.place(0.0, aside)
        super().__init__(None, position, heading, 0.0)
        self.agent = agent.id
        self.footway = footway
        self.s = 0.0
        self.aside = aside
        self.free_speed = agent.speed_mps
        self.crossed = 0
        self.struck_at = math.inf
        self.stood_s = 0.0

    @property
    def arrived(self) -> bool:
        """Whether it is at the end of its way."""
        return self.s >= self.footway.length - 1e-6

    @property
    def crossover(self) -> Crossover | None:
        """The crossing it is on or comes to next."""
        ways = self.footway.crossovers
        return ways[self.crossed] if self.crossed < len(ways) else None

    def to_walk(self) -> float:
        """How far to the kerb of the next crossing, m; negative on it, infinite without one."""
        way = self.crossover
        return math.inf if way is None else way.begin_s - self.s

    def step(self, dt: float, road: TrafficRoad) -> None:
        """Walk on or wait for ``dt`` seconds."""
        speed = 0.0 if self.hit else self.free_speed
        way = self.crossover
        if way is not None and speed > 0.0:
            if self.s < way.begin_s:
                near = way.begin_s - self.s <= max(KERB_M, self.free_speed * dt)
                if near and not self._may_start(road, way):
                    speed = 0.0
            elif not self._may_go_on(road, way, self.free_speed * dt):
                speed = 0.0
        self.speed = speed
        self.stood_s = 0.0 if speed > 0.0 else self.stood_s + dt
        self.s = min(self.s + speed * dt, self.footway.length)
        if way is not None and self.s >= way.end_s:
            self.crossed += 1
        self.position, self.heading = self.footway.place(self.s, self.aside)

    def _strips(self, road: TrafficRoad, way: Crossover) -> list[tuple[float, float, int]]:
        """Begin and end along the way, m, of each lane to cross, and the lane's strip."""
        found = []
        for number, (u, half) in enumerate(road.strips_of[way.crossing]):
            middle = way.begin_s + way.along(u)
            half = strip_half(half)
            found.append((middle - half, middle + half, number))
        return sorted(found)

    def _may_start(self, road: TrafficRoad, way: Crossover) -> bool:
        signal = road.network_info.road.crossings[way.crossing].signal
        lit = signal >= 0 and road.signals[signal] != Signal.OFF.code
        if lit and road.signals[signal] != Signal.GREEN.code:
            return False
        strips = self._strips(road, way)
        return all(self._safe(road, way, strip) for strip in (strips[:1] if lit else strips))

    def _may_go_on(self, road: TrafficRoad, way: Crossover, stride: float) -> bool:
        for begin, end, number in self._strips(road, way):
            if self.s <= begin < self.s + stride and not self._safe(
                road, way, (begin, end, number)
            ):
                return False
        return True

    def _safe(self, road: TrafficRoad, way: Crossover, strip: tuple[float, float, int]) -> bool:
        """Whether nobody comes on a lane while it is being crossed.

        Who waits before the crossing holds those behind it back.
        """
        begin, end, number = strip
        enter = max(begin - self.s, 0.0) / self.free_speed
        leave = (end - self.s) / self.free_speed
        coming = road.arrivals.get((way.crossing, number), ())
        for arrival in sorted(coming, key=lambda each: each.near):
            speed, half = arrival.vehicle.speed, (arrival.far - arrival.near) / 2
            near, far = arrival.near + half - WALKED_M, arrival.far - half + WALKED_M
            clear = (far + arrival.vehicle.LENGTH) / max(speed, 0.5)
            if clear < 0.0 or (speed > 0.5 and clear < enter - 0.2):
                continue  # past it before the pedestrian comes
            if near <= 0.1:
                return False
            yields = way.crossing in arrival.yields or arrival.held
            if (yields and speed * speed <= 2.0 * 5.0 * near) or arrival.stood_s > STOOD_S:
                return True
            comes = (
                (-speed + math.sqrt(speed * speed + 2.0 * near)) if speed < 2.0 else near / speed
            )
            if comes <= leave + SPARE_S:
                return False
        return True


def strip_half(half_width: float) -> float:
    """Half the width of a lane's strip of a crossing, m, for half the lane's width."""
    return half_width - STRIP_M
