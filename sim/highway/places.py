"""Places along lanes; who is on which lane, and who is ahead and behind on it."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from sim.compiled import in_place
from sim.frames import FloatArray, IntArray
from sim.highway.driving import Beside
from sim.highway.state import LONGEST_M, Net, Records, Scene

BLEND_M: Final = 2.0
"""The heading turns from one piece's to the next's within this distance of the corner (half a
wheelbase)."""

ALIGNED, JOINED_M = 0.5, 2.0
"""A vehicle that faces a lane's direction less than this (by the cosine) crosses it and is not on
it; on stretches, unlike on junction paths, one that faces the other way is. A vehicle this far
before the beginning of the next lane, and in line with it, leads onto it, whichever way it comes
(half a car)."""

LEADER_RANGE_M, MOST_LANES = 200.0, 4
"""Leaders farther ahead are not looked for, nor those on later lanes than so many after the
present one."""


@in_place(inner=True)
def project(x: float, y: float, k: int, net: Net) -> tuple[float, float, int]:
    """Distance along a lane of a point, how far to the right it is, m, and the piece there."""
    return project_on(x, y, net.lanes[k].piece, net.lanes[k].piece_end, net.pieces)


@in_place()
def project_on(
    x: float, y: float, first: int, end: int, pieces: Records
) -> tuple[float, float, int]:
    """The same on the line of the pieces from ``first`` to before ``end``."""
    best, s, lateral, found = np.inf, 0.0, 0.0, first
    for g in range(first, end):
        piece = pieces[g]
        dx, dy = x - piece.x, y - piece.y
        along, across = dx * piece.dx + dy * piece.dy, dy * piece.dx - dx * piece.dy
        clipped, side = along, across
        if along < 0.0 and g > first:
            clipped = 0.0
            side = piece.outside if piece.outside != 0.0 else across
        elif along > piece.size and g + 1 < end:
            clipped = piece.size
            side = piece.outside_end if piece.outside_end != 0.0 else across
        beyond = along - clipped
        if max(abs(across), abs(beyond)) >= best:
            continue  # the distance is no less than either
        distance = math.hypot(across, beyond) if beyond != 0.0 else abs(across)
        if distance < best:
            best, s, lateral, found = distance, piece.begin + clipped, side, g
    return s, math.copysign(best, lateral), found


@in_place(inner=True)
def last_begun(s: float, first: int, end: int, rows: Records) -> int:
    """The last of the rows from ``first`` to before ``end`` whose ``begin`` is not after ``s``."""
    at = first
    while at + 1 < end and rows[at + 1].begin <= s:
        at += 1
    return at


@in_place(inner=True)
def heading_at(s: float, k: int, net: Net) -> float:
    """A lane's heading at a distance along it, rad."""
    end = net.lanes[k].turn_end
    at = last_begun(s, net.lanes[k].turn, end, net.turns)
    one = net.turns[at]
    if at + 1 == end or s <= one.begin:
        return float(one.heading)
    then = net.turns[at + 1]
    slope = (then.heading - one.heading) / (then.begin - one.begin)
    return float(slope * (s - one.begin) + one.heading)


@in_place()
def closest_lane(x: float, y: float, heading: float, net: Net) -> int:
    """The lane closest to a place by highway-env's measure; ``heading`` is NaN if it is unknown."""
    best, found = np.inf, 0
    for k in range(net.lanes.size):
        s, lateral, _ = project(x, y, k, net)
        away = abs(lateral) + max(s - net.lanes[k].length, 0.0) + max(-s, 0.0)
        if not math.isnan(heading):
            off = heading - heading_at(s, k, net)
            away += abs((off + math.pi) % (2.0 * math.pi) - math.pi)
        if away < best:
            best, found = away, k
    return found


@in_place(inner=True)
def record(kind: int, agent: int, scene: Scene) -> None:
    """Record an event."""
    now = scene.now[0]
    if now.events < scene.events.size:
        event = scene.events[now.events]
        event.kind, event.agent, event.time_s = kind, agent, now.time_s
        now.events += 1


@in_place(inner=True)
def along_lane(me: Any, lane: int, net: Net) -> float:
    """Distance of a vehicle along a lane, m."""
    return project(me.x, me.y, lane, net)[0]


@in_place(inner=True)
def next_stretch(me: Any, lane: int, scene: Scene) -> int:
    """The stretch that a vehicle wants to reach after a lane's; -1 at the end of its way."""
    at = leg_at(me, lane, me.leg, scene)
    return int(scene.routes[me.route, at + 1]) if at >= 0 else -1


@in_place(inner=True)
def leg_at(me: Any, lane: int, first: int, scene: Scene) -> int:
    """Which stretch of a vehicle's route a lane belongs to, counted from ``first`` on; or -1."""
    for at in range(first, scene.routes.shape[1] - 1):
        if scene.routes[me.route, at] == scene.net.lanes[lane].stretch:
            return at
    return -1


