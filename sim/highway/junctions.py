"""Junctions: bends, stop lines, and waiting for vehicles on crossing paths.

A driver waits by signals, priority and the gap that it demands; whether it obeys a red light or a
stop sign is drawn once per encounter.

References:
    Gap acceptance: Raff, Hart (1950), see `behaviors.driver_models.gap_accepted`.
    Dilemma zone at yellow: Gazis, Herman, Maradudin (1960), Operations Research 8, 112.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from behaviors import driver_models
from sim.compiled import in_place, shared
from sim.frames import Signal
from sim.highway import driving
from sim.highway.driving import STANDING_MPS, attention_m, can_stop, chance, desired_speed
from sim.highway.places import along_lane, beside, next_stretch, path_to, record
from sim.highway.state import RED_RUN, STOP_ROLLED, Scene

_gap_accepted = shared(driver_models.gap_accepted)
braking_speed = shared(driver_models.braking_speed)

RED, YELLOW = Signal.RED.code, Signal.YELLOW.code

ENTERED_M, BLOCKED_MPS = 0.5, 2.0
"""A vehicle whose front is this far over the stop line has entered the junction. A leader slower
than this may come to a stand in the way."""

BEND_FACTOR, BEND_BRAKING = 1.2, 0.7
"""Largest factor by which a driver exceeds the limit of a junction path (these limits follow from
lateral acceleration), and the share of the comfortable braking used ahead of it."""

NO_CHANGE_M: Final = (15.0, 20.0)
"""Drivers do not change lanes this soon after and before a junction, m."""

LINE_M, STOPPED_M, AT_LINE_M = 3.0, 3.0, 5.0
"""A driver on the wrong side stops this far before a junction; a vehicle that stood this near the
line has stopped at it; drivers wait at the line for a conflict that begins this soon after it."""

CLEARANCE_S, CONFLICT_MARGIN_M = 0.3, 0.7
"""Time that has to pass between two vehicles at a conflict, and the distance that drivers keep to
another's path when they wait inside a junction."""

FOE_ACCEL_MPS2, INSISTED_BRAKING_MPS2 = 2.0, 4.5
"""Acceleration that drivers expect of others, and the braking that the most insistent driver
imposes on others with priority."""

WAITING_S, PATIENCE_S = 1.0, 20.0
"""A vehicle that has stood this long inside a junction, or before it without priority, is assumed
to wait. After standing for as long as their patience lasts, drivers ignore others that stand too
(after SUMO's ignored junction blockers)."""


@in_place(inner=True)
def look_ahead(scene: Scene) -> None:
    """Find where each vehicle is on its way, and which drivers stop for a light or a sign.

    Those who have just broken a rule at a line are recorded.
    """
    lanes, now_s = scene.net.lanes, scene.now[0].time_s
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        lane = lanes[me.lane]
        me.s = along_lane(me, me.lane, scene.net)
        front = me.s + me.length / 2
        me.then = next_stretch(me, me.lane, scene)
        time_s = me.clock if me.profiled else now_s
        me.stood_s = 0.0 if me.standing_since == np.inf else time_s - me.standing_since
        if lane.connector:
            me.last_path = me.path = me.lane
            me.to_line = -front
        else:
            me.path = path_to(me.lane, me.then, scene.net) if me.then >= 0 else -1
            me.to_line = lane.length - front
        if me.last_path >= 0 and me.last_path != me.path and me.s - me.length / 2 >= 0.0:
            me.last_path, me.ran_red = -1, False
        if me.path >= 0 and me.path == me.path_before and me.line_before > 0.0 >= me.to_line:
            if _shows(me.path, RED, scene):
                me.ran_red = True
                record(RED_RUN, me.agent, scene)
            if lanes[me.path].must_stop and me.stood_at != me.path:
                record(STOP_ROLLED, me.agent, scene)
        me.path_before, me.line_before = me.path, me.to_line
        me.was_held, me.held, me.stop_gap, me.forced = me.held, False, np.inf, -1
        obeys = me.profiled and me.path >= 0 and not lane.wrong
        if obeys and -ENTERED_M < me.to_line < attention_m(me):
            me.held = _stops_at_light(me, scene) or _stops_at_sign(me, scene)


@in_place(inner=True)
def _shows(path: int, state: int, scene: Scene) -> bool:
    """Whether the light of a path shows a state."""
    group = scene.net.lanes[path].signal
    return bool(group >= 0 and scene.signals[group] == state)


@in_place(inner=True)
def _stops_at_light(me: Any, scene: Scene) -> bool:
    if _shows(me.path, RED, scene):
        first = beside(me, me.lane, scene).front_gap > me.to_line
        if first and chance(me.key, driving.RUNS_RED, me.path) < me.red_run_probability:
            return False
        if chance(me.key, driving.OVERLOOKS_LIGHT, me.path) < me.overlook_probability:
            return False
        return can_stop(me.speed, me.to_line, me.emergency_decel)
    if _shows(me.path, YELLOW, scene):
        shown_s = scene.now[0].time_s - scene.signal_since[scene.net.lanes[me.path].signal]
        stops = can_stop(me.speed, me.to_line, me.comfort_decel_mps2)
        return bool(stops and shown_s >= me.yellow_run_s)
    return False


