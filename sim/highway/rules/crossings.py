"""Pedestrian crossings: drivers that let pedestrians cross, and pedestrians that wait or walk.

At a signal pedestrians wait for green. At a zebra they step out when every vehicle that comes near
is far enough away, stands, or is going to let them cross. On the way they stop before a lane on
which a vehicle comes that does not. Whether a driver yields is drawn once per encounter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, TypeAlias

from sim.frames import EventKind, Signal
from sim.highway import driving
from sim.highway.rules.way_ahead import (
    ENTERED_M,
    RANGE_M,
    StripAhead,
    WayAhead,
    can_stop,
    draw_once,
)
from sim.highway.state import Arrival, RoadState
from sim.highway.vehicle import DriverCommands, ProfileVehicle
from sim.highway.walkers import Crossover, Walker

KERB_SOON_S: Final = 4.0
"""Drivers that demand at least this gap see that a pedestrian this near the kerb wants to cross."""

MET_S: Final = 3.0
"""A driver that would pass less than this before a pedestrian has met that pedestrian, and an event
records whether it yielded (encounters do not depend on the gap that drivers demand)."""

MET_KERB_S: Final = 2.0
"""A driver has met only pedestrians on the crossing or this near its kerb."""

STALLED_S: Final = 4.0
"""A pedestrian who has stood this long on the crossing, out of a vehicle's way, waits for the
vehicles (without it each would wait for the other in a full junction)."""

DANGER_S: Final = 1.0
"""All drivers brake for a pedestrian who steps onto their lane within this time, s."""

STRIP_M: Final = 0.1
"""The strip of a lane that vehicles and pedestrians keep clear of each other ends this far inside
the lane's edges, m: a pedestrian can stand between two lanes."""

WALKED_M: Final = 1.1
"""Half the width of the middle of a crossing on which pedestrians walk, m (`walkers.OFFSET_M`, half
a pedestrian and a little)."""

SPARE_S: Final = 0.7
"""Time to spare that a pedestrian wants before a vehicle comes, s."""

STOOD_S: Final = 0.8
"""Pedestrians assume that a vehicle waits that has stood this long before a crossing, s."""

KERB_M: Final = 0.4
"""Pedestrians decide this near the kerb whether to step out, m (half a stride)."""

Walkers: TypeAlias = dict[int, list[tuple[Walker, float]]]
"""The pedestrians on or near each crossing, and how far beyond its kerb they are, m."""


def walkers_at_crossings(road: RoadState) -> Walkers:
    """The pedestrians on each crossing and those who reach its kerb soon."""
    found: Walkers = {}
    for walker in road.walkers:
        way = walker.crossover
        if way is None or walker.hit:
            continue
        beyond = walker.s - way.begin_s
        if beyond > 0.0 or -beyond <= KERB_SOON_S * walker.free_speed:
            found.setdefault(way.crossing, []).append((walker, beyond))
    return found


def find_arrivals(
    road: RoadState, way: WayAhead, commands: DriverCommands | None
) -> Iterator[tuple[tuple[int, int], Arrival]]:
    """The crossings that a vehicle comes to.

    Args:
        road: the road.
        way: the vehicle's.
        commands: its driver's, if it has a profile.

    Yields:
        Crossing and number of the lane's strip on it, and the arrival.
    """
    vehicle = way.vehicle
    yields = commands.yields_to if commands is not None else frozenset()
    held = commands is not None and commands.held
    for strip in way.strips:
        if strip.near <= RANGE_M and strip.far + vehicle.LENGTH >= 0.0:
            place = strip.crossing, road.strip_number[strip.lane, strip.crossing]
            stood_s = road.stood_s(vehicle)
            yield place, Arrival(strip.near, strip.far, vehicle, yields, held, stood_s)


# Drivers -------------------------------------------------------------------------------------


def yield_at_crossings(
    road: RoadState, way: WayAhead, walkers: Walkers, commands: DriverCommands
) -> None:
    """Stop before crossings for pedestrians, and record who was let across.

    Args:
        road: the road.
        way: of a driver with a profile.
        walkers: on or near each crossing.
        commands: the driver's; added to.
    """
    vehicle = way.vehicle
    half = strip_half(road.network_info.lanes[way.lane].width / 2)
    yields = set()
    for strip in way.strips:
        if strip.far + vehicle.LENGTH < 0.0:
            record_encounter(road, vehicle, strip.crossing)
            continue
        people = walkers.get(strip.crossing)
        if strip.near > RANGE_M or strip.near < -ENTERED_M or not people:
            continue
        for walker, beyond in people:
            if _yields_to(road, way, strip, half, walker, beyond):
                commands.stop_within(strip.near)
                yields.add(strip.crossing)
    commands.yields_to = frozenset(yields)


def record_encounter(road: RoadState, vehicle: ProfileVehicle, crossing: int) -> None:
    """Record whether a driver that has passed a crossing yielded to those it met there."""
    draws = vehicle.draws
    if draws.pop(("met", crossing), False):
        yielded = draws.pop(("yielded", crossing), False)
        kind = EventKind.YIELDED if yielded else EventKind.NOT_YIELDED
        road.add_event(kind, vehicle.agent)


