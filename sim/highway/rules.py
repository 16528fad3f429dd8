"""The rules of the road, worked out once per step for every driver near a junction or a crossing.

For each driver: how fast the next bend may be taken; whether to stop at the line (red and yellow
lights, stop signs, a blocked exit); for whom to wait before crossing another's way, by signals,
priority and the gap the driver demands; and for which pedestrians to stop. Whether a driver obeys
is drawn once per encounter from the driver's own chance.

References:
    Gap acceptance: Raff (1950); here a gap is the time left between two predicted passages.
    Dilemma zone at yellow: Gazis, Herman, Maradudin (1960), Operations Research 8, 112.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from highway_env.vehicle.kinematics import Vehicle

from behaviors.driver_models import braking_speed, gap_accepted
from sim.frames import EventKind, Signal
from sim.highway import driving
from sim.highway.network import Conflict, LaneIndex
from sim.highway.vehicle import Orders, ProfileVehicle
from sim.highway.walkers import Walker, strip_half

if TYPE_CHECKING:
    from sim.highway.traffic import TrafficRoad

SIGHT_M: Final = 80.0
"""How far ahead junctions and crossings are attended to (our choice: 6 s at 14 m/s)."""

BEND_FACTOR: Final = 1.2
"""Nobody takes a bend faster than this times its limit (our choice: the limits of junction paths
follow from lateral acceleration)."""

BEND_BRAKING: Final = 0.7
"""Share of the comfortable braking used ahead of a bend (our choice)."""

ENTERED_M: Final = 0.5
"""Who is this far over the line has entered the junction."""

LINE_M: Final = 3.0
"""Who has stood this near the line has stopped at it."""

MARGIN_S: Final = 0.3
"""Time between two passages of a conflict that leaves no doubt (our choice)."""

MARGIN_M: Final = 0.7
"""Distance kept to another's path when waiting inside a junction (our choice)."""

FOE_ACCEL_MPS2: Final = 2.0
"""Acceleration that others are expected to use (our choice)."""

INSISTED_BRAKING_MPS2: Final = 4.5
"""Braking that the most insistent driver makes others with priority do (our choice)."""

AT_LINE_M: Final = 5.0
"""A conflict that begins this soon after the line is waited for at the line."""

WAITING_S: Final = 1.0
"""Who has stood this long inside a junction, or before it without priority, is taken to wait (our
choice)."""

PATIENCE_S: Final = 20.0
"""After standing this long, drivers go in spite of others that stand too (our choice, as SUMO's
ignored junction blockers)."""

KERB_SOON_S: Final = 4.0
"""A pedestrian this near the kerb is seen to want to cross (our choice), by drivers who demand at
least that gap."""

MET_S: Final = 3.0
"""A driver who would pass less than this before a pedestrian meets that pedestrian, whatever the
driver thinks of it (our choice): events tell who yielded and who did not."""

MET_KERB_S: Final = 2.0
"""And the pedestrian is on the crossing or this near its kerb (our choice)."""

STALLED_S: Final = 4.0
"""A pedestrian who has stood this long on the crossing, out of one's way, waits for the vehicles
(our choice; without it each would wait for the other in a full junction)."""

DANGER_S: Final = 1.0
"""Everybody brakes for a pedestrian who steps onto the lane within this time (our choice)."""

BLOCKED_MPS: Final = 2.0
"""A leader slower than this may come to a stand in the way (our choice)."""

NO_CHANGE_M: Final = (15.0, 20.0)
"""No lane changes this soon after and before a junction (our choice)."""


@dataclass(slots=True)
class Approach:
    """A vehicle on its way over a junction path.

    Attributes:
        vehicle: which.
        to_line: front bumper to the beginning of the path, m; negative beyond it.
        held: whether a light or a sign made it stop at the line a step ago.
    """

    vehicle: Vehicle
    to_line: float
    held: bool


@dataclass(slots=True)
class _View:
    """What is known of one driver's way ahead in this step."""

    vehicle: Vehicle
    lane: LaneIndex
    s: float
    front: float
    path: LaneIndex | None
    to_line: float


