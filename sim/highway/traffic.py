"""One step of the highway engine's road: decisions, motion, collisions, departures."""

from __future__ import annotations

import copy
import math
from typing import Final

from sim.frames import EventKind
from sim.highway.kernels.traffic import CompiledTraffic
from sim.highway.network import HighwayNetwork
from sim.highway.rules.collisions import Pair, find_cause, touching_pairs
from sim.highway.rules.crossings import may_walk
from sim.highway.rules.wrong_way import record_wrong_way
from sim.highway.state import RoadState, agent_of
from sim.highway.vehicle import ProfileVehicle
from sim.highway.walkers import Walker

CLEAR_AFTER_S: Final = 8.0
"""Crashed vehicles and struck pedestrians stay on the road this long (traffic behind sees them and
queues, and pile-ups clear)."""


class TrafficRoad(RoadState):
    """The road with everybody on it, step by step.

    Args:
        network: the road in highway-env's terms.
    """

    def __init__(self, network: HighwayNetwork) -> None:
        super().__init__(network)
        self._touching: set[Pair] = set()
        self._compiled = CompiledTraffic(self)

    def copied(self) -> TrafficRoad:
        """A copy of the traffic on the same lanes; neither road changes with the other."""
        network = self.network_info
        fixed: list[object] = [network, network.net, *network.lanes.values()]
        fixed.append(self._compiled.tables)
        for vehicle in self.vehicles:
            if isinstance(vehicle, ProfileVehicle):
                fixed += [vehicle.driver, vehicle.parameters]
        fixed += [walker.footway for walker in self.walkers]
        made = copy.deepcopy(self, {id(one): one for one in fixed})
        made.locate()
        return made

    def act(self) -> None:
        """Let everybody decide."""
        self.locate()
        self._compiled.act()

    def step(self, dt: float) -> None:
        """Move everybody for ``dt`` seconds, at most 0.1 s, and record what happened."""
        self._compiled.step(dt)
        self.time_s += dt
        for walker in self.walkers:
            walker.step(dt, walks=may_walk(self, walker, dt))
        self.update_standing()
        self.update_signals()
        self._collide()
        self._clear()

    def _collide(self) -> None:
        """Record collisions of those that touch and did not touch before."""
        pairs = touching_pairs(self)
        for pair in pairs:
            if pair not in self._touching:
                self._crash(pair)
        self._touching = set(pairs)

    def _crash(self, pair: Pair) -> None:
        cause, victim, rule = find_cause(self, *pair)
        for one in pair:
            one.crashed = True
            if isinstance(one, Walker):
                one.hit = True
                one.struck_at = min(one.struck_at, self.time_s)
            else:
                one.crashed_at = min(getattr(one, "crashed_at", math.inf), self.time_s)
        self.add_event(EventKind.COLLISION, agent_of(cause), agent_of(victim), rule)

    def _clear(self) -> None:
        """Remove vehicles that have arrived, and those that crashed long ago."""
        stuck = record_wrong_way(self) if self.network_info.wrong_side else []
        staying = []
        for vehicle in self.vehicles:
            if not isinstance(vehicle, ProfileVehicle):
                staying.append(vehicle)
            elif vehicle in stuck:
                self.add_event(EventKind.REMOVAL, vehicle.agent, rule="stuck on the wrong side")
            elif self.time_s - vehicle.crashed_at > CLEAR_AFTER_S:
                self.add_event(EventKind.REMOVAL, vehicle.agent, rule="crashed")
            elif id(vehicle) not in self._compiled.at_end or not self._arrived(vehicle):
                staying.append(vehicle)
        self.vehicles = staying
        walking = []
        for walker in self.walkers:
            if self.time_s - walker.struck_at > CLEAR_AFTER_S:
                self.add_event(EventKind.REMOVAL, walker.agent, rule="struck")
            elif not walker.arrived:
                walking.append(walker)
        self.walkers = walking
        self.objects = list(walking)

    def _arrived(self, vehicle: ProfileVehicle) -> bool:
        lane = vehicle.lane_index
        if self.network_info.info[lane].connector:
            return False
        s = vehicle.lane.local_coordinates(vehicle.position)[0]
        if s + vehicle.LENGTH / 2 < vehicle.lane.length:
            return False
        return self.next_stretch(vehicle, lane[:2]) is None