def _yields_to(
    road: RoadState, way: WayAhead, strip: StripAhead, half: float, walker: Walker, beyond: float
) -> bool:
    """Whether a driver stops for a pedestrian who is ``beyond`` m past the kerb of a crossing."""
    vehicle, crossover = way.vehicle, walker.crossover
    assert crossover is not None
    speed, on = vehicle.speed, beyond > 0.0
    crossing = road.network_info.road.crossings[strip.crossing]
    lit = crossing.signal >= 0 and road.signals[crossing.signal] != Signal.OFF.code
    walk = not lit or road.signals[crossing.signal] == Signal.GREEN.code
    comes_s = strip.near / max(speed, 2.0)
    clears_s = (strip.far + vehicle.LENGTH) / max(speed, 2.0)
    along, pace = crossover.along(strip.u), walker.free_speed
    enters_s, leaves_s = (along - half - beyond) / pace, (along + half - beyond) / pace
    if leaves_s < 0.0:
        return False
    if on and (enters_s <= 0.0 or (walker.speed > 0.0 and enters_s < DANGER_S)):
        hard = vehicle.parameters[driving.EMERGENCY_DECEL]
        return can_stop(speed, strip.near, hard) and leaves_s > comes_s - DANGER_S
    if on and walker.stood_s > STALLED_S:
        return False
    if not ((crossing.priority or lit) and (on or walk)):
        return False
    gentle = max(1.2 * vehicle.parameters[driving.COMFORT_DECEL], 3.0)
    if leaves_s < comes_s - DANGER_S or not can_stop(speed, strip.near, gentle):
        return False
    if enters_s < clears_s + MET_S and -beyond < MET_KERB_S * pace:
        vehicle.draws["met", strip.crossing] = True
    gap_s = vehicle.profile.crossing_gap_s
    if -beyond > gap_s * pace or enters_s >= clears_s + gap_s:
        return False
    if not draw_once(vehicle, ("ped", strip.crossing), vehicle.profile.yield_probability):
        return False
    vehicle.draws["yielded", strip.crossing] = True
    return True


# Pedestrians ---------------------------------------------------------------------------------


def may_walk(road: RoadState, walker: Walker, dt: float) -> bool:
    """Whether a pedestrian walks on in a step of ``dt`` s, or waits.

    Args:
        road: after `sim.highway.rules.commands.give_commands` found the arrivals.
        walker: the pedestrian.
        dt: s.
    """
    way = walker.crossover
    if walker.hit:
        return False
    if way is None:
        return True
    stride = walker.free_speed * dt
    if walker.s < way.begin_s:
        return way.begin_s - walker.s > max(KERB_M, stride) or _may_start(road, walker, way)
    return all(
        _is_safe(road, walker, strip)
        for strip in _strips(road, way)
        if walker.s <= strip[0] < walker.s + stride
    )


def _strips(road: RoadState, way: Crossover) -> list[tuple[float, float, tuple[int, int]]]:
    """Begin and end along the way, m, of each lane to cross, and its crossing and strip."""
    found = []
    for number, (u, half) in enumerate(road.strips_of[way.crossing]):
        middle, half = way.begin_s + way.along(u), strip_half(half)
        found.append((middle - half, middle + half, (way.crossing, number)))
    return sorted(found)


def _may_start(road: RoadState, walker: Walker, way: Crossover) -> bool:
    signal = road.network_info.road.crossings[way.crossing].signal
    lit = signal >= 0 and road.signals[signal] != Signal.OFF.code
    if lit and road.signals[signal] != Signal.GREEN.code:
        return False
    strips = _strips(road, way)
    return all(_is_safe(road, walker, strip) for strip in (strips[:1] if lit else strips))


def _is_safe(road: RoadState, walker: Walker, strip: tuple[float, float, tuple[int, int]]) -> bool:
    """Whether a pedestrian can cross a lane before any vehicle reaches it.

    A vehicle that waits before the crossing holds those behind it back.
    """
    begin, end, place = strip
    enter_s = max(begin - walker.s, 0.0) / walker.free_speed
    leave_s = (end - walker.s) / walker.free_speed
    for arrival in sorted(road.arrivals.get(place, ()), key=lambda each: each.near):
        speed, half = arrival.vehicle.speed, (arrival.far - arrival.near) / 2
        near, far = arrival.near + half - WALKED_M, arrival.far - half + WALKED_M
        clear_s = (far + arrival.vehicle.LENGTH) / max(speed, 0.5)
        if clear_s < 0.0 or (speed > 0.5 and clear_s < enter_s - 0.2):
            continue  # past it before the pedestrian comes
        if near <= 0.1:
            return False
        yields = place[0] in arrival.yields or arrival.held
        if (yields and speed * speed <= 2.0 * 5.0 * near) or arrival.stood_s > STOOD_S:
            return True
        comes_s = near / speed if speed >= 2.0 else -speed + math.sqrt(speed * speed + 2.0 * near)
        if comes_s <= leave_s + SPARE_S:
            return False
    return True


def strip_half(half_width: float) -> float:
    """Half the width of a lane's strip of a crossing, m, for half the lane's width."""
    return half_width - STRIP_M
