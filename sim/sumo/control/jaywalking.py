"""Jaywalking: pedestrians walk from the sidewalk straight over the road when they find a gap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sim.frames import AgentKind, FloatArray
from sim.road import Lane, Road
from sim.scenario import AgentSpec
from sim.sumo.control.drivers import Streets

GAP_MARGIN_S: Final = 1.5
"""Shortest time between a pedestrian leaving a lane and a vehicle reaching it, s."""

SEEN_M: Final = 150.0
"""Pedestrians consider vehicles up to this distance, m."""

KERB_PATIENCE_S: Final = 60.0
"""A pedestrian that finds no gap for this long walks on along the sidewalk, s."""

BEYOND_M: Final = 0.8
"""The walk ends this far beyond the carriageway, on the other sidewalk, m."""

JUNCTION_MARGIN_M: Final = 40.0
"""No jaywalking nearer to a junction or crossing, m."""


@dataclass(slots=True)
class _Jaywalker:
    """A pedestrian that is to jaywalk, and how far it has come."""

    agent: AgentSpec
    at_m: float
    begin: tuple[float, float] = (0.0, 0.0)
    aim: tuple[float, float] = (0.0, 0.0)
    waiting_since_s: float = -1.0
    walked_m: float = -1.0
    done: bool = False


class Jaywalking:
    """Moves jaywalkers over the road, away from any crossing, at every simulation step.

    Attributes:
        speeds: speed of each pedestrian that is moved now, m/s, by name; SUMO does not know it.
        moved: whether a pedestrian was moved in this step.
    """

    def __init__(self, streets: Streets) -> None:
        self._sumo, self._road, self._step_s = streets.sumo, streets.road, streets.step_s
        sidewalks = (lane for lane in reversed(streets.road.lanes) if lane.walking)
        self._sidewalks = {lane.edge: lane for lane in sidewalks}
        self.speeds: dict[str, float] = {}
        self.moved = False
        at = jaywalking_places(streets.road, streets.agents)
        self._walkers = {str(a.id): _Jaywalker(a, at[a.id]) for a in streets.agents if a.id in at}

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Stop jaywalkers at the kerb until there is a gap, then move them over the road."""
        self.moved = False
        self.speeds.clear()
        for name in persons:
            walker = self._walkers.get(name)
            if walker is None or walker.done:
                continue
            if walker.walked_m < 0:
                if walker.waiting_since_s < 0:
                    if not self._has_arrived(name, walker):
                        continue
                    walker.waiting_since_s = time_s
                walker.done = time_s - walker.waiting_since_s > KERB_PATIENCE_S
                if walker.done:
                    continue
                if not self._gap(walker, vehicles):
                    self._place(name, walker, 0.0, 0.0)
                    continue
                walker.walked_m = 0.0
            walker.walked_m += walker.agent.speed_mps * self._step_s
            if walker.walked_m < math.dist(walker.begin, walker.aim):
                self._place(name, walker, walker.walked_m, walker.agent.speed_mps)
                continue
            self.moved = walker.done = True
            while self._sumo.person_getRemainingStages(name) > 1:
                self._sumo.person_removeStage(name, 1)
            self._sumo.person_removeStage(name, 0)

    def _has_arrived(self, name: str, walker: _Jaywalker) -> bool:
        """Whether the pedestrian is at the chosen place; if so, sets both ends of the walk."""
        edge = walker.agent.route[0]
        if self._sumo.person_getRoadID(name) != edge:
            return False
        x, y = self._sumo.person_getPosition(name)
        lane = self._sidewalks[edge]
        direction = _direction(lane)
        along = float((np.array([x, y]) - lane.centerline[0]) @ direction)
        if along < walker.at_m:
            return False
        over = np.array([-direction[1], direction[0]])  # to the left: sidewalks are on the right
        width_m = _width(self._road, np.array([x, y]), direction, over)
        walker.done = width_m == 0.0 or abs(along - walker.at_m) > JUNCTION_MARGIN_M
        ax, ay = (np.array([x, y]) + (width_m + BEYOND_M) * over).tolist()
        walker.begin, walker.aim = (x, y), (ax, ay)
        return not walker.done

    def _gap(self, walker: _Jaywalker, vehicles: Sequence[str]) -> bool:
        """Whether every vehicle will arrive after the pedestrian has left its lane."""
        sumo = self._sumo
        (x, y), (ax, ay) = walker.begin, walker.aim
        width = math.hypot(ax - x, ay - y)
        over = ((ax - x) / width, (ay - y) / width)
        far = SEEN_M**2 + (width + 2.0) ** 2
        for name in vehicles:
            vx, vy = sumo.vehicle_getPosition(name)
            dx, dy = x - vx, y - vy
            if dx * dx + dy * dy > far:
                continue
            angle = math.radians(sumo.vehicle_getAngle(name))
            ahead = dx * math.sin(angle) + dy * math.cos(angle)
            aside = -(dx * over[0] + dy * over[1])
            if not (-20.0 <= ahead <= SEEN_M and -2.0 < aside < width + 2.0):
                continue
            leaves_s = (aside + 2.0) / walker.agent.speed_mps
            enters_s = (aside - 2.0) / walker.agent.speed_mps
            speed = max(sumo.vehicle_getSpeed(name), 3.0)  # a standing vehicle may start
            if ahead < 0:  # beside or past the pedestrian: wait for its rear
                if -ahead < 12.0 + 2.0 and enters_s < 2.0:
                    return False
            elif ahead / speed < leaves_s + GAP_MARGIN_S:
                return False
        return True

    def _place(self, name: str, walker: _Jaywalker, walked_m: float, speed_mps: float) -> None:
        (x, y), (ax, ay) = walker.begin, walker.aim
        share = walked_m / math.hypot(ax - x, ay - y)
        angle = math.degrees(math.atan2(ax - x, ay - y)) % 360.0
        at = x + share * (ax - x), y + share * (ay - y)
        self._sumo.person_moveToXY(name, "", *at, angle, 2, 100.0)
        self.speeds[name] = speed_mps
        self.moved = True