@in_place(inner=True)
def _stops_at_sign(me: Any, scene: Scene) -> bool:
    if not scene.net.lanes[me.path].must_stop:
        return False
    if me.to_line < STOPPED_M and me.speed < STANDING_MPS and me.stood_at != me.path:
        me.stood_at, me.stopped_s = me.path, scene.now[0].time_s
    rolls = chance(me.key, driving.ROLLS, me.path) < me.stop_roll_probability
    return not rolls and me.stood_at != me.path


@in_place(inner=True)
def obey_junctions(scene: Scene) -> None:
    """Fill in what junctions demand of every driver, after lights, signs and crossings did."""
    n, heads, links = scene.vehicles.size, scene.lane_head, scene.lane_link
    for i in range(n):  # who is on its way over each junction path
        me = scene.vehicles[i]
        if me.path >= 0 and me.to_line < attention_m(me):
            links[i], heads[me.path] = heads[me.path], i
        if me.last_path >= 0 and me.last_path != me.path:
            links[n + i], heads[me.last_path] = heads[me.last_path], n + i
    for i in range(n):
        if scene.vehicles[i].profiled:
            _obey_junction(scene.vehicles[i], scene)
    for i in range(n):
        for path in (scene.vehicles[i].path, scene.vehicles[i].last_path):
            if path >= 0:
                heads[path] = -1


@in_place(inner=True)
def _obey_junction(me: Any, scene: Scene) -> None:
    net, lane, to_line = scene.net, scene.net.lanes[me.lane], me.to_line
    factor = min(me.speed_factor, BEND_FACTOR)
    near = to_line < attention_m(me)
    gap, cap, changes = me.stop_gap, np.inf, True
    if lane.connector:
        cap, changes = factor * lane.limit, False
    elif net.has_paths or me.then >= 0:
        changes = me.s > NO_CHANGE_M[0] and (me.then < 0 or to_line > NO_CHANGE_M[1])
        gets_over = me.target != me.lane and lane.way == lane.way_end
        leads_on = me.path >= 0 or me.then < 0 or gets_over
        if near and not lane.wrong and not leads_on:
            gap, me.held, changes = min(gap, to_line), True, True
    if lane.wrong:
        gap = to_line - LINE_M if near else np.inf
    elif me.path >= 0 and near:
        if not lane.connector:
            bend, braking = factor * net.lanes[me.path].limit, BEND_BRAKING * me.comfort_decel_mps2
            cap = braking_speed(max(to_line, 0.0), bend, braking)
        if me.held or (to_line > -ENTERED_M and _exit_blocked(me, scene)):
            gap = min(gap, to_line)
        if not me.held:
            gap = _conflicts_gap(me, gap, scene)
        if not net.lanes[me.path].must_yield and -ENTERED_M < to_line < gap < np.inf:
            gap = to_line  # a driver with priority does not stop inside
    me.stop_gap, me.speed_cap, me.changes = gap, cap, changes


@in_place(inner=True)
def _exit_blocked(me: Any, scene: Scene) -> bool:
    """Whether a driver would have to stop inside the junction, behind a standing leader."""
    lead = beside(me, me.lane, scene)
    if lead.front < 0 or lead.front_speed > BLOCKED_MPS or lead.front_gap < me.to_line:
        return False
    needed = me.to_line + scene.net.lanes[me.path].length + me.length + me.min_gap_m
    return bool(lead.front_gap < needed)


@in_place(inner=True)
def _rank(me: Any, path: int, entered: bool, scene: Scene) -> int:
    """0 with priority, 1 without, 2 after running a red light."""
    if me.ran_red or (_shows(path, RED, scene) and not entered):
        return 2
    return 1 if scene.net.lanes[path].must_yield else 0


@in_place(inner=True)
def _conflicts_gap(me: Any, gap: float, scene: Scene) -> float:
    """The nearest place at which a driver waits for others, or ``gap`` if that is nearer, m."""
    net, n, to_line, speed = scene.net, scene.vehicles.size, me.to_line, me.speed
    rank = _rank(me, me.path, to_line < -ENTERED_M, scene)
    top = desired_speed(me, net.lanes[me.lane].limit)
    delay = me.startup_delay_s if speed < STANDING_MPS else 0.0
    for c in range(net.lanes[me.path].conflict, net.lanes[me.path].conflict_end):
        conflict = net.conflicts[c]
        entry = scene.lane_head[conflict.other]
        begin, end = to_line + conflict.begin, to_line + conflict.end + me.length
        if entry < 0 or begin <= 0.0 or end < 0.0:
            continue  # nobody comes, or it is in the conflict or past it already
        enter_s = delay + reach_s(speed, begin, me.max_accel_mps2, top)
        leave_s = delay + reach_s(speed, end, me.max_accel_mps2, top)
        while entry >= 0:
            foe, leaving = scene.vehicles[entry % n], entry >= n
            entry = scene.lane_link[entry]
            if foe.row == me.row:
                continue
            if not _must_wait(me, foe, leaving, rank, conflict, enter_s, leave_s, scene):
                continue
            at_line = to_line >= -ENTERED_M and (conflict.begin < AT_LINE_M or rank == 2)
            in_the_way = leaving or foe.to_line + conflict.other_begin <= 0.0
            stop = begin - CONFLICT_MARGIN_M
            if at_line and can_stop(speed, to_line, me.emergency_decel):
                gap = min(gap, to_line)
            elif in_the_way or can_stop(speed, stop, me.emergency_decel):
                gap = min(gap, stop)
    return gap


