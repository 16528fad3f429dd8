"""Junctions: stop lines, and waiting for vehicles on crossing paths.

A driver waits by signals, priority and the gap that it demands; whether it obeys a red light or a
stop sign is drawn once per encounter from the driver's own random numbers.

References:
    Gap acceptance: Raff, Hart (1950), see `behaviors.driver_models.gap_accepted`.
    Dilemma zone at yellow: Gazis, Herman, Maradudin (1960), Operations Research 8, 112.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from highway_env.vehicle.kinematics import Vehicle

from behaviors import driver_models
from sim.compiled import in_place, shared
from sim.frames import Signal
from sim.highway import driving
from sim.highway.lanes import LaneIndex
from sim.highway.network import LaneInfo
from sim.highway.rules.way_ahead import draw_once
from sim.highway.state import RoadState
from sim.highway.vehicle import ProfileVehicle

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


def runs_red(vehicle: ProfileVehicle, path: LaneIndex | None) -> bool:
    """Whether the first driver before a red light runs it: drawn once per encounter."""
    return draw_once(vehicle, ("red", path), vehicle.profile.red_run_probability)


def stops_at_sign(vehicle: ProfileVehicle, path: LaneIndex | None, to_line: float) -> bool:
    """Whether a driver stops at a stop sign, ``to_line`` m ahead, or has stopped there."""
    if to_line < STOPPED_M and vehicle.speed < driving.STANDING_MPS:
        vehicle.draws["stood", path] = True
    rolls = draw_once(vehicle, ("roll", path), vehicle.profile.stop_roll_probability)
    return not rolls and not vehicle.draws.get(("stood", path), False)


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