def jaywalking_places(road: Road, agents: Sequence[AgentSpec]) -> dict[int, float]:
    """Where along their first sidewalk jaywalkers cross the road, m, by agent id, if they can.

    The places are away from junctions, and in sight of where vehicles enter.
    """
    walkers = [a for a in agents if a.jaywalks and a.kind is AgentKind.PEDESTRIAN]
    begun = {agent.route[0] for agent in walkers}
    reached = {link.to_lane for link in road.connections}
    entries = [
        lane.centerline[0]
        for lane in road.lanes
        if not (lane.walking or lane.internal or lane.id in reached)
    ]
    places: dict[str, FloatArray] = {}
    for lane in road.lanes:
        if lane.edge in begun and lane.walking and not lane.internal:
            begin, end = lane.centerline[0], lane.centerline[-1]
            along = np.arange(JUNCTION_MARGIN_M, lane.length_m - JUNCTION_MARGIN_M, 5.0)
            points = begin + (end - begin) * along[:, None] / lane.length_m
            away = points[:, None] - np.reshape(entries, (-1, 2))
            seen = np.hypot(away[..., 0], away[..., 1]) >= SEEN_M
            places[lane.edge] = along[seen.all(axis=1)]
    found = {}
    for agent in walkers:
        choice = places.get(agent.route[0])
        if choice is not None and choice.size:
            rng = np.random.default_rng((agent.seed, 5))
            found[agent.id] = float(choice[int(rng.integers(len(choice)))])
    return found


def _direction(lane: Lane) -> FloatArray:
    """(2,) unit vector from the beginning of a lane to its end."""
    between = lane.centerline[-1] - lane.centerline[0]
    return np.asarray(between / np.hypot(*between))


def _width(road: Road, place: FloatArray, direction: FloatArray, over: FloatArray) -> float:
    """How far the road beside a sidewalk reaches from a place on it, m; 0 without a road."""
    farthest = 0.0
    for lane in road.lanes:
        if lane.walking or lane.internal:
            continue
        begin, line = lane.centerline[0], _direction(lane)
        along, aside = float((place - begin) @ line), float((begin - place) @ over)
        parallel = abs(float(line @ direction)) >= 0.99
        within = JUNCTION_MARGIN_M / 2 < along < lane.length_m - JUNCTION_MARGIN_M / 2
        if parallel and within and 0.0 < aside < 40.0:
            farthest = max(farthest, aside + lane.width_m / 2)
    return farthest
