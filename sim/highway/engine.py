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
from typing import Any, Final, NamedTuple

import numpy as np

from behaviors.errors import InputError
from sim.frames import AgentKind, Frame
from sim.highway.lanes import Stretch
from sim.highway.network import HighwayNetwork, build_network
from sim.highway.tables import IntArray
from sim.highway.traffic import TrafficRoad
from sim.highway.vehicle import driver_rows
from sim.highway.walkers import walker_row
from sim.road import Road
from sim.scenario import AgentSpec, CarFollowing, Scenario

LONGEST_STEP_S: Final = 0.1
"""highway-env's own step is at most this long; frames further apart are made of several steps."""


LONGEST_WAIT_S: Final = 60.0
"""An agent that finds no room for this long does not enter (as in the SUMO engine)."""


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
    """Those who begin on one stretch towards the same next one, as agents and their rows.

    ``lanes`` has the numbers of the lanes that lead there; ``then`` is that stretch, or -1.
    """

    waiting: deque[tuple[AgentSpec, Any]]
    lanes: IntArray
    then: int


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
        self, road: TrafficRoad, agents: Sequence[AgentSpec], seed: int, law: CarFollowing = "IDM"
    ) -> None:
        self.road = road
        self._walking: deque[tuple[float, Any]] = deque()
        self._queues: dict[tuple[Stretch, ...], _Queue] = {}
        ways: dict[tuple[str, ...], tuple[Stretch, ...]] = {}
        driving = []
        for agent in sorted(agents, key=lambda a: (a.depart_s, a.id)):
            if agent.kind is AgentKind.PEDESTRIAN:
                number = road.footway_number(agent.route)
                row = walker_row(agent, road.footways[number], number, seed)
                self._walking.append((agent.depart_s, row))
            elif agent.profile is None:
                raise InputError(
                    f"agent {agent.id}: found no profile, expected one for a {agent.kind}"
                )
            else:
                driving.append(agent)
        rows = driver_rows(driving, seed, law)
        for agent, row in zip(driving, rows, strict=True):
            if agent.route not in ways:
                ways[agent.route] = tuple(road.network_info.stretches(agent.route))
            way = ways[agent.route]
            row["route"], road.behaviors[agent.id] = road.route_number(way), agent.behavior
            if way[:2] not in self._queues:
                network, then = road.network_info, way[1] if len(way) > 1 else None
                lanes = [network.number[lane] for lane in network.lanes_towards(way[0], then)]
                leads_to = -1 if then is None else network.stretch_number[then]
                self._queues[way[:2]] = _Queue(deque(), np.array(lanes), leads_to)
            self._queues[way[:2]].waiting.append((agent, row))

    def enter(self) -> None:
        """Let in the agents whose departure has come if there is room, in order of departure."""
        road, now = self.road, self.road.time_s
        while self._walking and self._walking[0][0] <= now:
            road.add(self._walking.popleft()[1])
        ready = [
            (q.waiting[0][0].depart_s, q.waiting[0][0].id, q)
            for q in self._queues.values()
            if q.waiting and q.waiting[0][0].depart_s <= now
        ]
        for _, _, queue in sorted(ready, key=lambda one: one[:2]):
            while queue.waiting and queue.waiting[0][0].depart_s <= now:
                agent, row = queue.waiting[0]
                waits = now - agent.depart_s <= LONGEST_WAIT_S
                if waits and not road.begin(row, queue.lanes, queue.then):
                    break
                queue.waiting.popleft()
