"""Junctions: stop lines, and waiting for vehicles on crossing paths.

A driver waits by signals, priority and the gap that it demands; whether it obeys a red light or a
stop sign is drawn once per encounter from the driver's own random numbers.

References:
    Gap acceptance: Raff, Hart (1950), see `behaviors.driver_models.gap_accepted`.
    Dilemma zone at yellow: Gazis, Herman, Maradudin (1960), Operations Research 8, 112.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from highway_env.vehicle.kinematics import Vehicle

from behaviors import driver_models
from sim.compiled import in_place, shared
from sim.frames import Signal
from sim.highway import driving
from sim.highway.conflicts import Conflict
from sim.highway.lanes import LaneIndex
from sim.highway.network import LaneInfo
from sim.highway.rules.way_ahead import ENTERED_M, RANGE_M, WayAhead, can_stop, draw_once
from sim.highway.state import RoadState, agent_of
from sim.highway.vehicle import DriverCommands, ProfileVehicle

_gap_accepted = shared(driver_models.gap_accepted)

STOPPED_M: Final = 3.0
"""A vehicle that stood this near the line has stopped at it."""

CLEARANCE_S: Final = 0.3
"""Time that has to pass between two vehicles at a conflict."""

CONFLICT_MARGIN_M: Final = 0.7
"""Distance that drivers keep to another's path when they wait inside a junction."""

FOE_ACCEL_MPS2: Final = 2.0
"""Acceleration that drivers expect of others."""

INSISTED_BRAKING_MPS2: Final = 4.5
"""Braking that the most insistent driver imposes on others with priority, m/s2."""

AT_LINE_M: Final = 5.0
"""Drivers wait at the line for a conflict that begins this soon after it."""

WAITING_S: Final = 1.0
"""A vehicle that has stood this long inside a junction, or before it without priority, is assumed
to wait."""

PATIENCE_S: Final = 20.0
"""After standing this long, drivers ignore others that stand too (after SUMO's ignored junction
blockers)."""

BLOCKED_MPS: Final = 2.0
"""A leader slower than this may come to a stand in the way."""


@dataclass(slots=True)
class ApproachingVehicle:
    """A vehicle on its way over a junction path.

    Attributes:
        vehicle: which.
        to_line: front bumper to the beginning of the path, m; negative beyond it.
        held: whether a light or a sign made it stop at the line a step ago.
    """

    vehicle: Vehicle
    to_line: float
    held: bool


Approaching: TypeAlias = dict[LaneIndex, list[ApproachingVehicle]]
"""The vehicles on their way over each junction path."""


class Passage(NamedTuple):
    """How a driver is going to pass a conflict.

    Attributes:
        agent: its id.
        to_line: front bumper to the beginning of its path, m.
        rank: right-of-way rank.
        entered: whether it is inside the junction.
        after_green: whether it is inside on a path whose light has turned red.
        stood_s: for how long it has stood, s.
        enter_s: when it reaches the conflict, s from now.
        leave_s: when it has left it, s.
        gap_acceptance_s: see `behaviors.profiles.Profile`.
        insistence: likewise.
    """

    agent: int
    to_line: float
    rank: int
    entered: bool
    after_green: bool
    stood_s: float
    enter_s: float
    leave_s: float
    gap_acceptance_s: float
    insistence: float


class Foe(NamedTuple):
    """A vehicle on its way over the other path of a conflict.

    Attributes:
        agent: its id.
        to_line: front bumper to the beginning of its path, m.
        begin: to the conflict, m.
        end: until its rear has left the conflict, m.
        rank: right-of-way rank.
        entered: whether it is inside the junction.
        held: whether a light or a sign made it stop at the line a step ago.
        speed: m/s.
        stood_s: for how long it has stood, s.
    """

    agent: int
    to_line: float
    begin: float
    end: float
    rank: int
    entered: bool
    held: bool
    speed: float
    stood_s: float


def approaching_vehicles(road: RoadState, ahead: list[WayAhead]) -> Approaching:
    """The vehicles that come to, are on, or have not quite left each junction path."""
    found: Approaching = {}
    for way in ahead:
        vehicle = way.vehicle
        commands = getattr(vehicle, "commands", None)
        held = commands is not None and commands.held
        if way.path is not None and way.to_line < RANGE_M:
            found.setdefault(way.path, []).append(ApproachingVehicle(vehicle, way.to_line, held))
        left = getattr(vehicle, "last_path", None)
        if left is not None and left != way.path:
            if way.s - vehicle.LENGTH / 2 < 0.0:
                beyond = -(road.network_info.lanes[left].length + way.front)
                found.setdefault(left, []).append(ApproachingVehicle(vehicle, beyond, False))
            else:
                vehicle.last_path = None
                vehicle.ran_red = False
    return found