@in_place(inner=True)
def path_to(lane: int, then: int, net: Net) -> int:
    """The junction path from a lane to a stretch; -1 if there is none."""
    for at in range(net.lanes[lane].way, net.lanes[lane].way_end):
        if net.ways[at].stretch == then:
            return int(net.ways[at].path)
    return -1


@in_place(inner=True)
def onward(me: Any, lane: int, scene: Scene) -> int:
    """The lane that follows on a vehicle's way; -1 at its end or on a wrong lane."""
    after = scene.net.lanes[lane].exit
    if after >= 0:
        return int(after)
    then = next_stretch(me, lane, scene)
    return path_to(lane, then, scene.net) if then >= 0 else -1


@in_place()
def locate(scene: Scene) -> None:
    """Find who is on which lane; those at the same place are in the order of rows."""
    net, cells, on, found = scene.net, scene.net.cells, scene.on, 0
    scene.on_head[:] = -1
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        column, line = (me.x - cells.x0) / cells.size, (me.y - cells.y0) / cells.size
        if not (0.0 <= column < cells.columns and 0.0 <= line < cells.rows):
            continue
        cell = int(line) * cells.columns + int(column)
        cos, sin = math.cos(me.heading), math.sin(me.heading)
        for at in range(cells.first[cell], cells.first[cell + 1]):
            k = cells.items[at]
            lane = net.lanes[k]
            s, lateral, piece = project(me.x, me.y, k, net)
            facing = cos * net.pieces[piece].dx + sin * net.pieces[piece].dy
            half = min(me.length, LONGEST_M) / 2
            if (
                abs(lateral) > lane.margin
                or (facing if lane.connector else abs(facing)) <= ALIGNED
                or s < -lane.behind
                or s > lane.length + half
            ):
                if not lane.connector or lane.entry != net.lanes[me.lane].entry:
                    continue
                rear, lateral, _ = project(me.x - half * cos, me.y - half * sin, k, net)
                if abs(lateral) > lane.margin or not 0.0 <= rear <= lane.length:
                    continue
                s = rear + half  # it turns off, with its rear still in the way
            before, then = -1, scene.on_head[k]
            while then >= 0 and on[then].s <= s:
                before, then = then, on[then].then
            one = on[found]
            one.row, one.then, one.s, one.along = i, then, s, me.speed * facing
            if before < 0:
                scene.on_head[k] = found
            else:
                on[before].then = found
            found += 1


@in_place()
def beside(me: Any, lane: int, scene: Scene) -> Beside:
    """The vehicles ahead of and behind a vehicle on a lane, ahead also along its way."""
    on, vehicles = scene.on, scene.vehicles
    here, rear, rear_gap, rear_speed = along_lane(me, lane, scene.net), -1, np.inf, 0.0
    at, behind = scene.on_head[lane], -1
    while at >= 0 and on[at].s < here:
        if on[at].row != me.row:
            behind = at
        at = on[at].then
    if behind >= 0:
        rear, rear_speed = on[behind].row, on[behind].along
        rear_gap = here - on[behind].s - (me.length + vehicles[rear].length) / 2
    offset, now, visited = -here, lane, 0
    while True:
        while at >= 0 and on[at].row == me.row:
            at = on[at].then
        if at >= 0:
            front = on[at].row
            gap = offset + on[at].s - (me.length + vehicles[front].length) / 2
            if gap < LEADER_RANGE_M:
                return Beside(front, gap, on[at].along, rear, rear_gap, rear_speed)
            break
        offset += scene.net.lanes[now].length
        visited += 1
        now = onward(me, now, scene)
        if now < 0 or offset > LEADER_RANGE_M or visited > MOST_LANES:
            break
        at = scene.on_head[now]
        while at >= 0 and on[at].s <= max(-offset, -JOINED_M):
            at = on[at].then
    return Beside(-1, np.inf, 0.0, rear, rear_gap, rear_speed)


@in_place()
def read_motion(order: IntArray, scene: Scene, motion: FloatArray) -> None:
    """Read how everybody moves, in the axes of a `Frame`, in the order of (n,) rows.

    ``motion``, (4 n,), receives all places, x and y, then headings, then speeds.
    """
    n = order.size
    for k in range(n):
        i = order[k] - scene.vehicles.size
        if i < 0:
            me = scene.vehicles[order[k]]
            x, y, turned, speed = me.x, me.y, me.heading, me.speed
        else:
            person = scene.walkers[i]
            x, y, turned, speed = person.x, person.y, person.heading, person.speed
        motion[2 * k], motion[2 * k + 1] = x, -y
        motion[2 * n + k] = math.pi - (math.pi + turned) % (2.0 * math.pi)
        motion[3 * n + k] = speed
