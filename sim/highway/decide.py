"""The drivers' decisions: the lane to head for, the acceleration and the steering angle.

A driver on a lane that does not lead to its goal gets over or takes another route. It changes
towards the nearest lane that does lead there, into any gap that makes nobody brake harder than it
may, and the harder the nearer the end of its lane is.

A driver whose time for it has come overtakes on the wrong side: behind a slow leader it pulls out
onto the nearest lane of the opposite direction if no oncoming vehicle is within sight. It goes back
as soon as there is room on its own side, or if a vehicle comes towards it.

References:
    Mandatory lane changes: Kesting, Treiber, Helbing (2007), Transportation Research Record 1999.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from behaviors.profiles import CLOSING_ERROR_PER_S, ERROR_TIME_S
from sim.compiled import in_place
from sim.highway import driving, junctions, pedestrians, places
from sim.highway.driving import desired_speed, draw, follow, idm, plan_next
from sim.highway.places import along_lane, beside, heading_at, onward, path_to, project
from sim.highway.state import LATE_S, MOST_LATE, Scene
from sim.scenario import IMPERFECTION

STOP_LASTS_S, GIVE_UP_S = (3.0, 6.0), 20.0
"""Least and longest duration of an unprovoked stop, and for how long a driver looks for somebody to
cut in front of before it waits for its next time."""

CHANGE_LEAST_SPEED_MPS, CHANGE_DELAY_S = 1.0, 1.0
"""Slower vehicles do not change lanes, and drivers weigh the lanes beside this often
(highway-env's)."""

GENTLE_MPS2, URGENT_MPS2 = 2.0, 4.5
"""Braking that a driver far from its lane's end imposes on others and itself at most (highway-env's
bound for ordinary changes), and at its end (hard, and held by any tyre)."""

GIVES_UP_S, AT_END_M, STANDING_ROOM_M = 4.0, 12.0, 6.0
"""A driver that has stood this long this near to the end of a wrong lane takes another route. A
standing vehicle needs this much room before its lane's end to get over."""

PASSING_S, SLOW_LEADER_M, JUNCTION_M = 5.0, 25.0, 60.0
"""Drivers expect overtaking on the wrong side to take this long. They overtake only leaders nearer
than this, and do not begin to this near the end of the road."""

BACK_S, BACK_ROOM_M = 3.0, 4.0
"""A driver on the wrong side goes back if it would meet a vehicle within this time, and into a gap
of at least this much in front and behind."""


@in_place()
def act(scene: Scene) -> None:
    """Work out what the rules demand of every driver, and decide for all unless somebody is astray.

    ``now.astray`` then says how many drivers need another route; `decide` comes after they have it.
    """
    scene.now[0].astray = 0
    junctions.look_ahead(scene)
    pedestrians.note_walkers(scene)
    pedestrians.obey_crossings(scene)
    junctions.obey_junctions(scene)
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        me.astray = False
        if not me.profiled:
            continue
        if scene.net.has_wrong and (me.wrong_way or me.clock >= me.due[driving.WRONG_WAY]):
            me.forced = _wrong_way_lane(me, scene)
        if me.path < 0 and me.then >= 0 and me.forced < 0:
            me.forced = _lane_to_get_over_to(me, scene)
    if scene.now[0].astray == 0:
        decide(scene)


@in_place()
def decide(scene: Scene) -> None:
    """Decide for every driver, after `act` said what the rules demand."""
    for i in range(scene.vehicles.size):  # who is changing to each lane
        me = scene.vehicles[i]
        if me.profiled and me.target != me.lane:
            scene.lane_link[i], scene.lane_head[me.target] = scene.lane_head[me.target], i
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        if me.profiled and not me.crashed:
            _choose_lane(me, scene)
    for i in range(scene.vehicles.size):
        me = scene.vehicles[i]
        if not me.profiled:
            continue
        if me.target != me.lane:
            scene.lane_head[me.target] = -1
        if me.crashed:
            me.steering, me.accel = 0.0, -me.comfort_decel_mps2
        else:
            _accelerate(me, scene)
            _steer(me, scene)


@in_place(inner=True)
def _steer(me: Any, scene: Scene) -> None:
    """Steer along the wanted lane; from the line of a junction until the rear has left it, turn."""
    net = scene.net
    if me.wanted == me.lane and (me.last_path >= 0 or (me.path >= 0 and me.to_line < 0.0)):
        tight = net.lanes[me.last_path if me.last_path >= 0 else me.path].tight
        guided, k = 1.0 if tight else driving.GUIDED, me.lane
        ahead = guided * me.length / 2
        x, y = me.x + ahead * math.cos(me.heading), me.y + ahead * math.sin(me.heading)
        s, lateral, _ = project(x, y, k, net)
        then = onward(me, k, scene)
        while s > net.lanes[k].length and then >= 0:
            k = then
            s, lateral, _ = project(x, y, k, net)
            then = onward(me, k, scene) if net.lanes[k].connector else -1
        me.steering = driving.turning_angle(me, guided, lateral, heading_at(s, k, net))
        return
    s, lateral, _ = project(me.x, me.y, me.wanted, net)
    after = heading_at(s + places.BLEND_M / 2, me.wanted, net)
    bend = (after - heading_at(s - places.BLEND_M / 2, me.wanted, net)) / places.BLEND_M
    heading = heading_at(s, me.wanted, net)
    me.steering = driving.steering_angle(me, lateral, heading, bend)


@in_place(inner=True)
def _choose_lane(me: Any, scene: Scene) -> None:
    me.wanted = me.lane
    if me.clock < me.lapse_until:
        me.wanted = me.target
    elif me.forced >= 0:
        me.wanted = me.forced
    elif me.lane != me.target:
        if me.wrong_way or scene.net.lanes[me.target].wrong or not _is_behind_a_change(me, scene):
            me.wanted = me.target
    elif me.timer > CHANGE_DELAY_S:
        me.timer = 0.0
        if me.changes and me.speed >= CHANGE_LEAST_SPEED_MPS:
            _weigh_lanes(me, scene)


@in_place(inner=True)
def _is_behind_a_change(me: Any, scene: Scene) -> bool:
    """Whether a vehicle just ahead changes to the same lane."""
    here, j = along_lane(me, me.lane, scene.net), scene.lane_head[me.target]
    while j >= 0:
        other = scene.vehicles[j]
        ahead = along_lane(other, me.lane, scene.net) - here
        gap = ahead - (me.length + other.length) / 2
        if ahead > 0.0 and gap < me.change_gap + me.speed * 0.5:
            return True
        j = scene.lane_link[j]
    return False


@in_place(inner=True)
def _weigh_lanes(me: Any, scene: Scene) -> None:
    """Choose between the present lane and those beside it."""
    lane, here, most = scene.net.lanes[me.lane], beside(me, me.lane, scene), 0.0
    if me.clock > me.due[driving.CUTS_IN] + GIVE_UP_S:
        plan_next(me, driving.CUTS_IN, me.clock)
    for side in (lane.left, lane.right):
        if side < 0 or (me.then >= 0 and path_to(side, me.then, scene.net) < 0):
            continue
        there = beside(me, side, scene)
        if me.clock >= me.due[driving.CUTS_IN] and driving.may_cut_in(me, there):
            me.wanted = side
            plan_next(me, driving.CUTS_IN, me.clock)
            return
        old, new = scene.vehicles[max(here.rear, 0)], scene.vehicles[max(there.rear, 0)]
        gain = driving.change_incentive(me, lane.limit, here, there, old, new)
        if gain > most:
            me.wanted, most = side, gain


@in_place(inner=True)
def _lane_to_get_over_to(me: Any, scene: Scene) -> int:
    """The lane beside its own that a driver on a wrong lane changes to now, or -1.

    A driver that stands at the end of its lane goes on where the lane leads, and needs another
    route from there; one whose lane leads nowhere waits for a gap.
    """
    lane = scene.net.lanes[me.lane]
    if lane.connector or lane.wrong or me.crashed:
        return -1
    side = _towards(me.lane, me.then, scene)
    leads_on = lane.way < lane.way_end
    stands = leads_on and me.to_line < AT_END_M and me.stood_s > GIVES_UP_S
    if side < 0 or (stands and beside(me, me.lane, scene).front_gap > me.to_line):
        me.target = me.wanted = me.lane
        me.astray = True
        scene.now[0].astray += 1
        return -1
    slow_at_end = me.speed < CHANGE_LEAST_SPEED_MPS and leads_on and me.to_line < STANDING_ROOM_M
    if me.target != me.lane or slow_at_end:
        return -1
    return side if _fits(me, side, scene) else -1


@in_place(inner=True)
def _towards(lane: int, then: int, scene: Scene) -> int:
    """The lane beside another one towards the nearest that leads to a stretch; or -1."""
    lanes, left, right = scene.net.lanes, lane, lane
    while left >= 0 or right >= 0:
        left = lanes[left].left if left >= 0 else -1
        if left >= 0 and path_to(left, then, scene.net) >= 0:
            return int(lanes[lane].left)
        right = lanes[right].right if right >= 0 else -1
        if right >= 0 and path_to(right, then, scene.net) >= 0:
            return int(lanes[lane].right)
    return -1


@in_place(inner=True)
def _fits(me: Any, side: int, scene: Scene) -> bool:
    """Whether a lane has a gap for which nobody has to brake too hard, whatever law it follows."""
    there = beside(me, side, scene)
    if there.front_gap < driving.LEAST_CHANGE_GAP_M or there.rear_gap < driving.LEAST_CHANGE_GAP_M:
        return False
    urgency = 1.0 - min(max(me.to_line, 0.0) / driving.RANGE_M, 1.0)
    most = GENTLE_MPS2 + urgency * (URGENT_MPS2 - GENTLE_MPS2)
    gap, closing = there.front_gap, me.speed - there.front_speed
    desired = desired_speed(me, scene.net.lanes[me.lane].limit)
    own = driving.bounded(me, idm(me, me.speed, desired, gap, there.front_speed), gap, closing)
    if own < -most or there.rear < 0:
        return bool(own >= -most)
    rear, speed, gap = scene.vehicles[there.rear], there.rear_speed, there.rear_gap
    wanted = idm(rear, speed, max(speed, 1.0), gap, me.speed)
    return bool(driving.bounded(rear, wanted, gap, speed - me.speed) >= -most)


@in_place(inner=True)
def _wrong_way_lane(me: Any, scene: Scene) -> int:
    """The lane to head for, of a driver that is on the wrong side or about to be; or -1."""
    net = scene.net
    lane = net.lanes[me.lane]
    if me.crashed:
        return -1
    if lane.wrong:
        return _lane_to_go_back(me, scene)
    if net.lanes[me.target].wrong:
        return int(me.target)
    if lane.opposite < 0 or me.clock < me.due[driving.WRONG_WAY]:
        return -1
    here = beside(me, me.lane, scene)
    desired, left = desired_speed(me, lane.limit), lane.length - me.s
    slow = here.front_gap < SLOW_LEADER_M and here.front_speed < 0.8 * desired
    if not slow or left < JUNCTION_M or me.speed < 2.0 or not me.changes:
        return -1
    oncoming = beside(me, lane.opposite, scene)
    needed = PASSING_S * (desired + net.lanes[lane.opposite].limit)
    if oncoming.front_gap < min(needed, left) or oncoming.rear_gap < BACK_ROOM_M:
        return -1
    plan_next(me, driving.WRONG_WAY, me.clock)
    return int(lane.opposite)


@in_place(inner=True)
def _lane_to_go_back(me: Any, scene: Scene) -> int:
    """The own side's lane if it is time to go back and there is room, or else the present one."""
    lane = scene.net.lanes[me.lane]
    here, there = beside(me, me.lane, scene), beside(me, lane.own, scene)
    room = there.front_gap > BACK_ROOM_M and there.rear_gap > BACK_ROOM_M
    soon = here.front_gap < BACK_S * max(me.speed - here.front_speed, 1.0)
    ends = lane.length - me.s < JUNCTION_M
    past = there.front_gap > SLOW_LEADER_M
    return int(lane.own if room and (past or soon or ends) else me.lane)


@in_place(inner=True)
def _accelerate(me: Any, scene: Scene) -> None:
    speed, desired = me.speed, desired_speed(me, scene.net.lanes[me.lane].limit)
    here = beside(me, me.lane, scene)
    gap, front_speed = here.front_gap, here.front_speed
    if me.perception_noise > 0.0 and gap < np.inf:
        error = me.perception_noise * _error(me)
        front_speed += CLOSING_ERROR_PER_S * error * gap
        gap *= math.exp(error)
    accel = follow(me, speed, desired, gap, front_speed)
    if me.wanted != me.lane:
        there = beside(me, me.wanted, scene)
        accel = min(accel, follow(me, speed, desired, there.front_gap, there.front_speed))
    if me.stop_gap < np.inf:
        accel = min(accel, driving.approach(me, speed, me.stop_gap))
    if _stops_for_no_reason(me):
        accel = min(accel, -me.comfort_decel_mps2)
    if me.reaction_time_s > 0.0:
        accel = _late(me, accel)
    me.accel = driving.start_up(me, accel)
    if me.krauss:  # which dawdles at random, as in SUMO
        most = min(me.max_accel_mps2, speed / driving.KRAUSS_STEP_S)
        me.accel -= IMPERFECTION * draw(me, driving.DAWDLES) * most
    if _looks_away(me):
        me.accel = 0.0


@in_place(inner=True)
def _error(me: Any) -> float:
    """The driver's present error of perception, an Ornstein-Uhlenbeck process of deviation 1."""
    keeps = math.exp((me.seen_at - me.clock) / ERROR_TIME_S) if me.drawn[driving.ERRS] > 0 else 0.0
    radius = math.sqrt(-2.0 * math.log1p(-draw(me, driving.ERRS)))
    drawn = radius * math.cos(2.0 * math.pi * draw(me, driving.ERRS))
    me.error = keeps * me.error + math.sqrt(1.0 - keeps * keeps) * drawn
    me.seen_at = me.clock
    return float(me.error)


@in_place(inner=True)
def _late(me: Any, accel: float) -> float:
    """The acceleration that the driver wanted a reaction time ago; ``accel`` is the present one."""
    now = int(me.clock / LATE_S + 0.5)
    me.late[now % MOST_LATE] = accel
    if me.late_since < 0:
        me.late_since = now
    ago = min(int(me.reaction_time_s / LATE_S + 0.5), now - me.late_since)
    return float(me.late[(now - ago) % MOST_LATE])


@in_place(inner=True)
def _looks_away(me: Any) -> bool:
    """Whether a driver's attention lapses now; schedules such lapses."""
    if me.clock >= me.due[driving.LAPSES]:
        me.lapse_until = me.clock - me.lapse_s * math.log1p(-draw(me, driving.LAPSE_LASTS))
        plan_next(me, driving.LAPSES, me.lapse_until)
    return bool(me.clock < me.lapse_until)


@in_place(inner=True)
def _stops_for_no_reason(me: Any) -> bool:
    """Whether a driver stops for no reason now; schedules such stops."""
    if me.clock >= me.due[driving.STOPS]:
        least, most = STOP_LASTS_S
        me.stop_until = me.clock + (least + (most - least) * draw(me, driving.STOP_LASTS))
        plan_next(me, driving.STOPS, me.stop_until)
    return bool(me.clock < me.stop_until)
