"""How drivers slow down for bends and lane ends, and how violations at lines are found."""

from __future__ import annotations

from typing import Final

from highway_env.vehicle.kinematics import Vehicle

from sim.frames import EventKind, Signal
from sim.highway.lanes import LaneIndex
from sim.highway.state import RoadState, agent_of

BEND_FACTOR: Final = 1.2
"""Largest factor by which a driver exceeds the limit of a junction path (these limits follow from
lateral acceleration)."""

BEND_BRAKING: Final = 0.7
"""Share of the comfortable braking that drivers use ahead of a bend."""

NO_CHANGE_M: Final = (15.0, 20.0)
"""Drivers do not change lanes this soon after and before a junction, m."""

LINE_M: Final = 3.0
"""A driver on the wrong side stops this far before a junction, m."""


def record_violation(road: RoadState, vehicle: Vehicle, path: LaneIndex) -> None:
    """Record a vehicle that has just crossed the line of a path without being allowed to."""
    info = road.network_info.info[path]
    if info.signal >= 0 and road.signals[info.signal] == Signal.RED.code:
        vehicle.ran_red = True
        road.add_event(EventKind.RED_RUN, agent_of(vehicle))
    if info.must_stop and not getattr(vehicle, "draws", {}).get(("stood", path), False):
        road.add_event(EventKind.STOP_ROLLED, agent_of(vehicle))
