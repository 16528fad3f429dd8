"""All controllers of one simulation, each only if somebody asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sim.road import Road
from sim.scenario import AgentSpec
from sim.sumo.control.cutting_in import CuttingIn
from sim.sumo.control.obedience import Obedience
from sim.sumo.control.stopping import Stopping


class Controls:
    """Steps the controllers that at least one agent's profile asks for.

    Args:
        sumo: libsumo's C module.
        road: the road.
        agents: everyone.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._sumo = sumo
        self._obedience = Obedience(sumo, road, agents)
        self._cutting_in = CuttingIn(sumo, road, agents)
        self._stopping = Stopping(sumo, road, agents)

    def step(self, time_s: float) -> None:
        """Act after a simulation step.

        Args:
            time_s: simulated time, s.
        """
        vehicles = self._sumo.vehicle_getIDList()
        persons = self._sumo.person_getIDList()
        self._obedience.step(vehicles, persons)
        self._cutting_in.step(time_s, vehicles)
        self._stopping.step(time_s, vehicles)
