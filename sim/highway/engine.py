"""Runs a scenario in highway-env and yields `Frame`s.

Drawn agents enter the road at their departure times, as soon as there is room.

References:
    Leurent (2018), An environment for autonomous driving decision-making (highway-env).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from behaviors.driver_models import braking_speed, krauss_safe_speed
from behaviors.errors import InputError
from behaviors.profiles import Profile
from sim.frames import AgentKind, Frame
from sim.highway.driving import idm
from sim.highway.junctions import BEND_BRAKING, BEND_FACTOR
from sim.highway.lanes import LaneIndex, Stretch
from sim.highway.network import HighwayNetwork, build_network
from sim.highway.tables import IntArray
from sim.highway.traffic import TrafficRoad
from sim.highway.vehicle import ProfileVehicle
from sim.highway.walkers import Walker
from sim.road import Road
from sim.scenario import AgentSpec, CarFollowing, Scenario

LONGEST_STEP_S: Final = 0.1
"""highway-env's own step is at most this long; frames further apart are made of several steps."""


LONGEST_WAIT_S: Final = 60.0
"""An agent that finds no room for this long does not enter (as in the SUMO engine)."""

ENTRY_BRAKING_MPS2: Final = 1.0
"""Agents enter at a speed at which keeping the headway to the vehicle ahead takes no more braking
than this."""


@functools.lru_cache(maxsize=8)
def network_of(road: Road) -> HighwayNetwork:
    """The highway-env network of a road, built on first use and kept; nothing changes it.

    highway-env drives on the right: a road with left-hand traffic is driven in its mirror.
    """
    return build_network(road.mirrored if road.left_hand else road)


def run(
    scenario: Scenario, agents: Sequence[AgentSpec], seed: int, law: CarFollowing = "IDM"
) -> Iterator[Frame]:
    """Drive a scenario in highway-env.

    Args:
        scenario: the road, the duration and the step.
        agents: who travels, as drawn by `sim.scenario.sample_agents`.
        seed: of the drivers' random numbers; the same seed gives the same frames to the bit.
        law: the car-following law of all drivers.

    Yields:
        Frames from time ``step_s`` to ``duration_s``; without agents that found no room.

    Raises:
        InputError: if the agents, the seed or the road are not usable.
    """
    if not 0 <= seed < 2**31:
        raise InputError(f"seed: found {seed}, expected an integer from 0 to 2**31 - 1")
    if len({a.id for a in agents}) != len(agents):
        raise InputError("agents: found an id twice, expected unique ids")
    road = TrafficRoad(network_of(scenario.road))
    demand = Demand(road, agents, seed, law)
    frames = _frames(scenario, road, demand)
    return map(_mirrored, frames) if scenario.road.left_hand else frames


