"""Drivers on a lane that does not lead to their goal: they change lanes, or take another route.

Such a driver changes towards the nearest lane that does lead there, into any gap that makes nobody
brake harder than it may, and the harder the nearer the end of its lane is. A driver that stands at
the end of its lane all the same goes on where the lane leads and from there to its goal, or leaves
the road where it can. A driver whose lane leads nowhere waits there for a gap.

References:
    Mandatory lane changes: Kesting, Treiber, Helbing (2007), Transportation Research Record 1999.
"""

from __future__ import annotations

import heapq
import math
from typing import Final

from sim.frames import FloatArray
from sim.highway import driving
from sim.highway.lanes import LaneIndex
from sim.highway.network import HighwayNetwork, is_wrong_side
from sim.highway.rules.way_ahead import RANGE_M, WayAhead
from sim.highway.state import RoadState
from sim.highway.vehicle import CHANGE_LEAST_SPEED_MPS, ProfileVehicle, parameters_of

Stretch = tuple[str, str]

GENTLE_MPS2: Final = 2.0
"""Braking that a driver far from its lane's end imposes on others and itself at most, m/s2
(highway-env's bound for ordinary changes)."""

URGENT_MPS2: Final = 4.5
"""The same at the end of its lane (hard, and held by any tyre)."""

GIVES_UP_S: Final = 4.0
"""A driver that has stood this long at the end of a wrong lane takes another route, s."""

AT_END_M: Final = 12.0
"""Drivers take another route only this near to the end of their lane, m."""

ROOM_M: Final = 6.0
"""A standing vehicle needs this much room before its lane's end to get over, m."""


def lane_to_get_over_to(road: RoadState, way: WayAhead) -> LaneIndex | None:
    """The lane beside its own that a driver on a wrong lane changes to now.

    Args:
        road: after its `locate`.
        way: of a driver with a profile, whose ``stretches`` change if it gives up.

    Returns:
        A lane, or None if the driver is on no wrong lane or finds no gap.
    """
    vehicle, lane, network = way.vehicle, way.lane, road.network_info
    if way.path is not None or network.info[lane].connector or is_wrong_side(lane):
        return None
    then = road.next_stretch(vehicle, lane[:2])
    if then is None or vehicle.crashed:
        return None
    leading = network.lanes_towards(lane[:2], then)
    leads_on = bool(network.ways_of_lane.get(lane))
    at_end = way.to_line < AT_END_M and road.neighbours(vehicle, lane).front_gap > way.to_line
    if not leading or (leads_on and at_end and road.stood_s(vehicle) > GIVES_UP_S):
        vehicle.target_lane_index = vehicle.wanted_lane_index = lane
        _go_another_way(network, vehicle, lane)
        return None
    if vehicle.target_lane_index != lane:
        return None  # it is getting over
    nearest = min(leading, key=lambda one: abs(one[2] - lane[2]))
    side = (*lane[:2], lane[2] + (1 if nearest[2] > lane[2] else -1))
    slow = vehicle.speed < CHANGE_LEAST_SPEED_MPS
    if slow and leads_on and way.to_line < ROOM_M:
        return None
    return side if _fits(road, way, side) else None


def _fits(road: RoadState, way: WayAhead, side: LaneIndex) -> bool:
    """Whether a lane has a gap for which nobody has to brake too hard."""
    vehicle, driver = way.vehicle, way.vehicle.parameters
    there = road.neighbours(vehicle, side)
    least = driving.LEAST_CHANGE_GAP_M
    if there.front_gap < least or there.rear_gap < least:
        return False
    urgency = 1.0 - min(max(way.to_line, 0.0) / RANGE_M, 1.0)
    most = GENTLE_MPS2 + urgency * (URGENT_MPS2 - GENTLE_MPS2)
    own = _braking(driver, vehicle.speed, vehicle.desired_speed, there.front_gap, there.front_speed)
    if own < -most:
        return False
    if there.rear is None:
        return True
    rear, speed = parameters_of(there.rear), there.rear_speed
    return _braking(rear, speed, max(speed, 1.0), there.rear_gap, vehicle.speed) >= -most


def _braking(
    driver: FloatArray, speed: float, desired: float, gap: float, leader_speed: float
) -> float:
    """IDM's bounded acceleration, m/s2, whatever law the driver follows by; see `driving.idm`."""
    wanted = driving.idm(driver, speed, desired, gap, leader_speed)
    return float(driving.bounded(driver, wanted, gap, speed - leader_speed))


def _go_another_way(network: HighwayNetwork, vehicle: ProfileVehicle, lane: LaneIndex) -> None:
    """Give a vehicle a route from where its lane leads: to its goal, or else to a way out."""
    route = find_way(network, lane, vehicle.stretches[-1])
    if route is not None:
        vehicle.stretches = (lane[:2], *route)


def find_way(network: HighwayNetwork, lane: LaneIndex, goal: Stretch) -> tuple[Stretch, ...] | None:
    """The shortest way from a lane to a stretch, or else to any stretch where the road ends.

    Args:
        network: of the road.
        lane: where it begins; other lanes of its stretch are not used, nor is the stretch again.
        goal: where it is to lead.

    Returns:
        The stretches after that of ``lane``; None if the lane leads nowhere.
    """
    here = lane[:2]
    best: dict[Stretch, float] = {}
    before: dict[Stretch, Stretch] = {}
    queue: list[tuple[float, Stretch]] = []
    for then in network.ways_of_lane.get(lane, ()):
        if then != here:
            best[then] = network.lanes[(*then, 0)].length
            heapq.heappush(queue, (best[then], then))
    way_out: Stretch | None = None
    furthest: Stretch | None = None
    while queue:
        cost, stretch = heapq.heappop(queue)
        if cost > best[stretch]:
            continue
        furthest = stretch
        if stretch == goal:
            break
        onward = network.ways_of_stretch.get(stretch, ())
        if not onward and way_out is None:
            way_out = stretch
        for then in onward:
            new = cost + network.lanes[(*then, 0)].length
            if then != here and new < best.get(then, math.inf):
                best[then], before[then] = new, stretch
                heapq.heappush(queue, (new, then))
    end = goal if goal in best else way_out or furthest
    if end is None:
        return None
    way = [end]
    while way[-1] in before:
        way.append(before[way[-1]])
    return tuple(reversed(way))
