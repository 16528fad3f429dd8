"""What kernels read and write: a road's arrays and everybody on it, and who is on which lane."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.highway.tables import LONGEST_M, Net, Records, heading_at, project, record_type
from sim.highway.walkers import Footways

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ALIGNED: Final = 0.5
"""A vehicle turned by more than 60 degrees from a lane crosses it and is not on it. On stretches,
unlike on junction paths, one that faces the other way is."""

JOINED_M: Final = 2.0
"""A vehicle this far before the beginning of the next lane, and in line with it, leads onto it,
whichever way it comes (half a car)."""

LEADER_RANGE_M: Final = 200.0
"""Leaders farther ahead are not looked for."""

MOST_LANES: Final = 4
"""A leader is looked for on the present lane and on this many after it."""

NOW: Final = record_type(
    time_s="f8", events="i8", arrivals="i8", pairs="i8", astray="i8", entries="i8"
)
"""The time, and how many rows of each list are in use; ``astray``: how many drivers need another
route; ``entries``: vehicles on lanes."""

EVENT: Final = record_type(kind="i8", agent="i8")
"""Something that a rule recorded, by the code of its `EventKind`."""

ON: Final = record_type(row="i8", s="f8", along="f8")
"""A vehicle on a lane: its distance along it, m, and its speed along it, m/s."""

ARRIVAL: Final = record_type(
    vehicle="i8", crossing="i8", near="f8", far="f8", yields="?", stood_s="f8", link="i8"
)
"""A vehicle that comes to a spot of a crossing: front bumper to its near and far edge, m; whether
it lets the pedestrians go first; for how long it has stood, s; the next arrival at that spot."""

PAIR: Final = record_type(one="i8", other="i8")
"""Two who touch; pedestrians are counted after the vehicles."""


class Scene(NamedTuple):
    """A road at one time.

    Lists without a maximum length are linked: a ``head`` has the first row of each, or -1, and the
    rows have the next. Heads are -1 between two kernels.

    Attributes:
        net: the road.
        routes: (r, m) numbers of the stretches on each route, -1 after the last.
        footways: ways on foot.
        signals: (g,) what each signal group shows.
        signal_since: (g,) since when, s.
        vehicles: (n,) rows of `sim.highway.vehicle.VEHICLE`.
        walkers: (m,) rows of `sim.highway.walkers.WALKER`.
        now: (1,) of `NOW`.
        on_first: (K + 1,) where each lane's entries of ``on`` begin.
        on: of `ON`, by lane, then by distance along it.
        unsorted: as ``on``, in the order in which they are found.
        unsorted_lane: the lane of each.
        lane_head: (K,) first vehicle on its way over each junction path, or changing to a lane.
        lane_link: (2n,) the next; those who have not quite left a path are counted from n.
        spot_head: first arrival at each spot of a crossing.
        crossing_head: first pedestrian on or near each crossing.
        cell_head: first of everybody in each cell.
        cell_link: (n + m,) the next one.
        arrivals: of `ARRIVAL`.
        pairs: of `PAIR`.
        events: of `EVENT`.
    """

    net: Net
    routes: IntArray
    footways: Footways
    signals: NDArray[np.int8]
    signal_since: FloatArray
    vehicles: Records
    walkers: Records
    now: Records
    on_first: IntArray
    on: Records
    unsorted: Records
    unsorted_lane: IntArray
    lane_head: IntArray
    lane_link: IntArray
    spot_head: IntArray
    crossing_head: IntArray
    cell_head: IntArray
    cell_link: IntArray
    arrivals: Records
    pairs: Records
    events: Records


class Beside(NamedTuple):
    """The vehicles ahead and behind: row (-1 for none), bumper gap, m, and speed, m/s, of each."""

    front: int
    front_gap: float
    front_speed: float
    rear: int
    rear_gap: float
    rear_speed: float


@in_place(inner=True)
def record(kind: int, agent: int, scene: Scene) -> None:
    """Record an event."""
    now = scene.now[0]
    if now.events < scene.events.size:
        scene.events[now.events].kind = kind
        scene.events[now.events].agent = agent
        now.events += 1


@in_place(inner=True)
def along_lane(i: int, lane: int, scene: Scene) -> float:
    """Distance of a vehicle along a lane, m."""
    me = scene.vehicles[i]
    return project(me.x, me.y, lane, scene.net)[0]


@in_place()
def distance_on(i: int, lane: int, scene: Scene) -> float:
    """The same, for Python."""
    return along_lane(i, lane, scene)


@in_place(inner=True)
def next_stretch(i: int, lane: int, scene: Scene) -> int:
    """The stretch that a vehicle wants to reach after a lane's; -1 at the end of its way."""
    at = leg_at(i, lane, scene.vehicles[i].leg, scene)
    return int(scene.routes[scene.vehicles[i].route, at + 1]) if at >= 0 else -1


@in_place(inner=True)
def leg_at(i: int, lane: int, first: int, scene: Scene) -> int:
    """Which stretch of a vehicle's route a lane belongs to, counted from ``first`` on; or -1."""
    routes, route, stretch = scene.routes, scene.vehicles[i].route, scene.net.lanes[lane].stretch
    for at in range(first, routes.shape[1] - 1):
        if routes[route, at] == stretch:
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
def onward(i: int, lane: int, scene: Scene) -> int:
    """The lane that follows on a vehicle's way; -1 at its end or on a wrong lane."""
    after = scene.net.lanes[lane].exit
    if after >= 0:
        return int(after)
    then = next_stretch(i, lane, scene)
    return path_to(lane, then, scene.net) if then >= 0 else -1