@in_place(inner=True)
def reach_s(speed: float, distance: float, accel: float, top: float) -> float:
    """Time to cover a distance while speeding up to a top speed, s."""
    if distance <= 0.0:
        return 0.0
    top = max(top, speed, 0.5)
    gaining = (top * top - speed * speed) / (2.0 * accel)
    if distance <= gaining:
        return (-speed + math.sqrt(speed * speed + 2.0 * accel * distance)) / accel
    return (top - speed) / accel + (distance - gaining) / top


@in_place(inner=True)
def _goes_first(
    me: Any, foe: Any, rank: int, foe_rank: int, foe_line: float, conflict: Any
) -> bool:
    """Whether a driver has the right of way: by rule, then by who is in, came first, is nearer."""
    if conflict.yields != 0 and max(rank, foe_rank) < 2:
        return bool(conflict.yields < 0)
    if rank != foe_rank:
        return rank < foe_rank
    entered, foe_entered = me.to_line < -ENTERED_M, foe_line < -ENTERED_M
    if entered != foe_entered:
        return bool(entered)
    both_stood = me.stood_at == me.path and foe.stood_at == conflict.other
    if both_stood and me.stopped_s != foe.stopped_s:
        return bool(me.stopped_s < foe.stopped_s)
    if abs(me.to_line - foe_line) > 0.5:
        return bool(me.to_line < foe_line)
    return bool(me.agent < foe.agent)


@in_place(inner=True)
def _must_wait(
    me: Any, foe: Any, leaving: bool, rank: int, conflict: Any, enter_s: float, leave_s: float,
    scene: Scene,
) -> bool:  # fmt: skip
    """Whether a driver that is in a conflict from ``enter_s`` to ``leave_s`` waits for another one.

    ``rank`` is its own; ``leaving`` says whether the other one is on its way out of the junction.
    """
    overlooks, foe_line, held = me.overlook_probability, foe.to_line, foe.was_held
    if overlooks > 0.0 and chance(me.key, driving.OVERLOOKS, foe.agent) < overlooks:
        return False
    if leaving:
        front = foe.s + foe.length / 2
        foe_line, held = -(scene.net.lanes[conflict.other].length + front), False
    begin, end = foe_line + conflict.other_begin, foe_line + conflict.other_end + foe.length
    speed = max(foe.speed, 0.0)
    if end < 0.0:
        return False
    if begin <= 0.0:  # it is in the conflict
        both_stand = me.stood_s > 2.0 * PATIENCE_S and foe.stood_s > PATIENCE_S
        return bool(not both_stand and enter_s < end / max(speed, 0.5) + CLEARANCE_S)
    if held or (me.stood_s > PATIENCE_S and foe.stood_s > 1.0):
        return False
    entered, foe_entered = me.to_line < -ENTERED_M, foe_line < -ENTERED_M
    foe_rank = _rank(foe, conflict.other, foe_entered, scene)
    goes_first = _goes_first(me, foe, rank, foe_rank, foe_line, conflict)
    if foe.stood_s > WAITING_S:
        after_green = entered and me.lane == me.path and _shows(me.path, RED, scene)
        unruled = conflict.yields == 0 and not scene.net.lanes[conflict.other].must_stop
        lets_go = goes_first or me.stood_s > foe.stood_s or unruled
        if foe_entered or after_green or (foe_rank >= rank and lets_go):
            return False  # it waits itself, for this vehicle or for another
    foe_enters_s = reach_s(speed, begin, FOE_ACCEL_MPS2, max(speed, 8.0))
    foe_leaves_s = end / max(speed, 2.0)
    if goes_first:
        drives_in = foe_entered and speed >= STANDING_MPS
        return bool(drives_in and foe_enters_s < enter_s < foe_leaves_s + CLEARANCE_S)
    if _gap_accepted(
        enter_s, leave_s, foe_enters_s, foe_leaves_s, me.gap_acceptance_s, CLEARANCE_S
    ):
        return False
    insists, braking = me.insistence * INSISTED_BRAKING_MPS2, speed * speed / (2.0 * begin)
    lets_in = insists > 0.0 and braking <= insists and speed > 1.0
    return not (lets_in and leave_s < foe_leaves_s)