def run_krauss(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
    """Drive a scenario in highway-env as `run` does; drivers follow by Krauss's law.

    A model that is trained on both depends less on either. Both weigh lane changes by IDM.
    """
    return run(scenario, agents, seed, "Krauss")


def _mirrored(frame: Frame) -> Frame:
    """A frame in a mirror along the x axis, as left-hand traffic is driven."""
    heading = np.where(frame.heading == np.pi, np.pi, -frame.heading)
    return dataclasses.replace(frame, xy=frame.xy * np.array([1.0, -1.0]), heading=heading)


def _frames(scenario: Scenario, road: TrafficRoad, demand: Demand) -> Iterator[Frame]:
    steps = math.ceil(scenario.step_s / LONGEST_STEP_S - 1e-9)
    for index in range(1, scenario.steps + 1):
        for _ in range(steps):
            demand.enter()
            road.advance(scenario.step_s / steps)
        road.time_s = index * scenario.step_s  # no rounding adds up
        yield road.frame()


class _Queue(NamedTuple):
    """Those who begin on one stretch towards the same next one; the lanes on which they may."""

    waiting: deque[AgentSpec]
    lanes: list[LaneIndex]
    numbers: IntArray
    bends: list[tuple[float, float, bool]]

    @classmethod
    def on(cls, network: HighwayNetwork, way: tuple[Stretch, ...]) -> _Queue:
        """Nobody yet; for each lane its length, the limit of the path after it, and who waits."""
        then, number = way[1] if len(way) > 1 else None, network.number
        lanes, bends = network.lanes_towards(way[0], then), []
        for lane in lanes:
            path = None if then is None else network.onward.get((lane, then))
            limit, waits = math.inf, False
            if path is not None:
                link, limit = network.links[path], float(network.lanes[path].speed_limit)
                waits = link.signal >= 0 or link.must_yield or link.must_stop
            bends.append((float(network.lanes[lane].length), limit, waits))
        return cls(deque(), lanes, np.array([number[lane] for lane in lanes]), bends)


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
        self.road, self.seed, self._law = road, seed, law
        self._ways: dict[tuple[str, ...], tuple[Stretch, ...]] = {}
        self._walking: deque[AgentSpec] = deque()
        self._queues: dict[tuple[Stretch, ...], _Queue] = {}
        self._next: dict[int, ProfileVehicle] = {}
        network = road.network_info
        for agent in sorted(agents, key=lambda a: (a.depart_s, a.id)):
            if agent.kind is AgentKind.PEDESTRIAN:
                road.footway_number(agent.route)
                self._walking.append(agent)
                continue
            if agent.profile is None:
                raise InputError(
                    f"agent {agent.id}: found no profile, expected one for a {agent.kind}"
                )
            if agent.route not in self._ways:
                self._ways[agent.route] = tuple(network.stretches(agent.route))
            way = self._ways[agent.route][:2]
            if way not in self._queues:
                self._queues[way] = _Queue.on(network, way)
            self._queues[way].waiting.append(agent)

    def enter(self) -> None:
        """Let in the agents whose departure has come if there is room, in order of departure."""
        road, now = self.road, self.road.time_s
        while self._walking and self._walking[0].depart_s <= now:
            agent = self._walking.popleft()
            number = road.footway_number(agent.route)
            road.add(Walker(agent, road.footways[number], number, (self.seed, agent.seed)))
        ready = [q for q in self._queues.values() if q.waiting and q.waiting[0].depart_s <= now]
        for queue in sorted(ready, key=lambda q: (q.waiting[0].depart_s, q.waiting[0].id)):
            while queue.waiting and queue.waiting[0].depart_s <= now:
                agent = queue.waiting[0]
                if now - agent.depart_s <= LONGEST_WAIT_S:
                    vehicle = self._next.get(agent.id) or self._vehicle(agent)
                    if not self._place(vehicle, queue):
                        break
                    road.add(vehicle)
                queue.waiting.popleft()
                self._next.pop(agent.id, None)

    def _vehicle(self, agent: AgentSpec) -> ProfileVehicle:
        """The vehicle of an agent that waits to enter."""
        way, seed = self._ways[agent.route], (self.seed, agent.seed)
        self._next[agent.id] = ProfileVehicle(self.road, agent, way, seed, self._law)
        return self._next[agent.id]

    def _place(self, vehicle: ProfileVehicle, queue: _Queue) -> bool:
        """Place a vehicle on the lane with most room, and say whether there is any."""
        me, profile, length = vehicle.table[0], vehicle.profile, vehicle.spec.length_m
        top_speed = float(vehicle.table["top_speed"][0])
        best: tuple[float, float, LaneIndex] | None = None
        room_at = self.road.room_at_entry(queue.numbers, length)
        for lane, bend, gap, ahead in zip(queue.lanes, queue.bends, *room_at, strict=True):
            limit = float(self.road.network_info.lanes[lane].speed_limit)
            wanted = min(profile.speed_factor * limit, top_speed)
            speed = min(wanted, _speed_to_slow_down(profile, bend, length))
            if gap < math.inf:
                room, headway_s = gap - profile.min_gap_m, profile.time_headway_s
                if idm(me, speed, wanted, gap, ahead) < -ENTRY_BRAKING_MPS2:
                    safe = krauss_safe_speed(room, ahead, headway_s, ENTRY_BRAKING_MPS2)
                    speed = min(speed, max(ahead, safe))
                if room < headway_s * speed:
                    continue
            if best is None or gap > best[0]:
                best = (gap, float(speed), lane)
        if best is not None:
            vehicle.put(best[2], length / 2, best[1])
        return best is not None


def _speed_to_slow_down(profile: Profile, bend: tuple[float, float, bool], length: float) -> float:
    """The speed from which a driver can stop or take the bend at the end of its lane, m/s."""
    lane_length, limit, waits = bend
    if limit == math.inf:
        return math.inf
    allowed = 0.0 if waits else min(profile.speed_factor, BEND_FACTOR) * limit
    left = max(lane_length - length, 0.0)
    return braking_speed(left, allowed, BEND_BRAKING * profile.comfort_decel_mps2)
