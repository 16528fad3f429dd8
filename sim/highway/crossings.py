"""Pedestrian crossings: drivers that let pedestrians cross, and pedestrians that wait or walk.

At a signal pedestrians wait for green. At a zebra they step out when every vehicle that comes near
is far enough away, stands, or is going to let them cross. On the way they stop before a lane on
which a vehicle comes that does not. Whether a driver yields is drawn once per encounter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim.compiled import in_place
from sim.frames import Signal
from sim.highway.driving import OVERLOOKS, YIELDS, attention_m, can_stop, chance
from sim.highway.junctions import ENTERED_M
from sim.highway.state import Scene
from sim.highway.walkers import SETBACK_M

GREEN, OFF = Signal.GREEN.code, Signal.OFF.code

KERB_SOON_S, KERB_M = 4.0, 0.4
"""Drivers that demand at least this gap see that a pedestrian this near the kerb wants to cross, s.
Pedestrians decide this near the kerb whether to step out, m (half a stride)."""

STALLED_S, STOOD_S = 4.0, 0.8
"""A pedestrian who has stood this long on the crossing, out of a vehicle's way, waits for the
vehicles, s (else each would wait for the other in a full junction). Pedestrians assume that a
vehicle that has stood this long before a crossing waits, s."""

DANGER_S, SPARE_S = 1.0, 0.7
"""All drivers brake for a pedestrian who steps onto their lane within this time, s. Pedestrians
want this time to spare before a vehicle comes, s."""

STRIP_M, WALKED_M = 0.1, 1.1
"""The strip of a lane that vehicles and pedestrians keep clear of each other ends this far inside
the lane's edges, m: a pedestrian can stand between two lanes. Pedestrians walk this far to either
side of a crossing's middle line, m (`walkers.OFFSET_M`, half a pedestrian and a little)."""


@in_place(inner=True)
def note_walkers(scene: Scene) -> None:
    """List the pedestrians on each crossing and those who reach its kerb soon."""
    scene.spot_head[:] = -1
    scene.crossing_head[:] = -1
    for w in range(scene.walkers.size):
        person = scene.walkers[w]
        at = _crossover(w, scene)
        if at < 0 or person.crashed:
            continue
        way = scene.footways.crossovers[at]
        beyond = person.s - way.begin_s
        if beyond > 0.0 or -beyond <= KERB_SOON_S * person.free_speed:
            head = scene.crossing_head
            person.link, head[way.crossing] = head[way.crossing], w


@in_place(inner=True)
def _crossover(w: int, scene: Scene) -> int:
    """The crossing of its way that a pedestrian is on or comes to next; -1 for none."""
    way, crossed = scene.footways.ways[scene.walkers[w].way], scene.walkers[w].crossed
    at = way.crossover + crossed
    return int(at) if at < way.crossover_end else -1


@in_place(inner=True)
def _along(u: float, at: int, scene: Scene) -> float:
    """How far from its beginning a place is that is given along a crossing's line, m."""
    way = scene.footways.crossovers[at]
    u = u + SETBACK_M
    return float(u if way.forward else (way.end_s - way.begin_s) - u)


@in_place(inner=True)
def obey_crossings(scene: Scene) -> None:
    """Note who stops before which crossing and who comes to it."""
    scene.now[0].arrivals = 0
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        first = scene.now[0].arrivals
        _look_at_strips(i, me.lane, -(me.s + me.length / 2), scene)
        if me.path >= 0 and me.path != me.lane:
            _look_at_strips(i, me.path, me.to_line, scene)
        for a in range(first, scene.now[0].arrivals):
            for b in range(first, scene.now[0].arrivals):
                one, other = scene.arrivals[a], scene.arrivals[b]
                if other.yields and other.crossing == one.crossing:
                    one.yields = True


@in_place(inner=True)
def _look_at_strips(i: int, lane: int, begin: float, scene: Scene) -> None:
    """Look at the crossings of a lane that begins so far ahead of a vehicle's front bumper."""
    net, me = scene.net, scene.vehicles[i]
    obeys = me.profiled and not net.lanes[me.lane].wrong
    for z in range(net.lanes[lane].strip, net.lanes[lane].strip_end):
        strip = net.strips[z]
        near, far, crossing = strip.near + begin, strip.far + begin, strip.crossing
        w = scene.crossing_head[crossing]
        if w < 0 or far + me.length < 0.0 or near > attention_m(me):
            continue
        if scene.now[0].arrivals >= scene.arrivals.size:
            continue
        arrival = scene.arrivals[scene.now[0].arrivals]
        arrival.vehicle, arrival.crossing, arrival.near, arrival.far = i, crossing, near, far
        arrival.yields, arrival.stood_s = False, me.stood_s
        arrival.link, scene.spot_head[strip.spot] = (
            scene.spot_head[strip.spot], scene.now[0].arrivals
        )  # fmt: skip
        scene.now[0].arrivals += 1
        while w >= 0 and obeys and near >= -ENTERED_M:
            if _yields_to(i, w, strip, near, far, scene):
                me.stop_gap = min(me.stop_gap, near)
                arrival.yields = True
            w = scene.walkers[w].link