def right_of_way_rank(road: RoadState, vehicle: Vehicle) -> int:
    """A vehicle's rank inside a junction: 0 with priority, 1 without, 2 after running a red light.

    The lower rank goes first.
    """
    if getattr(vehicle, "ran_red", False):
        return 2
    path = getattr(vehicle, "last_path", None) or road.onward_lane(vehicle, vehicle.lane_index)
    if path is None:
        return 0
    return _rank(road, vehicle, road.network_info.info[path], entered=True)


def _rank(road: RoadState, vehicle: Vehicle, path: LaneInfo, *, entered: bool) -> int:
    red = path.signal >= 0 and road.signals[path.signal] == Signal.RED.code
    if getattr(vehicle, "ran_red", False) or (red and not entered):
        return 2
    return 1 if path.must_yield else 0


@in_place()
def reach_s(speed: float, distance: float, accel: float, top: float) -> float:
    """Time to cover a distance while speeding up to a top speed, s."""
    if distance <= 0.0:
        return 0.0
    top = max(top, speed, 0.5)
    gaining = (top * top - speed * speed) / (2.0 * accel)
    if distance <= gaining:
        return (-speed + math.sqrt(speed * speed + 2.0 * accel * distance)) / accel
    return (top - speed) / accel + (distance - gaining) / top


def obey_stop_line(road: RoadState, way: WayAhead, commands: DriverCommands) -> None:
    """Stop at the line for lights, stop signs and a blocked exit.

    Args:
        road: the road.
        way: of a driver that comes to a junction path.
        commands: the driver's; added to.
    """
    assert way.path is not None
    info = road.network_info.info[way.path]
    if info.signal >= 0:
        red = road.signals[info.signal] == Signal.RED.code
        first = red and road.neighbours(way.vehicle, way.lane).front_gap > way.to_line
        commands.held = _stops_at_light(road, way, info.signal, first)
    if info.must_stop and not commands.held:
        commands.held = stops_at_sign(way.vehicle, way.path, way.to_line)
    if commands.held:
        commands.stop_within(way.to_line)
    if not commands.held and _exit_blocked(road, way):
        commands.stop_within(way.to_line)


def _stops_at_light(road: RoadState, way: WayAhead, signal: int, first: bool) -> bool:
    vehicle, state = way.vehicle, road.signals[signal]
    if state == Signal.RED.code:
        if first and runs_red(vehicle, way.path):
            return False
        return can_stop(vehicle.speed, way.to_line, vehicle.parameters[driving.EMERGENCY_DECEL])
    if state == Signal.YELLOW.code:
        elapsed = road.time_s - road.signal_since[signal]
        if elapsed < vehicle.profile.yellow_run_s:
            return False
        return can_stop(vehicle.speed, way.to_line, vehicle.parameters[driving.COMFORT_DECEL])
    return False


def runs_red(vehicle: ProfileVehicle, path: LaneIndex | None) -> bool:
    """Whether the first driver before a red light runs it: drawn once per encounter."""
    return draw_once(vehicle, ("red", path), vehicle.profile.red_run_probability)


def stops_at_sign(vehicle: ProfileVehicle, path: LaneIndex | None, to_line: float) -> bool:
    """Whether a driver stops at a stop sign, ``to_line`` m ahead, or has stopped there."""
    if to_line < STOPPED_M and vehicle.speed < driving.STANDING_MPS:
        vehicle.draws["stood", path] = True
    rolls = draw_once(vehicle, ("roll", path), vehicle.profile.stop_roll_probability)
    return not rolls and not vehicle.draws.get(("stood", path), False)


def _exit_blocked(road: RoadState, way: WayAhead) -> bool:
    """Whether the driver would have to stop inside the junction, behind a standing leader."""
    vehicle = way.vehicle
    assert way.path is not None
    lead = road.neighbours(vehicle, way.lane)
    if lead.front is None or lead.front_speed > BLOCKED_MPS or lead.front_gap < way.to_line:
        return False
    inside = road.network_info.lanes[way.path].length
    needed = way.to_line + inside + vehicle.LENGTH + float(vehicle.parameters[driving.MIN_GAP])
    return bool(lead.front_gap < needed)


