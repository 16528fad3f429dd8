"""Overtaking on the wrong side: when a driver pulls out, and when it returns.

A driver whose time for it has come pulls out behind a slow leader onto the nearest lane of the
opposite direction if no oncoming vehicle is within sight. It goes back as soon as there is room on
its own side; it also goes back before that if a vehicle comes towards it.
"""

from __future__ import annotations

from typing import Final

from sim.frames import EventKind
from sim.highway.lanes import LaneIndex
from sim.highway.network import is_wrong_side
from sim.highway.state import RoadState
from sim.highway.vehicle import ProfileVehicle

PASSING_S: Final = 5.0
"""Drivers expect overtaking to take this long, s."""

BACK_S: Final = 3.0
"""A driver on the wrong side goes back if it would meet a vehicle within this time, s."""

LEADER_M: Final = 25.0
"""Drivers overtake only leaders nearer than this, m."""

ROOM_M: Final = 4.0
"""Least gap in front and behind to go back into, m."""

JUNCTION_M: Final = 60.0
"""Drivers do not begin to overtake this near the end of the road, m."""

STUCK_S: Final = 5.0
"""A vehicle that stands on the wrong side for this long is taken off the road (facing oncoming
traffic, it would stand there for ever)."""


def wrong_way_lane(road: RoadState, vehicle: ProfileVehicle) -> LaneIndex | None:
    """The lane to head for, of a driver that is on the wrong side or about to be.

    Args:
        road: where it is, after its `locate`.
        vehicle: with its commands for this step.

    Returns:
        A lane, or None if the driver does not overtake on the wrong side.
    """
    schedule = vehicle.schedule
    due = vehicle.clock >= schedule.wrong_way_at
    if vehicle.crashed or not (vehicle.wrong_way or due):
        return None
    network, lane = road.network_info, vehicle.lane_index
    if is_wrong_side(lane):
        return _lane_to_go_back(road, vehicle)
    if is_wrong_side(vehicle.target_lane_index):
        return vehicle.target_lane_index
    wrong_side = network.wrong_side.get(lane)
    if wrong_side is None or not due:
        return None
    here = road.neighbours(vehicle, lane)
    slow = here.front_gap < LEADER_M and here.front_speed < 0.8 * vehicle.desired_speed
    left = network.lanes[lane].length - road.distance_along(vehicle, lane)
    if not slow or left < JUNCTION_M or vehicle.speed < 2.0 or not vehicle.commands.changes:
        return None
    oncoming = road.neighbours(vehicle, wrong_side)
    needed = PASSING_S * (vehicle.desired_speed + float(network.lanes[wrong_side].speed_limit))
    if oncoming.front_gap < min(needed, left) or oncoming.rear_gap < ROOM_M:
        return None
    schedule.wrong_way_at = schedule.next(vehicle.clock, vehicle.profile.wrong_way_rate_per_min)
    return wrong_side


def _lane_to_go_back(road: RoadState, vehicle: ProfileVehicle) -> LaneIndex:
    """The own side's lane if it is time to go back and there is room, or else the present one."""
    lane = vehicle.lane_index
    own = (lane[0][1:], lane[1][1:], 0)
    here, beside = road.neighbours(vehicle, lane), road.neighbours(vehicle, own)
    room = beside.front_gap > ROOM_M and beside.rear_gap > ROOM_M
    closing = vehicle.speed - here.front_speed
    soon = here.front_gap < BACK_S * max(closing, 1.0)
    ends = road.network_info.lanes[lane].length - road.distance_along(vehicle, lane) < JUNCTION_M
    past = beside.front_gap > LEADER_M
    return own if room and (past or soon or ends) else lane


def record_wrong_way(road: RoadState) -> list[ProfileVehicle]:
    """Record which vehicles have come onto the wrong side.

    Returns:
        Those that have stood there too long and have to be taken off the road.
    """
    stuck = []
    for vehicle in road.vehicles:
        if not isinstance(vehicle, ProfileVehicle):
            continue
        wrong = is_wrong_side(vehicle.lane_index)
        if wrong and not vehicle.wrong_way:
            road.add_event(EventKind.WRONG_WAY, vehicle.agent)
        vehicle.wrong_way = wrong
        if wrong and road.stood_s(vehicle) > STUCK_S:
            stuck.append(vehicle)
    return stuck
