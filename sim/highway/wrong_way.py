"""Overtaking on the wrong side: when a driver dares, and when it gets back.

A driver whose wish has come and whose leader is slow pulls out onto the nearest opposite lane if
nobody comes within sight, and goes back as soon as there is room on its own side; when somebody
comes after all it brakes and squeezes back in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from sim.frames import EventKind
from sim.highway.network import LaneIndex
from sim.highway.vehicle import Neighbours, ProfileVehicle

if TYPE_CHECKING:
    from sim.highway.traffic import TrafficRoad

PASSING_S: Final = 5.0
"""How long an overtaking is expected to take, s (our choice)."""

BACK_S: Final = 3.0
"""Somebody who would be met within this time makes one go back, s (our choice)."""

LEADER_M: Final = 25.0
"""Only a leader nearer than this is overtaken (our choice)."""

ROOM_M: Final = 4.0
"""Room in front and behind that is enough to go back, m (our choice)."""

JUNCTION_M: Final = 60.0
"""No overtaking on the wrong side begins this near the end of the road (our choice)."""

STUCK_S: Final = 5.0
"""Who stands on the wrong side for this long is taken off the road (our choice: facing traffic,
it would stand there for ever)."""


def wrong_way_lane(
    road: TrafficRoad, vehicle: ProfileVehicle, here: Neighbours
) -> LaneIndex | None:
    """The lane to head for, if the driver is on the wrong side or about to be.

    Args:
        road: where it is, after its `look`.
        vehicle: whose driver decides.
        here: who is ahead and behind on its present lane.

    Returns:
        A lane, or None if the wrong side has nothing to do with it.
    """
    network, lane = road.network_info, vehicle.lane_index
    if lane[0].startswith("~"):
        own = (lane[0][1:], lane[1][1:], 0)
        beside = road.around(vehicle, own)
        room = beside.front_gap > ROOM_M and beside.rear_gap > ROOM_M
        closing = vehicle.speed - here.front_speed
        soon = here.front_gap < BACK_S * max(closing, 1.0)
        ends = network.lanes[lane].length - road.place(vehicle, lane)[0] < JUNCTION_M
        past = beside.front_gap > LEADER_M
        return own if room and (past or soon or ends) else lane
    if vehicle.target_lane_index[0].startswith("~"):
        return vehicle.target_lane_index
    ghost = network.ghost.get(lane)
    wishes = vehicle.wishes
    if ghost is None or vehicle.clock < wishes.wrong_way_at:
        return None
    slow = here.front_gap < LEADER_M and here.front_speed < 0.8 * vehicle.desired_speed
    s, _ = road.place(vehicle, lane)
    left = network.lanes[lane].length - s
    if not slow or left < JUNCTION_M or vehicle.speed < 2.0 or not vehicle.orders.changes:
        return None
    oncoming = road.around(vehicle, ghost)
    needed = PASSING_S * (vehicle.desired_speed + float(network.lanes[ghost].speed_limit))
    if oncoming.front_gap < min(needed, left) or oncoming.rear_gap < ROOM_M:
        return None
    wishes.wrong_way_at = wishes.next(vehicle.clock, vehicle.profile.wrong_way_rate_per_min)
    return ghost


def note_wrong_way(road: TrafficRoad) -> list[ProfileVehicle]:
    """Note who has come onto the wrong side.

    Returns:
        Those who have stood there too long and have to go.
    """
    stuck = []
    for vehicle in road.vehicles:
        if not isinstance(vehicle, ProfileVehicle):
            continue
        wrong = vehicle.lane_index[0].startswith("~")
        if wrong and not vehicle.wrong_way:
            road.add_event(EventKind.WRONG_WAY, vehicle.agent)
        vehicle.wrong_way = wrong
        if wrong and road.stood_s(vehicle) > STUCK_S:
            stuck.append(vehicle)
    return stuck
