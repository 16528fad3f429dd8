"""Jaywalking: pedestrians walk from the sidewalk straight over the road when they find a gap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sim.frames import AgentKind, FloatArray
from sim.road import Road
from sim.scenario import AgentSpec

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

FASTEST_WALK: Final = 1.5
"""An upper bound of walking speeds, in free speeds, for the earliest time at which a pedestrian can
be at the chosen place."""


@dataclass(slots=True)
class _Jaywalker:
    """A pedestrian that is to jaywalk, and how far it has come."""

    agent: AgentSpec
    at_m: float
    begin: tuple[float, float] = (0.0, 0.0)
    aim: tuple[float, float] = (0.0, 0.0)
    next_check_s: float = 0.0
    reached_edge: bool = False
    waiting_since_s: float = -1.0
    walked_m: float = -1.0
    done: bool = False


class Jaywalking:
    """Moves jaywalkers over the road, away from any crossing, at every simulation step.

    Attributes:
        speeds: speed of each pedestrian that is moved now, m/s, by name.
        moved: whether a pedestrian was moved in this step.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec], step_s: float) -> None:
        self._sumo, self._road, self._step_s = sumo, road, step_s
        self.speeds: dict[str, float] = {}
        self.moved = False
        at = jaywalking_places(road, agents)
        self._walkers = {str(a.id): _Jaywalker(a, at[a.id]) for a in agents if a.id in at}

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
                    if time_s < walker.next_check_s or not self._arrived(name, walker, time_s):
                        continue
                    walker.waiting_since_s = time_s
                walker.done = time_s - walker.waiting_since_s > KERB_PATIENCE_S
                if walker.done:
                    continue
                if not self._gap(walker, vehicles):
                    self._place(name, walker, 0.0, 0.0)
                    continue
                walker.walked_m = 0.0
            self._walk(name, walker)

    def _arrived(self, name: str, walker: _Jaywalker, time_s: float) -> bool:
        """Whether the pedestrian is at the chosen place; if so, sets both ends of the walk."""
        sumo, edge = self._sumo, walker.agent.route[0]
        if sumo.person_getRoadID(name) != edge:
            walker.done = walker.reached_edge  # it has left the edge again
            return False
        walker.reached_edge = True
        place = np.array(sumo.person_getPosition(name))
        lane = next(one for one in self._road.lanes if one.edge == edge and one.walking)
        line = lane.centerline
        direction = (line[-1] - line[0]) / np.hypot(*(line[-1] - line[0]))
        along = float((place - line[0]) @ direction)
        if along < walker.at_m:
            fastest_mps = FASTEST_WALK * walker.agent.speed_mps
            walker.next_check_s = time_s + (walker.at_m - along) / fastest_mps
            return False
        aim = _other_side(self._road, place, direction)
        walker.done = aim is None or abs(along - walker.at_m) > JUNCTION_MARGIN_M
        if aim is not None:
            walker.begin, walker.aim = (float(place[0]), float(place[1])), aim
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

    def _walk(self, name: str, walker: _Jaywalker) -> None:
        walker.walked_m += walker.agent.speed_mps * self._step_s
        if walker.walked_m < math.dist(walker.begin, walker.aim):
            self._place(name, walker, walker.walked_m, walker.agent.speed_mps)
            return
        self.moved = walker.done = True
        while self._sumo.person_getRemainingStages(name) > 1:
            self._sumo.person_removeStage(name, 1)
        self._sumo.person_removeStage(name, 0)

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


def _other_side(road: Road, place: FloatArray, direction: FloatArray) -> tuple[float, float] | None:
    """End of a straight walk from a sidewalk over the road; None without a road."""
    over = np.array([-direction[1], direction[0]])  # to the left: sidewalks are on the right
    farthest = 0.0
    for lane in road.lanes:
        if lane.walking or lane.internal:
            continue
        begin, end = lane.centerline[0], lane.centerline[-1]
        line = (end - begin) / np.hypot(*(end - begin))
        along, aside = float((place - begin) @ line), float((begin - place) @ over)
        parallel = abs(float(line @ direction)) >= 0.99
        within = JUNCTION_MARGIN_M / 2 < along < lane.length_m - JUNCTION_MARGIN_M / 2
        if parallel and within and 0.0 < aside < 40.0:
            farthest = max(farthest, aside + lane.width_m / 2)
    if farthest == 0.0:
        return None
    aim = place + (farthest + BEYOND_M) * over
    return float(aim[0]), float(aim[1])