def give_orders(road: TrafficRoad) -> None:
    """Work out what the rules demand of everybody, and note who comes to which crossing.

    Args:
        road: after its `look`.
    """
    views = [_view(road, vehicle) for vehicle in road.vehicles]
    approaching = _approaching(road, views)
    _note_red_runs(road, views)
    on_foot = _people(road)
    orders: list[Orders | None] = []
    for view in views:
        if isinstance(view.vehicle, ProfileVehicle):
            orders.append(_orders(road, view, approaching, on_foot))
        else:
            orders.append(None)
    arrivals: dict[tuple[int, int], list[object]] = {}
    for view, order in zip(views, orders, strict=True):
        if order is not None:
            view.vehicle.orders = order
        _note_arrivals(road, view, order, arrivals)
    road.arrivals = arrivals  # type: ignore[assignment]


def _view(road: TrafficRoad, vehicle: Vehicle) -> _View:
    lane = vehicle.lane_index
    s, _ = road.place(vehicle, lane)
    front = s + vehicle.LENGTH / 2
    info = road.network_info.info[lane]
    if info.connector:
        vehicle.last_path = lane
        return _View(vehicle, lane, s, front, lane, -front)
    path = road.onward_lane(vehicle, lane)
    return _View(vehicle, lane, s, front, path, road.network_info.lanes[lane].length - front)


def _approaching(road: TrafficRoad, views: list[_View]) -> dict[LaneIndex, list[Approach]]:
    """Who comes to, is on, or has not quite left each junction path."""
    found: dict[LaneIndex, list[Approach]] = {}
    for view in views:
        orders = getattr(view.vehicle, "orders", None)
        held = orders is not None and orders.held
        if view.path is not None and view.to_line < SIGHT_M:
            found.setdefault(view.path, []).append(Approach(view.vehicle, view.to_line, held))
        left = getattr(view.vehicle, "last_path", None)
        if left is not None and left != view.path:
            if view.s - view.vehicle.LENGTH / 2 < 0.0:
                beyond = -(road.network_info.lanes[left].length + view.front)
                found.setdefault(left, []).append(Approach(view.vehicle, beyond, False))
            else:
                view.vehicle.last_path = None
                view.vehicle.ran_red = False
    return found


def rank_of(road: TrafficRoad, vehicle: Vehicle) -> int:
    """Who goes first inside a junction: 0 with priority, 1 without, 2 after running a red."""
    if getattr(vehicle, "ran_red", False):
        return 2
    lane = getattr(vehicle, "last_path", None) or road.onward_lane(vehicle, vehicle.lane_index)
    if lane is None:
        return 0
    info = road.network_info.info[lane]
    return _rank(road, vehicle, info.signal, info.must_yield, entered=True)


def _rank(
    road: TrafficRoad, vehicle: Vehicle, signal: int, must_yield: bool, *, entered: bool
) -> int:
    red = signal >= 0 and road.signals[signal] == Signal.RED.code
    if getattr(vehicle, "ran_red", False) or (red and not entered):
        return 2
    return 1 if must_yield else 0


def _note_red_runs(road: TrafficRoad, views: list[_View]) -> None:
    for view in views:
        vehicle = view.vehicle
        before = getattr(vehicle, "line_before", None)
        vehicle.line_before = None if view.path is None else (view.path, view.to_line)
        if view.path is None or before is None or before[0] != view.path:
            continue
        if not (before[1] > 0.0 >= view.to_line):
            continue
        info = road.network_info.info[view.path]
        if info.signal >= 0 and road.signals[info.signal] == Signal.RED.code:
            vehicle.ran_red = True
            road.add_event(EventKind.RED_RUN, int(getattr(vehicle, "agent", -1)))
        if info.must_stop and not getattr(vehicle, "draws", {}).get(("stood", view.path), False):
            road.add_event(EventKind.STOP_ROLLED, int(getattr(vehicle, "agent", -1)))


def _people(road: TrafficRoad) -> dict[int, list[tuple[Walker, float, bool]]]:
    """Who is on or near each crossing: how far beyond its kerb, m, and whether it is on it."""
    found: dict[int, list[tuple[Walker, float, bool]]] = {}
    for walker in road.walkers:
        way = walker.crossover
        if way is None or walker.hit:
            continue
        beyond = walker.s - way.begin_s
        if beyond > 0.0 or -beyond <= KERB_SOON_S * walker.free_speed:
            found.setdefault(way.crossing, []).append((walker, beyond, beyond > 0.0))
    return found


