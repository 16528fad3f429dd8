"""What the rules of the road demand of every driver in one step, as `DriverCommands`."""

from __future__ import annotations

import math
from typing import Final

from highway_env.vehicle.kinematics import Vehicle

from behaviors.driver_models import braking_speed
from sim.frames import EventKind, Signal
from sim.highway import driving
from sim.highway.lanes import LaneIndex
from sim.highway.network import is_wrong_side
from sim.highway.rules.crossings import (
    Walkers,
    find_arrivals,
    walkers_at_crossings,
    yield_at_crossings,
)
from sim.highway.rules.junctions import (
    Approaching,
    approaching_vehicles,
    obey_stop_line,
    yield_to_conflicts,
)
from sim.highway.rules.way_ahead import ENTERED_M, RANGE_M, WayAhead, way_ahead
from sim.highway.rules.wrong_lane import lane_to_get_over_to
from sim.highway.rules.wrong_way import wrong_way_lane
from sim.highway.state import Arrival, RoadState, agent_of
from sim.highway.vehicle import DriverCommands, ProfileVehicle

BEND_FACTOR: Final = 1.2
"""Largest factor by which a driver exceeds the limit of a junction path (these limits follow from
lateral acceleration)."""

BEND_BRAKING: Final = 0.7
"""Share of the comfortable braking that drivers use ahead of a bend."""

NO_CHANGE_M: Final = (15.0, 20.0)
"""Drivers do not change lanes this soon after and before a junction, m."""

LINE_M: Final = 3.0
"""A driver on the wrong side stops this far before a junction, m."""


def give_commands(road: RoadState) -> None:
    """Work out what the rules demand of every driver, and the crossings that each comes to.

    Args:
        road: after its `locate`; its ``arrivals`` and its vehicles' ``commands`` are set.
    """
    ahead = [way_ahead(road, vehicle) for vehicle in road.vehicles]
    approaching = approaching_vehicles(road, ahead)
    _record_violations(road, ahead)
    walkers = walkers_at_crossings(road)
    commands = [
        _commands(road, way, approaching, walkers)
        if isinstance(way.vehicle, ProfileVehicle)
        else None
        for way in ahead
    ]
    arrivals: dict[tuple[int, int], list[Arrival]] = {}
    for way, given in zip(ahead, commands, strict=True):
        if given is not None:
            way.vehicle.commands = given
            given.forced_lane = wrong_way_lane(road, way.vehicle)
            if given.forced_lane is None:
                given.forced_lane = lane_to_get_over_to(road, way)
        for place, arrival in find_arrivals(road, way, given):
            arrivals.setdefault(place, []).append(arrival)
    road.arrivals = arrivals


def _commands(
    road: RoadState, way: WayAhead, approaching: Approaching, walkers: Walkers
) -> DriverCommands:
    vehicle, network = way.vehicle, road.network_info
    commands = DriverCommands()
    lane, info = network.lanes[way.lane], network.info[way.lane]
    parameters = vehicle.parameters
    factor = min(parameters[driving.SPEED_FACTOR], BEND_FACTOR)
    near = way.to_line < RANGE_M
    then = road.next_stretch(vehicle, way.lane[:2])
    if info.connector:
        commands.speed_cap = factor * lane.speed_limit
        commands.changes = False
    elif network.exit_of or then is not None:
        commands.changes = way.s > NO_CHANGE_M[0] and (then is None or way.to_line > NO_CHANGE_M[1])
        merging = vehicle.target_lane_index != way.lane and not network.ways_of_lane.get(way.lane)
        if then is not None and way.path is None and near and not merging:  # on a wrong lane
            commands.stop_gap = way.to_line
            commands.held = True
            commands.changes = True
    if is_wrong_side(way.lane):
        if near:
            commands.stop_gap = way.to_line - LINE_M
        return commands
    if way.path is not None and near:
        if not info.connector:
            bend = factor * network.lanes[way.path].speed_limit
            braking = BEND_BRAKING * parameters[driving.COMFORT_DECEL]
            commands.speed_cap = braking_speed(max(way.to_line, 0.0), bend, braking)
        if way.to_line > -ENTERED_M:
            obey_stop_line(road, way, commands)
        if not commands.held:
            yield_to_conflicts(road, way, approaching, commands)
    yield_at_crossings(road, way, walkers, commands)
    through = way.path is not None and not network.info[way.path].must_yield
    if through and -ENTERED_M < way.to_line < commands.stop_gap < math.inf:
        commands.stop_within(way.to_line)  # a driver with priority does not stop inside
    return commands


def _record_violations(road: RoadState, ahead: list[WayAhead]) -> None:
    """Record vehicles that have just run a red light or a stop sign."""
    for way in ahead:
        vehicle = way.vehicle
        before = getattr(vehicle, "line_before", None)
        vehicle.line_before = None if way.path is None else (way.path, way.to_line)
        if way.path is None or before is None or before[0] != way.path:
            continue
        if not (before[1] > 0.0 >= way.to_line):
            continue
        record_violation(road, vehicle, way.path)


def record_violation(road: RoadState, vehicle: Vehicle, path: LaneIndex) -> None:
    """Record a vehicle that has just crossed the line of a path without being allowed to."""
    info = road.network_info.info[path]
    if info.signal >= 0 and road.signals[info.signal] == Signal.RED.code:
        vehicle.ran_red = True
        road.add_event(EventKind.RED_RUN, agent_of(vehicle))
    if info.must_stop and not getattr(vehicle, "draws", {}).get(("stood", path), False):
        road.add_event(EventKind.STOP_ROLLED, agent_of(vehicle))
