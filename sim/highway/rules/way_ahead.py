"""Where a driver is on its way: its lane, the next junction path and the places ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from highway_env.vehicle.kinematics import Vehicle

from sim.highway.lanes import LaneIndex
from sim.highway.state import RoadState
from sim.highway.vehicle import ProfileVehicle

RANGE_M: Final = 80.0
"""Drivers attend to junctions and crossings within this distance (6 s at 14 m/s)."""

ENTERED_M: Final = 0.5
"""A vehicle whose front is this far over the stop line has entered the junction."""


class StripAhead(NamedTuple):
    """A place ahead of a driver where a lane runs over a crossing.

    Attributes:
        lane: which.
        crossing: which.
        near: front bumper to the near edge of the crossing, m.
        far: to the far edge, m.
        u: distance along the crossing of the lane's centre line, m.
    """

    lane: LaneIndex
    crossing: int
    near: float
    far: float
    u: float


@dataclass(slots=True)
class WayAhead:
    """One vehicle on its way, in one step.

    Attributes:
        vehicle: which.
        lane: the lane it is on.
        s: distance of its middle along the lane, m.
        front: distance of its front bumper along the lane, m.
        path: the junction path it is on or comes to next; None if its lane leads to none.
        to_line: front bumper to the beginning of the path, or to the end of a lane without one, m;
            negative beyond it.
        strips: where the lane and the path run over crossings.
    """

    vehicle: Vehicle
    lane: LaneIndex
    s: float
    front: float
    path: LaneIndex | None
    to_line: float
    strips: list[StripAhead]


def way_ahead(road: RoadState, vehicle: Vehicle) -> WayAhead:
    """Where a vehicle is on its way; a path that it is on is noted as its last one."""
    lane = vehicle.lane_index
    s = road.distance_along(vehicle, lane)
    front = s + vehicle.LENGTH / 2
    info, strips = road.network_info.info, []
    for strip in info[lane].strips:
        near, far = strip.near_s - front, strip.far_s - front
        strips.append(StripAhead(lane, strip.crossing, near, far, strip.u))
    if info[lane].connector:
        vehicle.last_path = lane
        return WayAhead(vehicle, lane, s, front, lane, -front, strips)
    path = road.onward_lane(vehicle, lane)
    to_line = road.network_info.lanes[lane].length - front
    if path is not None:
        for strip in info[path].strips:
            near, far = strip.near_s + to_line, strip.far_s + to_line
            strips.append(StripAhead(path, strip.crossing, near, far, strip.u))
    return WayAhead(vehicle, lane, s, front, path, to_line, strips)


def can_stop(speed: float, distance: float, decel: float) -> bool:
    """Whether braking with ``decel``, m/s2, ends within a distance, m."""
    return speed * speed <= 2.0 * decel * max(distance, 0.05)


def draw_once(vehicle: ProfileVehicle, key: tuple[str, object], probability: float) -> bool:
    """Whether a driver does something in this encounter: drawn once, then kept."""
    if key not in vehicle.draws:
        vehicle.draws[key] = bool(vehicle.schedule.rng.random() < probability)
    return vehicle.draws[key]