def _reach_s(speed: float, distance: float, accel: float, top: float) -> float:
    """Time to cover a distance while speeding up to a top speed, s."""
    if distance <= 0.0:
        return 0.0
    top = max(top, speed, 0.5)
    gaining = (top * top - speed * speed) / (2.0 * accel)
    if distance <= gaining:
        return (-speed + math.sqrt(speed * speed + 2.0 * accel * distance)) / accel
    return (top - speed) / accel + (distance - gaining) / top


def _stoppable(speed: float, distance: float, decel: float) -> bool:
    return speed * speed <= 2.0 * decel * max(distance, 0.05)


def _draw(vehicle: ProfileVehicle, key: tuple[str, object], probability: float) -> bool:
    """Whether a driver does something in this encounter: drawn once, then kept."""
    if key not in vehicle.draws:
        vehicle.draws[key] = bool(vehicle.wishes.rng.random() < probability)
    return vehicle.draws[key]


def _orders(
    road: TrafficRoad,
    view: _View,
    approaching: dict[LaneIndex, list[Approach]],
    on_foot: dict[int, list[tuple[Walker, float, bool]]],
) -> Orders:
    vehicle, network = view.vehicle, road.network_info
    orders = Orders()
    lane, info = network.lanes[view.lane], network.info[view.lane]
    numbers = vehicle.numbers
    factor = min(numbers[driving.SPEED_FACTOR], BEND_FACTOR)
    then = road.next_stretch(vehicle, view.lane[:2])
    if info.connector:
        orders.speed_cap = factor * lane.speed_limit
        orders.changes = False
    elif network.exit_of or then is not None:
        orders.changes = view.s > NO_CHANGE_M[0] and (then is None or view.to_line > NO_CHANGE_M[1])
        if then is not None and view.path is None and view.to_line < SIGHT_M:
            orders.stop_gap = view.to_line  # on a lane that does not lead there
            orders.held = True
            orders.changes = True
    if view.lane[0].startswith("~"):
        if view.to_line < SIGHT_M:
            orders.stop_gap = view.to_line - LINE_M
        return orders
    if view.path is not None and view.to_line < SIGHT_M:
        if not info.connector:
            bend = factor * network.lanes[view.path].speed_limit
            braking = BEND_BRAKING * numbers[driving.COMFORT_DECEL]
            orders.speed_cap = braking_speed(max(view.to_line, 0.0), bend, braking)
        if view.to_line > -ENTERED_M:
            _at_line(road, view, orders)
        if not orders.held:
            _conflicts(road, view, approaching, orders)
    _crossings(road, view, on_foot, orders)
    through = view.path is not None and not network.info[view.path].must_yield
    if through and -ENTERED_M < view.to_line < orders.stop_gap < math.inf:
        _stop(orders, view.to_line)  # nobody with priority enters to stop inside
    return orders


def _stop(orders: Orders, gap: float) -> None:
    orders.stop_gap = min(orders.stop_gap, gap)


def _at_line(road: TrafficRoad, view: _View, orders: Orders) -> None:
    """Lights, stop signs and blocked exits at the stop line."""
    vehicle, path = view.vehicle, view.path
    assert path is not None
    info = road.network_info.info[path]
    speed, to_line = vehicle.speed, view.to_line
    if info.signal >= 0:
        state = road.signals[info.signal]
        if state == Signal.RED.code:
            lead = road.around(vehicle, view.lane)
            first = lead.front_gap > to_line
            runs = first and _draw(vehicle, ("red", path), vehicle.profile.red_run_probability)
            hard = float(vehicle.numbers[driving.EMERGENCY_DECEL])
            if not runs and _stoppable(speed, to_line, hard):
                _stop(orders, to_line)
                orders.held = True
        elif state == Signal.YELLOW.code:
            elapsed = road.time_s - road.signal_since[info.signal]
            comfort = float(vehicle.numbers[driving.COMFORT_DECEL])
            if elapsed >= vehicle.profile.yellow_run_s and _stoppable(speed, to_line, comfort):
                _stop(orders, to_line)
                orders.held = True
    if info.must_stop and not orders.held:
        if to_line < LINE_M and speed < driving.STANDING_MPS:
            vehicle.draws["stood", path] = True
        rolls = _draw(vehicle, ("roll", path), vehicle.profile.stop_roll_probability)
        if not rolls and not vehicle.draws.get(("stood", path), False):
            _stop(orders, to_line)
            orders.held = True
    if not orders.held and _exit_blocked(road, view):
        _stop(orders, to_line)