@in_place()
def path_of(i: int, scene: Scene) -> int:
    """The junction path that a vehicle is on, has not left, or comes to next; or -1."""
    me = scene.vehicles[i]
    return int(me.last_path if me.last_path >= 0 else onward(i, me.lane, scene))


@in_place()
def locate(scene: Scene) -> bool:
    """Find who is on which lane; those at the same place are in the order of rows.

    Returns:
        Whether there was room for all entries; ``now.entries`` says how many there are.
    """
    net, cells, found = scene.net, scene.net.cells, 0
    vehicles, first, room = scene.vehicles, scene.on_first, scene.unsorted_lane.size
    first[:] = 0
    for i in range(vehicles.size):
        me = vehicles[i]
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
            if found < room:
                one = scene.unsorted[found]
                one.row, one.s, one.along = i, s, me.speed * facing
                scene.unsorted_lane[found] = k
                first[k + 1] += 1
            found += 1
    scene.now[0].entries = found
    if found > room:
        return False
    for k in range(first.size - 1):
        first[k + 1] += first[k]
    for e in range(found):  # `lane_head` counts how many are in place already
        k, one = scene.unsorted_lane[e], scene.unsorted[e]
        scene.lane_head[k] += 1
        at = first[k] + scene.lane_head[k]
        while at > first[k] and scene.on[at - 1].s > one.s:
            _copy(scene.on, at, scene.on, at - 1)
            at -= 1
        _copy(scene.on, at, scene.unsorted, e)
    for e in range(found):
        scene.lane_head[scene.unsorted_lane[e]] = -1
    return True


@in_place(inner=True)
def _copy(to: Records, at: int, source: Records, e: int) -> None:
    to[at].row, to[at].s, to[at].along = source[e].row, source[e].s, source[e].along


@in_place(inner=True)
def _after(x: float, lane: int, equal: bool, scene: Scene) -> int:
    """The first entry on a lane beyond a place, or also at it if ``equal``."""
    low, high = scene.on_first[lane], scene.on_first[lane + 1]
    while low < high:
        middle = (low + high) // 2
        s = scene.on[middle].s
        if s < x or (s == x and not equal):
            low = middle + 1
        else:
            high = middle
    return int(low)


@in_place()
def beside(i: int, lane: int, scene: Scene) -> Beside:
    """The vehicles ahead of and behind a vehicle on a lane, ahead also along its way."""
    on, first, vehicles = scene.on, scene.on_first, scene.vehicles
    here, length = along_lane(i, lane, scene), vehicles[i].length
    at = _after(here, lane, True, scene)
    rear, rear_gap, rear_speed = -1, np.inf, 0.0
    before = at - 1
    while before >= first[lane] and on[before].row == i:
        before -= 1
    if before >= first[lane]:
        rear = on[before].row
        rear_gap = here - on[before].s - (length + vehicles[rear].length) / 2
        rear_speed = on[before].along
    offset, now, visited = -here, lane, 0
    while True:
        end = first[now + 1]
        while at < end and on[at].row == i:
            at += 1
        if at < end:
            j = on[at].row
            gap = offset + on[at].s - (length + vehicles[j].length) / 2
            if gap < LEADER_RANGE_M:
                return Beside(j, gap, on[at].along, rear, rear_gap, rear_speed)
            break
        offset += scene.net.lanes[now].length
        visited += 1
        then = onward(i, now, scene)
        if then < 0 or offset > LEADER_RANGE_M or visited > MOST_LANES:
            break
        now = then
        at = _after(max(-offset, -JOINED_M), now, False, scene)
    return Beside(-1, np.inf, 0.0, rear, rear_gap, rear_speed)


@in_place()
def room_at_entry(lane: int, length: float, scene: Scene) -> tuple[float, float]:
    """Room at the beginning of a lane.

    Args:
        lane: which.
        length: of the vehicle that may enter, m.
        scene: the road.

    Returns:
        Bumper gap to the first vehicle on the lane or changing to it, m, and its speed, m/s.
    """
    net, nearest, speed = scene.net, np.inf, 0.0
    for j in range(scene.vehicles.size):
        other = scene.vehicles[j]
        s, lateral, _ = project(other.x, other.y, lane, net)
        aside = abs(lateral) > net.lanes[lane].width / 2 + 1.0
        if (aside and other.target != lane) or s > net.lanes[lane].length:
            continue
        gap = s - length - other.length / 2
        if gap < nearest:
            nearest = gap
            speed = other.speed * math.cos(other.heading - heading_at(s, lane, net))
    return nearest, max(speed, 0.0)


@in_place()
def read_motion(
    order: IntArray, scene: Scene, xy: FloatArray, heading: FloatArray, speed: FloatArray
) -> None:
    """Read how everybody moves, in the axes of a `Frame`.

    Args:
        order: (n,) rows; pedestrians are counted after the vehicles.
        scene: the road.
        xy: (n, 2) receives the places, m.
        heading: (n,) receives the headings, rad.
        speed: (n,) receives the speeds, m/s.
    """
    for k in range(order.size):
        i = order[k] - scene.vehicles.size
        if i < 0:
            me = scene.vehicles[order[k]]
            x, y, turned, speed[k] = me.x, me.y, me.heading, me.speed
        else:
            person = scene.walkers[i]
            x, y, turned, speed[k] = person.x, person.y, person.heading, person.speed
        xy[k, 0], xy[k, 1] = x, -y
        heading[k] = math.pi - (math.pi + turned) % (2.0 * math.pi)
