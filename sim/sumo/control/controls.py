"""All controllers of one simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from behaviors.errors import InputError
from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control import Action, Change
from sim.sumo.control.drivers import (
    FORCED_LANE_CHANGES,
    NO_LANE_CHANGES,
    ORDINARY_SPEED_MODE,
    Controller,
    Streets,
    release,
)
from sim.sumo.control.jaywalking import Jaywalking
from sim.sumo.control.manoeuvres import CuttingIn, Lapses, Stopping
from sim.sumo.control.overtaking import Overtaking
from sim.sumo.control.right_of_way import Clearing, Obedience
from sim.sumo.vehicle_types import alternative_name

NAMED: Final = 8
"""Most drivers that an error suggests instead."""

DRIVERS_ACT_S: Final = 0.2
"""How often the controllers of drivers act, s; jaywalkers are moved at every step."""

ACTION_S: Final = 4.0
"""How long an action lasts, s (a lane change takes 2.5 s)."""


class Controls:
    """Steps all controllers, of an episode in libsumo's C module with steps of ``step_s``."""

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec], step_s: float) -> None:
        self._every = max(2, round(DRIVERS_ACT_S / step_s))
        self._streets = streets = Streets(sumo, road, agents, step_s, self._every * step_s)
        self._sumo = sumo
        self._step = 0
        self._vehicles: Sequence[str] = ()
        self._act_until_s: dict[str, float] = {}
        self.jaywalking = Jaywalking(streets)
        self.overtaking = Overtaking(streets)
        self._lapses = Lapses(streets)
        self._turns: tuple[Sequence[Controller[Any]], ...] = (
            (Obedience(streets), Clearing(streets), Stopping(streets)),
            (CuttingIn(streets), self.overtaking),
        )
        self._of_drivers = (*self._turns[0], *self._turns[1])

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Act after a simulation step on the vehicles and persons that are on the road."""
        self._step += 1
        ended = [name for name, end_s in self._act_until_s.items() if time_s >= end_s - 1e-9]
        for name in ended:
            del self._act_until_s[name]
            if name in vehicles:
                release(self._sumo, name)
        if ended or vehicles is not self._vehicles:
            self._vehicles = vehicles
            self._share_out(vehicles)
        self.jaywalking.step(time_s, vehicles, persons)
        before = self._lapses.away
        self._lapses.step(time_s, vehicles, persons)
        for agent in self._lapses.ended:
            self._begin_again(agent, time_s, self._of_drivers)
        if self._lapses.away != before:
            self._share_out(vehicles)
        self.overtaking.removed = []
        turn = self._step % self._every
        for controller in self._turns[turn] if turn < len(self._turns) else ():
            controller.step(time_s, vehicles, persons)

    def _share_out(self, vehicles: Sequence[str]) -> None:
        """Give the controllers the vehicles that they steer; nobody steers who looks away."""
        others = [one for one in vehicles if one not in self._act_until_s]
        self._lapses.set_vehicles([one for one in others if not self.overtaking.overtakes(one)])
        away = self._lapses.away
        for controller in self._of_drivers:
            controller.set_vehicles([one for one in others if one not in away])

    def change(self, to: Change, time_s: float) -> None:
        """Let a driver on the road go on with another behaviour, or carry out an action.

        Raises:
            InputError: if the driver is not on the road, is overtaking on the wrong side, or has
                no lane for the action.
        """
        name = str(to.id if isinstance(to, AgentSpec) else to[0])
        present = self._sumo.vehicle_getIDList()
        if name not in present:
            there = ", ".join(sorted(present, key=int)[:NAMED])
            raise InputError(
                f"agent {name}: found it not on the road at {time_s:g} s, expected one that is, "
                f"such as {there or 'none yet'}"
            )
        if self.overtaking.overtakes(name):
            raise InputError(f"agent {name}: found it overtaking on the wrong side at {time_s:g} s")
        if isinstance(to, AgentSpec):
            assert to.profile is not None
            self._sumo.vehicle_setType(name, alternative_name(to))
            # a type's factor is drawn again
            self._sumo.vehicle_setSpeedFactor(name, to.profile.speed_factor)
            self._begin_again(to, time_s, (*self._of_drivers, self._lapses))
        else:
            self._act(name, to[1], time_s)
        self._vehicles = ()  # the controllers are given the vehicles again at the next step

    def _act(self, name: str, action: Action, time_s: float) -> None:
        """Begin an action of a vehicle on the road."""
        sumo = self._sumo
        if action in (Action.CHANGE_LEFT, Action.CHANGE_RIGHT):
            side = 1 if action is Action.CHANGE_LEFT else -1
            lane = self._streets.lanes.get(sumo.vehicle_getLaneID(name))
            beside = None if lane is None else self._streets.beside(lane, side)
            if beside is None:
                raise InputError(
                    f"agent {name}: found no lane for {action} at {time_s:g} s, expected one beside"
                )
            sumo.vehicle_setSpeed(name, -1.0)
            sumo.vehicle_setLaneChangeMode(name, FORCED_LANE_CHANGES)
            sumo.vehicle_changeLane(name, beside.index, ACTION_S)
        else:
            speed = {
                Action.BRAKE: 0.0,
                Action.KEEP: sumo.vehicle_getSpeed(name),
                Action.ACCELERATE: sumo.vehicle_getMaxSpeed(name),
            }[action]
            sumo.vehicle_setLaneChangeMode(name, NO_LANE_CHANGES)
            sumo.vehicle_setSpeed(name, speed)
        self._act_until_s[name] = time_s + ACTION_S

    def _begin_again(
        self, agent: AgentSpec, time_s: float, controllers: Sequence[Controller[Any]]
    ) -> None:
        """Let some controllers begin again with a driver, who drives by all of SUMO's rules."""
        for controller in controllers:
            controller.change(agent, time_s)
        self._sumo.vehicle_setSpeedMode(str(agent.id), ORDINARY_SPEED_MODE)
        release(self._sumo, str(agent.id))