@in_place(inner=True)
def _yields_to(i: int, w: int, strip: Any, near: float, far: float, scene: Scene) -> bool:
    """Whether a driver stops for a pedestrian at a crossing that is ``near`` to ``far`` m ahead."""
    me, person, crossing = scene.vehicles[i], scene.walkers[w], scene.net.crossings[strip.crossing]
    overlooks = me.overlook_probability
    sees = overlooks <= 0.0 or chance(me.key, OVERLOOKS, person.agent) >= overlooks
    at = _crossover(w, scene)
    half = scene.net.lanes[me.lane].width / 2 - STRIP_M
    beyond = person.s - scene.footways.crossovers[at].begin_s
    pace, speed = person.free_speed, me.speed
    on = beyond > 0.0
    lit = crossing.signal >= 0 and scene.signals[crossing.signal] != OFF
    walk = not lit or scene.signals[crossing.signal] == GREEN
    comes_s, clears_s = near / max(speed, 2.0), (far + me.length) / max(speed, 2.0)
    along = _along(strip.u, at, scene)
    enters_s, leaves_s = (along - half - beyond) / pace, (along + half - beyond) / pace
    if leaves_s < 0.0:
        return False
    if on and (enters_s <= 0.0 or (person.speed > 0.0 and enters_s < DANGER_S)):
        hard = me.emergency_decel
        return sees and can_stop(speed, near, hard) and leaves_s > comes_s - DANGER_S
    if on and person.stood_s > STALLED_S:
        return False
    if not ((crossing.priority or lit) and (on or walk)):
        return False
    gentle = max(1.2 * me.comfort_decel_mps2, 3.0)
    if leaves_s < comes_s - DANGER_S or not can_stop(speed, near, gentle):
        return False
    gap_s = me.crossing_gap_s
    heeds = -beyond <= gap_s * pace and enters_s < clears_s + gap_s
    return bool(sees and heeds and chance(me.key, YIELDS, strip.crossing) < me.yield_probability)


@in_place(inner=True)
def walk(dt: float, scene: Scene) -> None:
    """Let every pedestrian walk on or wait for ``dt`` seconds, as `_may_walk` says."""
    for w in range(scene.walkers.size):
        person = scene.walkers[w]
        at = _crossover(w, scene)
        person.speed = person.free_speed if _may_walk(w, at, dt, scene) else 0.0
        person.stood_s = 0.0 if person.speed > 0.0 else person.stood_s + dt
        way = scene.footways.ways[person.way]
        person.s = min(person.s + person.speed * dt, way.length)
        if at >= 0 and person.s >= scene.footways.crossovers[at].end_s:
            person.crossed += 1
        g = way.step
        while g + 1 < way.step_end and scene.footways.steps[g + 1].begin <= person.s:
            g += 1
        step = scene.footways.steps[g]
        along = person.s - step.begin
        person.x = step.x + step.dx * along + person.aside * -step.dy
        person.y = step.y + step.dy * along + person.aside * step.dx
        person.heading = step.heading


@in_place(inner=True)
def _may_walk(w: int, at: int, dt: float, scene: Scene) -> bool:
    """Whether a pedestrian walks on in a step of ``dt`` s, or waits."""
    person = scene.walkers[w]
    if person.crashed:
        return False
    if at < 0:
        return True
    way, stride = scene.footways.crossovers[at], person.free_speed * dt
    crossing = scene.net.crossings[way.crossing]
    begins = person.s < way.begin_s
    if begins and way.begin_s - person.s > max(KERB_M, stride):
        return True
    lit = crossing.signal >= 0 and scene.signals[crossing.signal] != OFF
    if begins and lit and scene.signals[crossing.signal] != GREEN:
        return False
    nearest = np.inf
    if begins and lit:  # the first lane only
        for spot in range(crossing.spot, crossing.spot_end):
            nearest = min(nearest, _strip_of(spot, at, scene)[0])
    for spot in range(crossing.spot, crossing.spot_end):
        begin, end = _strip_of(spot, at, scene)
        if not begins and not person.s <= begin < person.s + stride:
            continue
        if begin <= nearest and not _is_safe(w, spot, begin, end, scene):
            return False
    return True


@in_place(inner=True)
def _strip_of(spot: int, at: int, scene: Scene) -> tuple[float, float]:
    """Where a lane's strip of a crossing begins and ends along a way over it, m."""
    middle = scene.footways.crossovers[at].begin_s + _along(scene.net.spots[spot].u, at, scene)
    half = scene.net.spots[spot].half - STRIP_M
    return middle - half, middle + half


@in_place(inner=True)
def _is_safe(w: int, spot: int, begin: float, end: float, scene: Scene) -> bool:
    """Whether a pedestrian can cross a lane's strip before any vehicle reaches it.

    A vehicle that waits before the crossing holds those behind it back.
    """
    person = scene.walkers[w]
    enter_s = max(begin - person.s, 0.0) / person.free_speed
    leave_s = (end - person.s) / person.free_speed
    safe, nearest, a = True, np.inf, scene.spot_head[spot]
    while a >= 0:
        arrival = scene.arrivals[a]
        a = arrival.link
        vehicle = scene.vehicles[arrival.vehicle]
        speed, middle_m = vehicle.speed, (arrival.far - arrival.near) / 2
        near, far = arrival.near + middle_m - WALKED_M, arrival.far - middle_m + WALKED_M
        clear_s = (far + vehicle.length) / max(speed, 0.5)
        if arrival.near > nearest or clear_s < 0.0 or (speed > 0.5 and clear_s < enter_s - 0.2):
            continue  # behind another one, or past it before the pedestrian comes
        yields = arrival.yields or vehicle.held
        waits = (yields and speed * speed <= 2.0 * 5.0 * near) or arrival.stood_s > STOOD_S
        comes_s = near / speed if speed >= 2.0 else -speed + math.sqrt(speed * speed + 2.0 * near)
        if near <= 0.1 or waits or comes_s <= leave_s + SPARE_S:
            nearest, safe = arrival.near, near > 0.1 and waits
    return safe
