"""Motion: how vehicles and pedestrians move in a step, who touches whom, and who goes.

References:
    Polack et al. (2017), IEEE IV: the kinematic bicycle, as in highway-env.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from sim.compiled import in_place
from sim.highway.decide import act
from sim.highway.driving import STANDING_MPS
from sim.highway.pedestrians import walk
from sim.highway.places import along_lane, leg_at, locate, next_stretch, onward, project, record
from sim.highway.state import WRONG_WAY, Scene

TOP_SPEED_MPS: Final = 40.0
"""Vehicles slow down to this speed (highway-env's MAX_SPEED)."""

CLEAR_AFTER_S, STUCK_S = 8.0, 5.0
"""Crashed vehicles and struck pedestrians stay on the road for this long (traffic behind queues,
and pile-ups clear). A vehicle that stands on the wrong side for this long is taken off the road (it
would stand there for ever)."""

CROSSWISE, FROM_JUNCTION_M = 0.5, 15.0
"""Sine of the angle between two headings above which the ways cross: 30 degrees. Ways that cross
this far from the ends of both do not meet in a junction (more than the longest vehicle)."""

STAYS, ARRIVED, CLEARED, STUCK = range(4)
"""Whether an agent stays, or why it goes."""


@in_place()
def advance(dt: float, waits: bool, scene: Scene) -> bool:
    """Let everybody decide, and move for ``dt`` seconds, as `move` does; returns whether they did.

    Nobody has moved if somebody is astray, or if it ``waits`` for others to decide.
    """
    locate(scene)
    act(scene)
    if waits or scene.now[0].astray > 0:
        return False
    move(dt, scene)
    return True


@in_place()
def move(dt: float, scene: Scene) -> None:
    """Move everybody for ``dt`` seconds; find who touches whom, and who goes."""
    now_s = scene.now[0].time_s + dt
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        if me.profiled:
            _drive(me, dt)
            _update_lane(me, scene)
        lane = scene.net.lanes[me.lane]
        front = along_lane(me, me.lane, scene.net) + me.length / 2
        at_end = me.profiled and not lane.connector and front >= lane.length
        me.arrives = at_end and next_stretch(me, me.lane, scene) < 0
        if abs(me.speed) > STANDING_MPS:
            me.standing_since = np.inf
        elif me.standing_since == np.inf:
            me.standing_since = me.clock if me.profiled else now_s
    walk(dt, scene)
    scene.now[0].time_s = now_s
    _find_touching(scene)
    _leave(scene)


@in_place(inner=True)
def _drive(me: Any, dt: float) -> None:
    """Move one vehicle by the kinematic bicycle."""
    steering, accel, speed = me.steering, me.accel, me.speed
    if me.crashed:
        steering, accel = 0.0, -speed
    if speed > TOP_SPEED_MPS:
        accel = min(accel, TOP_SPEED_MPS - speed)
    slip = math.atan(0.5 * math.tan(steering))
    course = me.heading + slip
    me.x += speed * math.cos(course) * dt
    me.y += speed * math.sin(course) * dt
    me.heading += speed * math.sin(slip) / (me.length / 2) * dt
    me.speed = max(speed + accel * dt, 0.0)
    me.timer += dt
    me.clock += dt
    me.target = me.wanted


@in_place(inner=True)
def _update_lane(me: Any, scene: Scene) -> None:
    """Put a vehicle on the nearer of its lane and its target, or on the next at its lane's end."""
    s, aside, _ = project(me.x, me.y, me.lane, scene.net)
    if me.target != me.lane:
        then_s, then_aside, _ = project(me.x, me.y, me.target, scene.net)
        if abs(then_aside) < abs(aside):
            me.lane, s = me.target, then_s
    then = onward(me, me.lane, scene) if s > scene.net.lanes[me.lane].length else -1
    if then >= 0:
        me.lane = me.target = me.wanted = then
        me.leg = max(me.leg, leg_at(me, then, me.leg + 1, scene))


@in_place(inner=True)
def _leave(scene: Scene) -> None:
    """Note why each one goes, if it does, and who has come onto the wrong side."""
    now = scene.now[0]
    now.leaving = 0
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        me.leaves = STAYS
        if not me.profiled:
            continue
        wrong = scene.net.lanes[me.lane].wrong
        if wrong and not me.wrong_way:
            record(WRONG_WAY, me.agent, scene)
        me.wrong_way = wrong
        if wrong and me.standing_since < np.inf and me.clock - me.standing_since > STUCK_S:
            me.leaves = STUCK
        elif now.time_s - me.crashed_at > CLEAR_AFTER_S:
            me.leaves = CLEARED
        elif me.arrives:
            me.leaves = ARRIVED
        now.leaving += me.leaves != STAYS
    for w in range(scene.walkers.size):
        person = scene.walkers[w]
        person.leaves = STAYS
        if now.time_s - person.crashed_at > CLEAR_AFTER_S:
            person.leaves = CLEARED
        elif person.s >= scene.footways.ways[person.way].length - 1e-6:
            person.leaves = ARRIVED
        now.leaving += person.leaves != STAYS


@in_place(inner=True)
def _one(i: int, scene: Scene) -> tuple[float, float, float, float, float]:
    """Place, heading, length and width of a vehicle, or of a pedestrian counted after them."""
    n = scene.vehicles.size
    if i < n:
        me = scene.vehicles[i]
        return me.x, me.y, me.heading, me.length, me.width
    person = scene.walkers[i - n]
    return person.x, person.y, person.heading, person.length, person.width


@in_place(inner=True)
def _find_touching(scene: Scene) -> None:
    """List every two vehicles, and every vehicle and pedestrian, whose outlines overlap.

    Those that arrive in this step are gone from the road's end before they reach anybody there.
    """
    by_x, n, now, widest = scene.by_x, scene.vehicles.size, scene.now[0], 0.0
    for k in range(by_x.size):
        i, at = by_x[k], k
        x, _, _, length, width = _one(i, scene)
        widest = max(widest, length + width)  # no less than its diagonal
        while at > 0 and _one(by_x[at - 1], scene)[0] > x:
            by_x[at] = by_x[at - 1]
            at -= 1
        by_x[at] = i
    now.pairs = 0
    for k in range(by_x.size):
        x = _one(by_x[k], scene)[0]
        for m in range(k + 1, by_x.size):
            if _one(by_x[m], scene)[0] - x > widest:
                break
            i, j = min(by_x[k], by_x[m]), max(by_x[k], by_x[m])
            if i >= n or scene.vehicles[i].arrives or (j < n and scene.vehicles[j].arrives):
                continue
            touch = _overlap(i, j, scene) and _on_one_level(i, j, scene)
            if touch and now.pairs < scene.pairs.size:
                scene.pairs[now.pairs].one, scene.pairs[now.pairs].other = i, j
                now.pairs += 1


@in_place(inner=True)
def _overlap(i: int, j: int, scene: Scene) -> bool:
    """Whether the outlines of two overlap: no axis of either rectangle separates them."""
    ax, ay, a_heading, a_length, a_width = _one(i, scene)
    bx, by, b_heading, b_length, b_width = _one(j, scene)
    dx, dy = ax - bx, ay - by
    reach = (math.sqrt(a_length**2 + a_width**2) + math.sqrt(b_length**2 + b_width**2)) / 2
    if not dx * dx + dy * dy <= reach * reach:
        return False
    a_cos, a_sin = math.cos(a_heading), math.sin(a_heading)
    b_cos, b_sin = math.cos(b_heading), math.sin(b_heading)
    for x, y in ((a_cos, a_sin), (-a_sin, a_cos), (b_cos, b_sin), (-b_sin, b_cos)):
        half = abs(a_cos * x + a_sin * y) * a_length + abs(-a_sin * x + a_cos * y) * a_width
        half += abs(b_cos * x + b_sin * y) * b_length + abs(-b_sin * x + b_cos * y) * b_width
        if abs(dx * x + dy * y) >= half / 2:
            return False
    return True


@in_place(inner=True)
def _on_one_level(i: int, j: int, scene: Scene) -> bool:
    """Whether no one of two who overlap passes over the other on a bridge.

    Roads have no heights; but lanes meet at junctions only, so where two of them cross far from
    the ends of both, one lies above the other.
    """
    lanes, vehicles = scene.net.lanes, scene.vehicles
    if j >= vehicles.size or lanes[vehicles[i].lane].stretch == lanes[vehicles[j].lane].stretch:
        return True
    if abs(math.sin(vehicles[i].heading - vehicles[j].heading)) < CROSSWISE:
        return True
    for k in (i, j):
        lane, s = lanes[vehicles[k].lane], along_lane(vehicles[k], vehicles[k].lane, scene.net)
        if lane.connector or min(s, lane.length - s) < FROM_JUNCTION_M:
            return True
    return False
