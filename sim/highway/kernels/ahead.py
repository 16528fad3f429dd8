"""What every driver meets on its way: the next junction path, lights, conflicts and crossings.

Kernels over all vehicles; `sim.highway.rules` says the same for one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors import driver_models
from sim.compiled import in_place, shared
from sim.frames import Signal
from sim.highway.driving import (
    COMFORT_DECEL,
    EMERGENCY_DECEL,
    MAX_ACCEL,
    MIN_GAP,
    SPEED_FACTOR,
    STANDING_MPS,
    STARTUP_DELAY,
)
from sim.highway.kernels.decide import desired_speed
from sim.highway.kernels.lane_tables import Lanes
from sim.highway.kernels.leaders import Places, along_lane, beside, next_stretch, path_to
from sim.highway.rules import way_ahead
from sim.highway.rules.commands import BEND_BRAKING, BEND_FACTOR, LINE_M, NO_CHANGE_M
from sim.highway.rules.junctions import (
    AT_LINE_M,
    BLOCKED_MPS,
    CONFLICT_MARGIN_M,
    Foe,
    Passage,
    must_wait,
    reach_s,
)
from sim.highway.rules.way_ahead import ENTERED_M, RANGE_M

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_braking_speed = shared(driver_models.braking_speed)
_can_stop = shared(way_ahead.can_stop)
RED, YELLOW = Signal.RED.code, Signal.YELLOW.code


class Travellers(NamedTuple):
    """Every vehicle at the beginning of a step, one row each.

    Attributes:
        known: (n,) whether it has a profile.
        agent: (n,) id.
        lane: (n,) present lane.
        target: (n,) lane that it changes to, or the present one.
        parameters: (n, 14) as from `sim.highway.driving.driver_parameters`.
        manners: (n, 3) of its profile: ``yellow_run_s``, ``gap_acceptance_s``, ``insistence``.
        speed_cap: (n,) the cap on its speed a step ago, m/s.
        held: (n,) whether a light or a sign made it stop at the line a step ago.
        stood_s: (n,) for how long it has stood, s.
        last_path: (n,) junction path that it was on last, -1 once it has left it; changed.
        ran_red: (n,) whether it is in a junction after a red light; changed.
        before_path: (n,) the junction path ahead a step ago, -1 for none.
        before_line: (n,) how far away that path was, m.
    """

    known: BoolArray
    agent: IntArray
    lane: IntArray
    target: IntArray
    parameters: FloatArray
    manners: FloatArray
    speed_cap: FloatArray
    held: BoolArray
    stood_s: FloatArray
    last_path: IntArray
    ran_red: BoolArray
    before_path: IntArray
    before_line: FloatArray


class Ahead(NamedTuple):
    """Where every vehicle is on its way, and what has to be asked of its driver.

    Attributes:
        s: (n,) distance of its middle along its lane, m.
        then: (n,) the stretch after its lane's, -1 at the end of its way.
        path: (n,) the junction path that it is on or comes to next, -1 for none.
        to_line: (n,) see `sim.highway.rules.way_ahead.WayAhead`, m.
        left: (n,) whether it has now left the path that it was on last.
        crossed: (n,) whether it has just come over the line of its path.
        first_at_red: (n,) whether its driver is the first before a red light.
        stops: (n,) whether a driver stops at the line who obeys its light.
        merges_wrong: (n,) whether it comes to the end of a lane that is not on its way.
        people: (n,) whether it comes to a crossing with pedestrians.
        passed: (n,) whether it is past a crossing on its lane or path.
    """

    s: FloatArray
    then: IntArray
    path: IntArray
    to_line: FloatArray
    left: BoolArray
    crossed: BoolArray
    first_at_red: BoolArray
    stops: BoolArray
    merges_wrong: BoolArray
    people: BoolArray
    passed: BoolArray


class Demands(NamedTuple):
    """What the rules demand of every driver; see `sim.highway.vehicle.DriverCommands`.

    Attributes:
        stop_gap: (n,) m; holds what crossings demand before `demand`.
        speed_cap: (n,) m/s.
        held: (n,) holds what lights and signs demand before `demand`.
        changes: (n,).
    """

    stop_gap: FloatArray
    speed_cap: FloatArray
    held: BoolArray
    changes: BoolArray


def empty_ahead(n: int) -> Ahead:
    """Room for ``n`` vehicles."""
    flags = np.zeros((7, n), dtype=np.bool_)
    numbers = np.empty((2, n), dtype=np.int64)
    metres = np.empty((2, n))
    return Ahead(metres[0], numbers[0], numbers[1], metres[1], *flags)


@in_place()
def look_ahead(
    who: Travellers,
    lanes: Lanes,
    places: Places,
    signals: NDArray[np.int8],
    signal_age: FloatArray,
    used: BoolArray,
    found: Ahead,
) -> None:
    """Fill in where each vehicle is on its route.

    Args:
        who: everybody.
        lanes: of the road.
        places: where everybody is.
        signals: (g,) what the signals show.
        signal_age: (g,) for how long, s.
        used: (c,) whether pedestrians are on each crossing or near it.
        found: written.
    """
    for i in range(who.lane.size):
        lane, length, speed = who.lane[i], places.length[i], places.speed[i]
        s = along_lane(i, lane, places)
        front = s + length / 2
        then = next_stretch(i, lane, lanes, places)
        if lanes.connector[lane]:
            who.last_path[i] = path = lane
            to_line = -front
        else:
            path = lanes.exit[lane]
            if path < 0 and then >= 0:
                path = path_to(lane, then, lanes)
            to_line = lanes.length[lane] - front
        found.s[i], found.then[i], found.path[i], found.to_line[i] = s, then, path, to_line
        if who.last_path[i] >= 0 and who.last_path[i] != path and s - length / 2 >= 0.0:
            found.left[i], who.last_path[i], who.ran_red[i] = True, -1, False
        if path >= 0 and path == who.before_path[i]:
            found.crossed[i] = who.before_line[i] > 0.0 >= to_line
        _look_at_crossings(i, lane, -front, length, lanes, used, found)
        if path >= 0 and path != lane:
            _look_at_crossings(i, path, to_line, length, lanes, used, found)
        if not who.known[i] or lanes.wrong[lane] or to_line >= RANGE_M:
            continue
        if path < 0:
            ends = lanes.way_first[lane] == lanes.way_first[lane + 1]
            merging = who.target[i] != lane and ends
            found.merges_wrong[i] = then >= 0 and not merging
        elif to_line > -ENTERED_M and lanes.signal[path] >= 0:
            state, driver = signals[lanes.signal[path]], who.parameters[i]
            if state == RED:
                found.first_at_red[i] = beside(i, lane, lanes, places).front_gap > to_line
                found.stops[i] = _can_stop(speed, to_line, driver[EMERGENCY_DECEL])
            elif state == YELLOW and signal_age[lanes.signal[path]] >= who.manners[i, 0]:
                found.stops[i] = _can_stop(speed, to_line, driver[COMFORT_DECEL])


@in_place(inner=True)
def _look_at_crossings(
    i: int, lane: int, begin: float, length: float, lanes: Lanes, used: BoolArray, found: Ahead
) -> None:
    for at in range(lanes.strip_first[lane], lanes.strip_first[lane + 1]):
        near, far = lanes.strip_at[at, 0] + begin, lanes.strip_at[at, 1] + begin
        if far + length < 0.0:
            found.passed[i] = True
        elif near <= RANGE_M and used[lanes.strip_crossing[at]]:
            found.people[i] = True


@in_place(inner=True)
def _rank(
    i: int, path: int, entered: bool, who: Travellers, lanes: Lanes, signals: NDArray[np.int8]
) -> int:
    red = lanes.signal[path] >= 0 and signals[lanes.signal[path]] == RED
    if who.ran_red[i] or (red and not entered):
        return 2
    return 1 if lanes.must_yield[path] else 0


@in_place(inner=True)
def _exit_blocked(
    i: int, path: int, to_line: float, who: Travellers, lanes: Lanes, places: Places
) -> bool:
    lead = beside(i, who.lane[i], lanes, places)
    if lead.front < 0 or lead.front_speed > BLOCKED_MPS or lead.front_gap < to_line:
        return False
    needed = to_line + lanes.length[path] + places.length[i] + who.parameters[i, MIN_GAP]
    return bool(lead.front_gap < needed)


@in_place(inner=True)
def _conflicts_gap(
    i: int, gap: float, who: Travellers, lanes: Lanes, places: Places, signals: NDArray[np.int8],
    found: Ahead, head: IntArray, link: IntArray,
) -> float:  # fmt: skip
    """The nearest place at which a driver waits for others, or ``gap`` if that is nearer, m."""
    path, to_line, speed = found.path[i], found.to_line[i], places.speed[i]
    driver, length, n = who.parameters[i], places.length[i], who.lane.size
    entered = to_line < -ENTERED_M
    rank = _rank(i, path, entered, who, lanes, signals)
    light = lanes.signal[path] if entered and who.lane[i] == path else -1
    after_green = light >= 0 and signals[light] == RED
    top = desired_speed(driver, lanes.limit[who.lane[i]], who.speed_cap[i])
    delay = driver[STARTUP_DELAY] if speed < STANDING_MPS else 0.0
    for c in range(lanes.conflict_first[path], lanes.conflict_first[path + 1]):
        other = lanes.conflict_lane[c]
        if head[other] < 0:
            continue
        begin_s, end_s = lanes.conflict_at[c, 0], lanes.conflict_at[c, 1]
        begin, end = to_line + begin_s, to_line + end_s + length
        if begin <= 0.0 or end < 0.0:
            continue
        own = Passage(
            who.agent[i], to_line, rank, entered, after_green, who.stood_s[i],
            delay + reach_s(speed, begin, driver[MAX_ACCEL], top),
            delay + reach_s(speed, end, driver[MAX_ACCEL], top),
            who.manners[i, 1], who.manners[i, 2],
        )  # fmt: skip
        entry = head[other]
        while entry >= 0:
            j, foe_line, held = entry % n, found.to_line[entry % n], who.held[entry % n]
            if entry >= n:  # on its way out of the junction
                front = found.s[j] + places.length[j] / 2
                foe_line, held = -(lanes.length[other] + front), False
            entry = link[entry]
            if j == i:
                continue
            foe_entered = foe_line < -ENTERED_M
            foe = Foe(
                who.agent[j], foe_line, foe_line + lanes.conflict_at[c, 2],
                foe_line + lanes.conflict_at[c, 3] + places.length[j],
                _rank(j, other, foe_entered, who, lanes, signals), foe_entered, held,
                max(places.speed[j], 0.0), who.stood_s[j],
            )  # fmt: skip
            if not must_wait(own, foe):
                continue
            at_line = not entered and (begin_s < AT_LINE_M or rank == 2)
            stop = to_line if at_line else begin - CONFLICT_MARGIN_M
            if _can_stop(speed, stop, driver[EMERGENCY_DECEL]):
                gap = min(gap, stop)
    return gap


@in_place()
def demand(
    who: Travellers,
    lanes: Lanes,
    places: Places,
    signals: NDArray[np.int8],
    found: Ahead,
    has_paths: bool,
    head: IntArray,
    link: IntArray,
    out: Demands,
) -> None:
    """Fill in what the rules demand of every driver with a profile.

    Args:
        who: everybody, after `look_ahead`.
        lanes: of the road.
        places: where everybody is.
        signals: (g,) what the signals show.
        found: from `look_ahead`.
        has_paths: whether any lane is a junction path.
        head: (K,) room to work in; must be -1 before.
        link: (2n,) likewise.
        out: written.
    """
    n = who.lane.size
    for i in range(n):  # who is on its way over each junction path
        path, last = found.path[i], who.last_path[i]
        if path >= 0 and found.to_line[i] < RANGE_M:
            link[i], head[path] = head[path], i
        if last >= 0 and last != path:
            link[n + i], head[last] = head[last], n + i
    for i in range(n):
        if not who.known[i]:
            continue
        lane, path, then, to_line = who.lane[i], found.path[i], found.then[i], found.to_line[i]
        driver = who.parameters[i]
        factor = min(driver[SPEED_FACTOR], BEND_FACTOR)
        gap, cap = out.stop_gap[i], np.inf
        near, changes = to_line < RANGE_M, True
        if lanes.connector[lane]:
            cap, changes = factor * lanes.limit[lane], False
        elif has_paths or then >= 0:
            changes = found.s[i] > NO_CHANGE_M[0] and (then < 0 or to_line > NO_CHANGE_M[1])
            if found.merges_wrong[i]:
                gap, out.held[i], changes = min(gap, to_line), True, True
        if lanes.wrong[lane]:
            out.stop_gap[i] = to_line - LINE_M if near else np.inf
            out.speed_cap[i], out.changes[i] = cap, changes
            continue
        if path >= 0 and near:
            if not lanes.connector[lane]:
                bend = factor * lanes.limit[path]
                braking = BEND_BRAKING * driver[COMFORT_DECEL]
                cap = _braking_speed(max(to_line, 0.0), bend, braking)
            if out.held[i] or (
                to_line > -ENTERED_M and _exit_blocked(i, path, to_line, who, lanes, places)
            ):
                gap = min(gap, to_line)
            if not out.held[i]:
                gap = _conflicts_gap(i, gap, who, lanes, places, signals, found, head, link)
        if path >= 0 and not lanes.must_yield[path] and -ENTERED_M < to_line < gap < np.inf:
            gap = to_line  # a driver with priority does not stop inside
        out.stop_gap[i], out.speed_cap[i], out.changes[i] = gap, cap, changes