def _exit_blocked(road: TrafficRoad, view: _View) -> bool:
    """Whether one would come to a stand inside the junction behind a standing leader."""
    vehicle = view.vehicle
    assert view.path is not None
    lead = road.around(vehicle, view.lane)
    if lead.front is None or lead.front_speed > BLOCKED_MPS or lead.front_gap < view.to_line:
        return False
    inside = road.network_info.lanes[view.path].length
    needed = view.to_line + inside + vehicle.LENGTH + float(vehicle.numbers[driving.MIN_GAP])
    return bool(lead.front_gap < needed)


def _conflicts(
    road: TrafficRoad,
    view: _View,
    approaching: dict[LaneIndex, list[Approach]],
    orders: Orders,
) -> None:
    vehicle, path = view.vehicle, view.path
    assert path is not None
    info = road.network_info.info[path]
    entered = view.to_line < -ENTERED_M
    mine = _rank(road, vehicle, info.signal, info.must_yield, entered=entered)
    stood = road.stood_s(vehicle)
    top = vehicle.desired_speed
    accel = float(vehicle.numbers[driving.MAX_ACCEL])
    delay = vehicle.profile.startup_delay_s if vehicle.speed < driving.STANDING_MPS else 0.0
    for conflict in info.conflicts:
        foes = approaching.get(conflict.other)
        if not foes:
            continue
        begin = view.to_line + conflict.begin_s
        end = view.to_line + conflict.end_s + vehicle.LENGTH
        if begin <= 0.0 or end < 0.0:
            continue  # in it or past it already
        enter = delay + _reach_s(vehicle.speed, begin, accel, top)
        leave = delay + _reach_s(vehicle.speed, end, accel, top)
        for foe in foes:
            if foe.vehicle is vehicle or not _blocks(
                road, vehicle, mine, entered, view.to_line, conflict, foe, enter, leave, stood
            ):
                continue
            at_line = not entered and (conflict.begin_s < AT_LINE_M or mine == 2)
            gap = view.to_line if at_line else begin - MARGIN_M
            if not _stoppable(vehicle.speed, gap, float(vehicle.numbers[driving.EMERGENCY_DECEL])):
                continue
            _stop(orders, gap)


def _blocks(
    road: TrafficRoad,
    vehicle: ProfileVehicle,
    mine: int,
    entered: bool,
    to_line: float,
    conflict: Conflict,
    foe: Approach,
    enter: float,
    leave: float,
    stood: float,
) -> bool:
    """Whether a driver has to wait for another one before a conflict."""
    other = foe.vehicle
    begin = foe.to_line + conflict.other_begin_s
    end = foe.to_line + conflict.other_end_s + other.LENGTH
    if end < 0.0:
        return False
    speed = max(other.speed, 0.0)
    foe_standing = road.stood_s(other)
    if begin <= 0.0:
        clears = end / max(speed, 0.5)
        if stood > 2.0 * PATIENCE_S and foe_standing > PATIENCE_S:
            return False
        return bool(enter < clears + MARGIN_S)
    if foe.held:
        return False
    if stood > PATIENCE_S and foe_standing > 1.0:
        return False
    info = road.network_info.info[conflict.other]
    foe_entered = foe.to_line < -ENTERED_M
    theirs = _rank(road, other, info.signal, info.must_yield, entered=foe_entered)
    own = road.network_info.info[vehicle.lane_index].signal if entered else -1
    clears = own >= 0 and road.signals[own] == Signal.RED.code  # after its green
    if foe_standing > WAITING_S and (foe_entered or theirs >= mine or clears):
        return False  # it waits itself, for this vehicle or for another
    foe_enters = _reach_s(speed, begin, FOE_ACCEL_MPS2, max(speed, 8.0))
    foe_leaves = end / max(speed, 2.0)
    profile = vehicle.profile
    if mine != theirs:
        first = mine < theirs
    elif entered != foe_entered:
        first = entered
    elif abs(to_line - foe.to_line) > 0.5:
        first = to_line < foe.to_line
    else:
        first = int(getattr(vehicle, "agent", -1)) < int(getattr(other, "agent", -1))
    if first:
        if not foe_entered or speed < driving.STANDING_MPS:
            return False
        return foe_enters < enter and enter < foe_leaves + MARGIN_S
    if gap_accepted(enter, leave, foe_enters, foe_leaves, profile.gap_acceptance_s, MARGIN_S):
        return False
    braking = speed * speed / (2.0 * begin)
    insists = profile.insistence * INSISTED_BRAKING_MPS2
    lets_in = insists > 0.0 and speed > 1.0 and braking <= insists and leave < foe_leaves
    return not lets_in