def yield_to_conflicts(
    road: RoadState, way: WayAhead, approaching: Approaching, commands: DriverCommands
) -> None:
    """Stop before each conflict at which another vehicle goes first.

    Args:
        road: the road.
        way: of a driver that comes to a junction path or is on it.
        approaching: who is on its way over each junction path.
        commands: the driver's; added to.
    """
    vehicle, path = way.vehicle, way.path
    assert path is not None
    info = road.network_info.info[path]
    entered = way.to_line < -ENTERED_M
    rank = _rank(road, vehicle, info, entered=entered)
    light = info.signal if entered and vehicle.lane_index == path else -1
    after_green = light >= 0 and bool(road.signals[light] == Signal.RED.code)
    stood_s, profile = float(road.stood_s(vehicle)), vehicle.profile
    top = vehicle.desired_speed
    accel = float(vehicle.parameters[driving.MAX_ACCEL])
    delay = profile.startup_delay_s if vehicle.speed < driving.STANDING_MPS else 0.0
    for conflict in info.conflicts:
        foes = approaching.get(conflict.other)
        if not foes:
            continue
        begin = way.to_line + conflict.begin_s
        end = way.to_line + conflict.end_s + vehicle.LENGTH
        if begin <= 0.0 or end < 0.0:
            continue  # in it or past it already
        enter_s = delay + float(reach_s(vehicle.speed, begin, accel, top))
        leave_s = delay + float(reach_s(vehicle.speed, end, accel, top))
        own = Passage(
            agent=vehicle.agent,
            to_line=float(way.to_line),
            rank=rank,
            entered=bool(entered),
            after_green=after_green,
            stood_s=stood_s,
            enter_s=enter_s,
            leave_s=leave_s,
            gap_acceptance_s=float(profile.gap_acceptance_s),
            insistence=float(profile.insistence),
        )
        for foe in foes:
            if foe.vehicle is vehicle or not must_wait(own, _foe(road, conflict, foe)):
                continue
            at_line = not entered and (conflict.begin_s < AT_LINE_M or rank == 2)
            gap = way.to_line if at_line else begin - CONFLICT_MARGIN_M
            if can_stop(vehicle.speed, gap, vehicle.parameters[driving.EMERGENCY_DECEL]):
                commands.stop_within(gap)


def _foe(road: RoadState, conflict: Conflict, foe: ApproachingVehicle) -> Foe:
    vehicle, to_line = foe.vehicle, foe.to_line
    entered = to_line < -ENTERED_M
    return Foe(
        agent=agent_of(vehicle),
        to_line=float(to_line),
        begin=float(to_line + conflict.other_begin_s),
        end=float(to_line + conflict.other_end_s + vehicle.LENGTH),
        rank=_rank(road, vehicle, road.network_info.info[conflict.other], entered=entered),
        entered=bool(entered),
        held=bool(foe.held),
        speed=float(max(vehicle.speed, 0.0)),
        stood_s=road.stood_s(vehicle),
    )


@in_place()
def must_wait(own: Passage, foe: Foe) -> bool:
    """Whether a driver has to wait for another one before a conflict."""
    if foe.end < 0.0:
        return False
    speed = foe.speed
    if foe.begin <= 0.0:  # it is in the conflict
        if own.stood_s > 2.0 * PATIENCE_S and foe.stood_s > PATIENCE_S:
            return False
        return own.enter_s < foe.end / max(speed, 0.5) + CLEARANCE_S
    if foe.held:
        return False
    if own.stood_s > PATIENCE_S and foe.stood_s > 1.0:
        return False
    if foe.stood_s > WAITING_S and (foe.entered or foe.rank >= own.rank or own.after_green):
        return False  # it waits itself, for this vehicle or for another
    foe_enters_s = reach_s(speed, foe.begin, FOE_ACCEL_MPS2, max(speed, 8.0))
    foe_leaves_s = foe.end / max(speed, 2.0)
    if _goes_first(own, foe):
        if not foe.entered or speed < driving.STANDING_MPS:
            return False
        return foe_enters_s < own.enter_s and own.enter_s < foe_leaves_s + CLEARANCE_S
    critical_s = own.gap_acceptance_s
    if _gap_accepted(own.enter_s, own.leave_s, foe_enters_s, foe_leaves_s, critical_s, CLEARANCE_S):
        return False
    braking = speed * speed / (2.0 * foe.begin)
    insists = own.insistence * INSISTED_BRAKING_MPS2
    lets_in = insists > 0.0 and braking <= insists and speed > 1.0
    return not (lets_in and own.leave_s < foe_leaves_s)


@in_place(inner=True)
def _goes_first(own: Passage, foe: Foe) -> bool:
    """Whether a driver has the right of way over another one: by rank, place, then number."""
    if own.rank != foe.rank:
        return own.rank < foe.rank
    if own.entered != foe.entered:
        return own.entered
    if abs(own.to_line - foe.to_line) > 0.5:
        return own.to_line < foe.to_line
    return own.agent < foe.agent
