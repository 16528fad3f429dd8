"""All controllers of one simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from behaviors.errors import InputError
from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.acting import Acting, Command
from sim.sumo.control.clearing import Clearing
from sim.sumo.control.cutting_in import CuttingIn
from sim.sumo.control.drivers import LANE_CHANGES, Controller
from sim.sumo.control.jaywalking import Jaywalking
from sim.sumo.control.lapses import Lapses
from sim.sumo.control.obedience import ORDINARY_SPEED_MODE, Obedience
from sim.sumo.control.stopping import Stopping
from sim.sumo.control.wrong_way import WrongWay
from sim.sumo.vehicle_types import alternative_name

NAMED: Final = 8
"""Most drivers that an error suggests instead."""

DRIVERS_ACT_S: Final = 0.2
"""How often the controllers of drivers act, s; jaywalkers are moved at every step."""


class Controls:
    """Steps all controllers.

    Args:
        sumo: libsumo's C module.
        road: the road.
        agents: all agents of the episode.
        step_s: length of a simulation step, s.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec], step_s: float) -> None:
        self._sumo = sumo
        self._step = 0
        self._vehicles: Sequence[str] = ()
        self._every = max(2, round(DRIVERS_ACT_S / step_s))
        self._obedience = Obedience(sumo, road, agents)
        self._clearing = Clearing(sumo, road, agents, self._every * step_s)
        self._cutting_in = CuttingIn(sumo, road, agents)
        self._stopping = Stopping(sumo, road, agents)
        self._wrong_way = WrongWay(sumo, road, agents)
        self._lapses = Lapses(sumo, road, agents)
        self._of_drivers: tuple[Controller[Any], ...] = (
            self._obedience, self._clearing, self._cutting_in, self._stopping, self._wrong_way,
        )  # fmt: skip
        self._jaywalking = Jaywalking(sumo, road, agents, step_s)
        self._acting = Acting(sumo, road)

    def step(self, time_s: float, vehicles: Sequence[str], persons: Sequence[str]) -> None:
        """Act after a simulation step on the vehicles and persons that are on the road."""
        self._step += 1
        ended = self._acting.end_due(time_s, vehicles)
        if ended or vehicles is not self._vehicles:
            self._vehicles = vehicles
            self._share_out(vehicles)
        self._jaywalking.step(time_s, vehicles, persons)
        self._look_away(time_s, vehicles)
        if self._step % self._every == 0:
            self._obedience.step(time_s, persons)
            self._clearing.step(time_s)
            self._stopping.step(time_s)
        elif self._step % self._every == 1:
            self._cutting_in.step(time_s)
            self._wrong_way.step(time_s, vehicles)
            return
        self._wrong_way.removed = []

    def _share_out(self, vehicles: Sequence[str]) -> None:
        """Give the controllers the vehicles that they steer."""
        others = self._acting.others(vehicles)
        self._lapses.set_vehicles([one for one in others if not self._wrong_way.overtakes(one)])
        away = self._lapses.away
        steered = [one for one in others if one not in away] if away else others
        for controller in self._of_drivers:
            controller.set_vehicles(steered)

    def _look_away(self, time_s: float, vehicles: Sequence[str]) -> None:
        """Begin and end lapses of attention; nobody else steers a driver who looks away."""
        before = self._lapses.away
        for agent in self._lapses.step(time_s):
            for controller in self._of_drivers:
                controller.change(agent, time_s)
            self._set_back(str(agent.id))
        if self._lapses.away != before:
            self._share_out(vehicles)

    def change(self, to: AgentSpec | Command, time_s: float) -> None:
        """Let a driver on the road go on with another behaviour, or carry out an action.

        Args:
            to: the driver as it is from now on, or what it does; the id says which driver.
            time_s: simulated time, s.

        Raises:
            InputError: if the driver is not on the road, is overtaking on the wrong side, or has
                no lane for the action.
        """
        name = str(to.agent if isinstance(to, Command) else to.id)
        if name not in self._sumo.vehicle_getIDList():
            there = ", ".join(sorted(self._sumo.vehicle_getIDList(), key=int)[:NAMED])
            raise InputError(
                f"agent {name}: found it not on the road at {time_s:g} s, expected one that is, "
                f"such as {there or 'none yet'}"
            )
        if self._wrong_way.overtakes(name):
            raise InputError(f"agent {name}: found it overtaking on the wrong side at {time_s:g} s")
        if isinstance(to, Command):
            self._acting.begin(name, to.action, time_s)
        else:
            self._change_driver(name, to, time_s)
        self._vehicles = ()  # the controllers are given the vehicles again at the next step

    def _change_driver(self, name: str, agent: AgentSpec, time_s: float) -> None:
        """Let a driver go on with another profile."""
        assert agent.profile is not None
        sumo = self._sumo
        for controller in (*self._of_drivers, self._lapses):
            controller.change(agent, time_s)
        sumo.vehicle_setType(name, alternative_name(agent))
        sumo.vehicle_setSpeedFactor(name, agent.profile.speed_factor)  # a type's is drawn again
        self._set_back(name)

    def _set_back(self, name: str) -> None:
        """Let SUMO choose the speed and lane of a vehicle again, by all of its rules."""
        self._sumo.vehicle_setSpeed(name, -1.0)
        self._sumo.vehicle_setSpeedMode(name, ORDINARY_SPEED_MODE)
        self._sumo.vehicle_setLaneChangeMode(name, LANE_CHANGES)

    @property
    def removed(self) -> Sequence[int]:
        """Ids of the agents that the last step removed."""
        return self._wrong_way.removed

    @property
    def walking_speeds(self) -> Mapping[str, float]:
        """Speed of the pedestrians that a controller moves, m/s; SUMO does not know it."""
        return self._jaywalking.speeds

    @property
    def moved(self) -> bool:
        """Whether a controller moved an agent since the last simulation step."""
        return self._jaywalking.moved
