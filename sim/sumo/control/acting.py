"""One thing that a driver does on command, whatever its behaviour: brake, keep, accelerate, change.

It lasts `ACTION_S`; meanwhile no controller steers that driver, and afterwards it drives as before.
SUMO's safe speed, right of way and red lights still hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from behaviors.errors import InputError
from sim.road import Road
from sim.sumo.control.approaches import drivable
from sim.sumo.control.drivers import FORCED_LANE_CHANGES, LANE_CHANGES, NO_LANE_CHANGES

ACTION_S: Final = 4.0
"""How long an action lasts, s (a lane change takes 2.5 s)."""


class Action(StrEnum):
    """Actions that a driver can be made to take."""

    BRAKE = "brake"
    """Brakes as hard as the driver ordinarily does, and stands if there is time left."""

    KEEP = "keep"
    """Keeps speed and lane."""

    ACCELERATE = "accelerate"
    """Accelerates as hard as the driver ordinarily does, past the speed limit too."""

    CHANGE_LEFT = "change-left"
    """Moves to the lane on the left unless vehicles would touch."""

    CHANGE_RIGHT = "change-right"
    """Moves to the lane on the right unless vehicles would touch."""


@dataclass(frozen=True, slots=True)
class Command:
    """An action of one driver.

    Attributes:
        agent: the driver's id.
        action: what it does.
    """

    agent: int
    action: Action


class Acting:
    """Carries out the actions in a simulation of libsumo's C module."""

    def __init__(self, sumo: Any, road: Road) -> None:
        self._sumo = sumo
        self._lanes = {lane.id: lane for lane in road.lanes if not lane.internal}
        self._drivable = drivable(road)
        self._until_s: dict[str, float] = {}

    def begin(self, name: str, action: Action, time_s: float) -> None:
        """Begin an action of a vehicle on the road at a simulated time, s.

        Raises:
            InputError: if that side has no lane.
        """
        sumo = self._sumo
        if action in (Action.CHANGE_LEFT, Action.CHANGE_RIGHT):
            side = 1 if action is Action.CHANGE_LEFT else -1
            lane = self._lanes.get(sumo.vehicle_getLaneID(name))
            if lane is None or (lane.edge, lane.index + side) not in self._drivable:
                raise InputError(
                    f"agent {name}: found no lane for {action} at {time_s:g} s, expected one beside"
                )
            sumo.vehicle_setSpeed(name, -1.0)
            sumo.vehicle_setLaneChangeMode(name, FORCED_LANE_CHANGES)
            sumo.vehicle_changeLane(name, lane.index + side, ACTION_S)
        else:
            speed = {
                Action.BRAKE: 0.0,
                Action.KEEP: sumo.vehicle_getSpeed(name),
                Action.ACCELERATE: sumo.vehicle_getMaxSpeed(name),
            }[action]
            sumo.vehicle_setLaneChangeMode(name, NO_LANE_CHANGES)
            sumo.vehicle_setSpeed(name, speed)
        self._until_s[name] = time_s + ACTION_S

    def end_due(self, time_s: float, vehicles: Sequence[str]) -> bool:
        """End the actions whose time is up, and say whether there was any."""
        due = [name for name, until_s in self._until_s.items() if time_s >= until_s - 1e-9]
        for name in due:
            del self._until_s[name]
            if name in vehicles:
                self._sumo.vehicle_setSpeed(name, -1.0)
                self._sumo.vehicle_setLaneChangeMode(name, LANE_CHANGES)
        return bool(due)

    def others(self, vehicles: Sequence[str]) -> Sequence[str]:
        """The vehicles that carry out no action."""
        if not self._until_s:
            return vehicles
        return [name for name in vehicles if name not in self._until_s]