def _strips_ahead(
    road: TrafficRoad, view: _View
) -> list[tuple[LaneIndex, int, float, float, float]]:
    """Lane, crossing, front bumper to near and far edge, m, and place across, of what is ahead."""
    info = road.network_info.info
    found = [
        (view.lane, strip.crossing, strip.near_s - view.front, strip.far_s - view.front, strip.u)
        for strip in info[view.lane].strips
    ]
    if view.path is not None and view.path != view.lane:
        found += [
            (view.path, strip.crossing, strip.near_s + view.to_line, strip.far_s + view.to_line,
             strip.u)
            for strip in info[view.path].strips
        ]  # fmt: skip
    return found


def _crossings(
    road: TrafficRoad,
    view: _View,
    on_foot: dict[int, list[tuple[Walker, float, bool]]],
    orders: Orders,
) -> None:
    vehicle = view.vehicle
    profile, speed = vehicle.profile, vehicle.speed
    hard = float(vehicle.numbers[driving.EMERGENCY_DECEL])
    gentle = max(1.2 * float(vehicle.numbers[driving.COMFORT_DECEL]), 3.0)
    half = strip_half(road.network_info.lanes[view.lane].width / 2)
    yields = set()
    for _, crossing, near, far, u in _strips_ahead(road, view):
        if far + vehicle.LENGTH < 0.0:
            if vehicle.draws.pop(("met", crossing), False):
                yielded = vehicle.draws.pop(("yielded", crossing), False)
                kind = EventKind.YIELDED if yielded else EventKind.NOT_YIELDED
                road.add_event(kind, vehicle.agent)
            continue
        people = on_foot.get(crossing)
        if near > SIGHT_M or near < -ENTERED_M or not people:
            continue
        plan = road.network_info.road.crossings[crossing]
        lit = plan.signal >= 0 and road.signals[plan.signal] != Signal.OFF.code
        walk = not lit or road.signals[plan.signal] == Signal.GREEN.code
        comes = near / max(speed, 2.0)
        clears = (far + vehicle.LENGTH) / max(speed, 2.0)
        for walker, beyond, on in people:
            way = walker.crossover
            assert way is not None
            along = way.along(u)
            pace = walker.free_speed
            enters, leaves = (along - half - beyond) / pace, (along + half - beyond) / pace
            if leaves < 0.0:
                continue
            moving = walker.speed > 0.0
            if on and (enters <= 0.0 or (moving and enters < DANGER_S)):
                if _stoppable(speed, near, hard) and leaves > comes - DANGER_S:
                    _stop(orders, near)
                    yields.add(crossing)
                continue
            if on and walker.stood_s > STALLED_S:
                continue
            if not ((plan.priority or lit) and (on or walk)):
                continue
            if leaves < comes - DANGER_S or not _stoppable(speed, near, gentle):
                continue
            if enters < clears + MET_S and -beyond < MET_KERB_S * pace:
                vehicle.draws["met", crossing] = True
            if -beyond > profile.crossing_gap_s * pace:
                continue
            if enters < clears + profile.crossing_gap_s and _draw(
                vehicle, ("ped", crossing), profile.yield_probability
            ):
                vehicle.draws["yielded", crossing] = True
                _stop(orders, near)
                yields.add(crossing)
    orders.yields_to = frozenset(yields)


def _note_arrivals(
    road: TrafficRoad,
    view: _View,
    orders: Orders | None,
    arrivals: dict[tuple[int, int], list[object]],
) -> None:
    from sim.highway.traffic import Arrival

    vehicle = view.vehicle
    yields = orders.yields_to if orders is not None else frozenset()
    held = orders is not None and orders.held
    for lane, crossing, near, far, _ in _strips_ahead(road, view):
        if near > SIGHT_M or far + vehicle.LENGTH < 0.0:
            continue
        number = road.strip_number[lane, crossing]
        arrivals.setdefault((crossing, number), []).append(
            Arrival(near, far, vehicle, yields, held, road.stood_s(vehicle))
        )
