"""Motion: how vehicles and pedestrians move in a step, who touches whom, and who goes.

References:
    Polack et al. (2017), IEEE IV: the kinematic bicycle, as in highway-env.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from sim.compiled import in_place
from sim.frames import EventKind
from sim.highway.decide import act
from sim.highway.driving import STANDING_MPS
from sim.highway.pedestrians import walk
from sim.highway.places import along_lane, leg_at, locate, next_stretch, onward, project, record
from sim.highway.state import EVENT_KINDS, Scene

WRONG_WAY = EVENT_KINDS.index(EventKind.WRONG_WAY)

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

DONE, SOMEBODY_GOES, NO_ROOM, ASTRAY, DECIDED = range(5)
"""How a step ends; see `advance`."""


@in_place()
def advance(dt: float, waits: bool, scene: Scene) -> int:
    """Let everybody decide, and move for ``dt`` seconds; returns the code of `move`.

    Nobody has moved if there is `NO_ROOM` for all entries of ``on``, if somebody is `ASTRAY`, or at
    `DECIDED`, if it ``waits`` for others to decide.
    """
    if not locate(scene):
        return NO_ROOM
    if act(scene) > 0:
        return ASTRAY
    return DECIDED if waits else move(dt, scene)


@in_place()
def move(dt: float, scene: Scene) -> int:
    """Move everybody for ``dt`` seconds; returns `DONE`, or `SOMEBODY_GOES`, as ``leaves`` says."""
    now_s = scene.now[0].time_s + dt
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        if me.profiled:
            _drive(me, dt)
            _update_lane(i, scene)
        lane = scene.net.lanes[me.lane]
        front = project(me.x, me.y, me.lane, scene.net)[0] + me.length / 2
        at_end = me.profiled and not lane.connector and front >= lane.length
        me.arrives = at_end and next_stretch(i, me.lane, scene) < 0
        if abs(me.speed) > STANDING_MPS:
            me.standing_since = np.inf
        elif me.standing_since == np.inf:
            me.standing_since = me.clock if me.profiled else now_s
    walk(dt, scene)
    scene.now[0].time_s = now_s
    _find_touching(scene)
    return SOMEBODY_GOES if _leave(scene) else DONE


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
def _update_lane(i: int, scene: Scene) -> None:
    """Put a vehicle on the nearer of its lane and its target, or on the next at its lane's end."""
    net, me = scene.net, scene.vehicles[i]
    s, aside, _ = project(me.x, me.y, me.lane, net)
    if me.target != me.lane:
        then_s, then_aside, _ = project(me.x, me.y, me.target, net)
        if abs(then_aside) < abs(aside):
            me.lane, s = me.target, then_s
    if s > net.lanes[me.lane].length:
        then = onward(i, me.lane, scene)
        if then >= 0:
            me.lane = me.target = me.wanted = then
            me.leg = max(me.leg, leg_at(i, then, me.leg + 1, scene))


@in_place(inner=True)
def _leave(scene: Scene) -> bool:
    """Note why each one goes, if it does, and who has come onto the wrong side."""
    somebody, now_s = False, scene.now[0].time_s
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
        elif now_s - me.crashed_at > CLEAR_AFTER_S:
            me.leaves = CLEARED
        elif me.arrives:
            me.leaves = ARRIVED
        somebody = somebody or me.leaves != STAYS
    for w in range(scene.walkers.size):
        person = scene.walkers[w]
        person.leaves = STAYS
        if now_s - person.crashed_at > CLEAR_AFTER_S:
            person.leaves = CLEARED
        elif person.s >= scene.footways.ways[person.way].length - 1e-6:
            person.leaves = ARRIVED
        somebody = somebody or person.leaves != STAYS
    return bool(somebody)


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
def _cell(x: float, y: float, scene: Scene) -> tuple[int, int]:
    """Column and row of the cell of a place; places outside belong to the nearest cell."""
    cells = scene.net.cells
    column = min(max((x - cells.x0) / cells.size, 0.0), cells.columns - 1.0)
    row = min(max((y - cells.y0) / cells.size, 0.0), cells.rows - 1.0)
    return int(column), int(row)


@in_place(inner=True)
def _find_touching(scene: Scene) -> None:
    """List every two vehicles, and every vehicle and pedestrian, whose outlines overlap.

    Those that arrive in this step are gone from the road's end before they reach anybody there.
    """
    cells, n = scene.net.cells, scene.vehicles.size
    many = n + scene.walkers.size
    scene.now[0].pairs = 0
    for i in range(many):
        x, y, _, _, _ = _one(i, scene)
        column, row = _cell(x, y, scene)
        cell = row * cells.columns + column
        scene.cell_link[i], scene.cell_head[cell] = scene.cell_head[cell], i
    for i in range(n):
        if scene.vehicles[i].arrives:
            continue
        column, row = _cell(scene.vehicles[i].x, scene.vehicles[i].y, scene)
        for r in range(max(row - 1, 0), min(row + 2, cells.rows)):
            for c in range(max(column - 1, 0), min(column + 2, cells.columns)):
                j = scene.cell_head[r * cells.columns + c]
                while j >= 0:
                    stays = j >= n or not scene.vehicles[j].arrives
                    touch = j > i and stays and _overlap(i, j, scene) and _on_one_level(i, j, scene)
                    if touch and scene.now[0].pairs < scene.pairs.size:
                        pair = scene.pairs[scene.now[0].pairs]
                        pair.one, pair.other = i, j
                        scene.now[0].pairs += 1
                    j = scene.cell_link[j]
    for i in range(many):
        x, y, _, _, _ = _one(i, scene)
        column, row = _cell(x, y, scene)
        scene.cell_head[row * cells.columns + column] = -1


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
        lane, s = lanes[vehicles[k].lane], along_lane(k, vehicles[k].lane, scene)
        if lane.connector or min(s, lane.length - s) < FROM_JUNCTION_M:
            return True
    return False
