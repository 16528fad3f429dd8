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
from sim.compiled import in_place
from sim.frames import AgentKind, Frame, IntArray
from sim.highway.driving import driver_rows, idm, on_free_road, safe_speed
from sim.highway.junctions import BEND_BRAKING, BEND_FACTOR, braking_speed
from sim.highway.lanes import Stretch
from sim.highway.network import HighwayNetwork, build_network
from sim.highway.pedestrians import walker_row
from sim.highway.places import heading_at, last_begun, path_to, project
from sim.highway.state import Net, Scene
from sim.highway.traffic import TrafficRoad, typed_once
from sim.road import Road
from sim.scenario import AgentSpec, CarFollowing, Scenario, check_agents

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
    check_agents(scenario, agents, seed)
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
    """Those who begin on one stretch towards the same next one, or -1, and the lanes there."""

    waiting: deque[tuple[AgentSpec, Any]]
    lanes: IntArray
    then: int


class Demand:
    """The agents still to come to a road; ``seed`` is mixed into their own random numbers.

    Raises:
        InputError: if a route is not of this road, or a driver has no profile.
    """

    def __init__(
        self, road: TrafficRoad, agents: Sequence[AgentSpec], seed: int, law: CarFollowing = "IDM"
    ) -> None:
        self.road, network = road, road.network
        self._walking: deque[tuple[float, Any]] = deque()
        self._queues: dict[tuple[Stretch, ...], _Queue] = {}
        find_way = functools.cache(lambda route: tuple(network.stretches(route)))
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
        for agent, row in zip(driving, driver_rows(driving, seed, law), strict=True):
            way = find_way(agent.route)
            row["route"], road.behaviors[agent.id] = road.route_number(way), agent.behavior
            if way[:2] not in self._queues:
                then = way[1] if len(way) > 1 else None
                lanes = [network.number[lane] for lane in network.lanes_towards(way[0], then)]
                leads_to = -1 if then is None else network.stretch_number[then]
                self._queues[way[:2]] = _Queue(deque(), np.array(lanes, np.int64), leads_to)
            self._queues[way[:2]].waiting.append((agent, row))

    def enter(self) -> None:
        """Let in the agents whose departure has come if there is room, in order of departure."""
        road, now = self.road, self.road.time_s
        while self._walking and self._walking[0][0] <= now:
            road.add(self._walking.popleft()[1])
        due = [q for q in self._queues.values() if q.waiting and q.waiting[0][0].depart_s <= now]
        for queue in sorted(due, key=lambda q: (q.waiting[0][0].depart_s, q.waiting[0][0].id)):
            while queue.waiting and queue.waiting[0][0].depart_s <= now:
                agent, row = queue.waiting[0]
                if now - agent.depart_s <= LONGEST_WAIT_S:
                    road.read_egos()
                    if not _begin(row, queue.lanes, queue.then, road.scene()):
                        break
                    road.add(row)
                queue.waiting.popleft()


@in_place()
def begin(me: Any, lanes: IntArray, then: int, scene: Scene) -> bool:
    """Place a vehicle that goes to a stretch, or -1, on the roomiest of some lanes, if any is."""
    most, found, found_speed = -np.inf, -1, 0.0
    for k in lanes:
        gap, ahead = _room(k, me.length, scene)
        wanted = on_free_road(me, scene.net.lanes[k].limit)
        speed = min(wanted, _speed_to_slow_down(me, k, then, scene.net))
        if gap < np.inf:
            room, headway_s = gap - me.min_gap_m, me.time_headway_s
            if idm(me, speed, wanted, gap, ahead) < -ENTRY_BRAKING_MPS2:
                safe = safe_speed(room, ahead, headway_s, ENTRY_BRAKING_MPS2)
                speed = min(speed, max(ahead, safe))
            if room < headway_s * speed:
                continue
        if gap > most:
            most, found, found_speed = gap, k, speed
    if found >= 0:
        put(me, found, me.length / 2, found_speed, scene.net)
    return found >= 0


@in_place()
def put(me: Any, k: int, s: float, speed: float, net: Net) -> None:
    """Place a vehicle in the middle of a lane, ``s`` m along it, at a speed in m/s."""
    piece = net.pieces[last_begun(s, net.lanes[k].piece, net.lanes[k].piece_end, net.pieces)]
    me.x, me.y = piece.x + (s - piece.begin) * piece.dx, piece.y + (s - piece.begin) * piece.dy
    me.heading, me.speed, me.entry_speed = heading_at(s, k, net), speed, speed
    me.lane = me.target = me.wanted = k
    me.timer = (me.x + me.y) * math.pi % 1.0  # as in highway-env


@in_place(inner=True)
def _room(k: int, length: float, scene: Scene) -> tuple[float, float]:
    """Bumper gap to the first vehicle on a lane or changing to it, m, and its speed along it."""
    lane, gap, speed = scene.net.lanes[k], np.inf, 0.0
    for j in range(scene.vehicles.size):
        other = scene.vehicles[j]
        s, lateral, _ = project(other.x, other.y, k, scene.net)
        aside = abs(lateral) > lane.width / 2 + 1.0
        if (aside and other.target != k) or s > lane.length:
            continue
        if s - length - other.length / 2 < gap:
            gap = s - length - other.length / 2
            speed = max(other.speed * math.cos(other.heading - heading_at(s, k, scene.net)), 0.0)
    return gap, speed


@in_place(inner=True)
def _speed_to_slow_down(me: Any, k: int, then: int, net: Net) -> float:
    """The speed from which a driver can stop or take the bend at the end of its lane, m/s."""
    path = path_to(k, then, net) if then >= 0 else -1
    if path < 0:
        return np.inf
    bend = net.lanes[path]
    waits = bend.signal >= 0 or bend.must_yield or bend.must_stop
    allowed = 0.0 if waits else min(me.speed_factor, BEND_FACTOR) * bend.limit
    left = max(net.lanes[k].length - me.length, 0.0)
    return float(braking_speed(left, allowed, BEND_BRAKING * me.comfort_decel_mps2))


_begin = typed_once(begin)
