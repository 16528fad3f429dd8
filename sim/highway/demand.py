"""Lets drawn agents enter the road at their departure times, as soon as there is room."""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Sequence
from typing import Final

from behaviors.driver_models import braking_speed, krauss_safe_speed
from behaviors.errors import InputError
from sim.frames import AgentKind, FloatArray
from sim.highway import driving, junctions
from sim.highway.lanes import LaneIndex
from sim.highway.traffic import TrafficRoad
from sim.highway.vehicle import Driver, ProfileVehicle
from sim.highway.walkers import Footway, Walker, find_footway
from sim.scenario import AgentSpec, CarFollowing

LONGEST_WAIT_S: Final = 60.0
"""An agent that finds no room for this long does not enter (as in the SUMO engine)."""

ENTRY_BRAKING_MPS2: Final = 1.0
"""Agents enter at a speed at which keeping the headway to the vehicle ahead takes no more braking
than this."""


class Demand:
    """The agents still to come.

    Args:
        road: where they will travel.
        agents: in any order.
        seed: mixed into every driver's own random numbers.
        law: the car-following law of all drivers.

    Raises:
        InputError: if a route is not of this road, or a driver has no profile.
    """

    def __init__(
        self,
        road: TrafficRoad,
        agents: Sequence[AgentSpec],
        seed: int,
        law: CarFollowing = "IDM",
    ) -> None:
        self.road = road
        self.seed = seed
        self._law = law
        self._footways: dict[tuple[str, ...], Footway] = {}
        self._stretches: dict[tuple[str, ...], tuple[tuple[str, str], ...]] = {}
        self._walking: deque[AgentSpec] = deque()
        self._queues: dict[tuple[tuple[str, str], ...], deque[AgentSpec]] = {}
        for agent in sorted(agents, key=lambda a: (a.depart_s, a.id)):
            if agent.kind is AgentKind.PEDESTRIAN:
                if agent.route not in self._footways:
                    self._footways[agent.route] = find_footway(road.network_info.road, agent.route)
                self._walking.append(agent)
                continue
            if agent.profile is None:
                raise InputError(
                    f"agent {agent.id}: found no profile, expected one for a {agent.kind}"
                )
            if agent.route not in self._stretches:
                self._stretches[agent.route] = tuple(road.network_info.stretches(agent.route))
            way = self._stretches[agent.route]
            self._queues.setdefault((way[0], *way[1:2]), deque()).append(agent)

    def copied(self, road: TrafficRoad) -> Demand:
        """The agents still to come, to a copy of the road."""
        made = copy.copy(self)
        made.road, made._walking = road, self._walking.copy()
        made._queues = {way: queue.copy() for way, queue in self._queues.items()}
        return made

    def enter(self) -> None:
        """Let in the agents whose departure has come if there is room, in order of departure."""
        road, now = self.road, self.road.time_s
        while self._walking and self._walking[0].depart_s <= now:
            agent = self._walking.popleft()
            walker = Walker(agent, self._footways[agent.route], (self.seed, agent.seed))
            road.walkers.append(walker)
            road.objects.append(walker)
        waiting = [queue for queue in self._queues.values() if queue and queue[0].depart_s <= now]
        for queue in sorted(waiting, key=lambda q: (q[0].depart_s, q[0].id)):
            while queue and queue[0].depart_s <= now:
                agent = queue[0]
                if now - agent.depart_s > LONGEST_WAIT_S:
                    queue.popleft()
                    continue
                vehicle = self._place(agent)
                if vehicle is None:
                    break
                queue.popleft()
                road.vehicles.append(vehicle)

    def _place(self, agent: AgentSpec) -> ProfileVehicle | None:
        """The vehicle on the lane with most room, or None if there is none."""
        road, network = self.road, self.road.network_info
        way = self._stretches[agent.route]
        then = way[1] if len(way) > 1 else None
        assert agent.profile is not None
        driver = driving.driver_parameters(agent.profile, agent.kind)
        best: tuple[float, float, LaneIndex] | None = None
        for lane in network.lanes_towards(way[0], then):
            gap, ahead = road.room_at_entry(lane, agent.length_m)
            limit = float(network.lanes[lane].speed_limit)
            wanted = min(driver[driving.SPEED_FACTOR] * limit, driver[driving.TOP_SPEED])
            speed = min(wanted, self._speed_to_slow_down(lane, then, agent.length_m, driver))
            if gap < math.inf:
                headway = driver[driving.TIME_HEADWAY]
                room = gap - driver[driving.MIN_GAP]
                if driving.idm(driver, speed, wanted, gap, ahead) < -ENTRY_BRAKING_MPS2:
                    safe = krauss_safe_speed(room, ahead, headway, ENTRY_BRAKING_MPS2)
                    speed = min(speed, max(ahead, safe))
                if room < headway * speed:
                    continue
            if best is None or gap > best[0]:
                best = (gap, float(speed), lane)
        if best is None:
            return None
        _, speed, lane = best
        geometry = network.lanes[lane]
        s = agent.length_m / 2
        return ProfileVehicle(
            road,
            geometry.position(s, 0.0),
            geometry.heading_at(s),
            speed,
            driver=Driver(agent.profile, agent.behavior, self._law, (self.seed, agent.seed)),
            kind=agent.kind,
            length=agent.length_m,
            width=agent.width_m,
            agent=agent.id,
            lane_index=lane,
            stretches=way,
        )

    def _speed_to_slow_down(
        self, lane: LaneIndex, then: tuple[str, str] | None, length: float, driver: FloatArray
    ) -> float:
        """The speed from which a driver can slow down for the end of the lane that it enters, m/s.

        It can stop there for a light, a sign or others with priority, and take the bend.
        """
        network = self.road.network_info
        path = None if then is None else network.onward.get((lane, then))
        if path is None:
            return math.inf
        info, factor = network.info[path], float(driver[driving.SPEED_FACTOR])
        waits = info.signal >= 0 or info.must_yield or info.must_stop
        bend = min(factor, junctions.BEND_FACTOR) * float(network.lanes[path].speed_limit)
        left = max(float(network.lanes[lane].length) - length, 0.0)
        braking = junctions.BEND_BRAKING * float(driver[driving.COMFORT_DECEL])
        return braking_speed(left, 0.0 if waits else bend, braking)
