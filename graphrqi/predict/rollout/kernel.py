"""The rollout itself: every driver of a scene driven on for some seconds, compiled.

All drivers of one rollout move together, step by step. A driver keeps to the least of: what its
acceleration allows, its desired speed under the limits here and ahead, and the speed from which it
could still stop behind its leader or before a closed gate (a red light, an occupied crossing).
The safe speed is Krauss's, derived from Gipps: with reaction time T, deceleration b, gap g and
leader speed u, ``-b T + sqrt((b T)^2 + u^2 + 2 b g)``.

What the driver did beyond the model at the present (its residual acceleration) lives on and decays.

Once a second a driver may change to a lane beside that leads where its path does, by MOBIL with the
driver's own politeness, threshold, and braking imposed on others, told by IDM's accelerations. Who
has had reason to since the present and has not begun is taken not to want to.

References:
    Gipps (1981), "A behavioural car-following model for computer simulation", Transp. Res. B 15.
    Krauss (1998), "Microscopic modeling of traffic flow", DLR-FB 98-08, eq. 4.13.
    Kesting, Treiber, Helbing (2007), "General lane-changing model MOBIL for car-following models",
    Transportation Research Record 1999.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled, reordered

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LOOK_AHEAD_M = 120.0
"""Drivers react to nothing farther ahead (our choice: 5 s at 24 m/s)."""

SIGHT_M = 4.5
"""From here drivers see who comes (SUMO's default visibility distance at minor links)."""

HARD_DECEL = 8.0
"""Nobody brakes harder, m/s2 (dry asphalt)."""

DECIDE_S = 1.0
"""Time between two thoughts of changing lanes, s (SUMO's own is 1 s at the default step)."""

CHANGE_S = 3.0
"""How long a change to the lane beside takes, s (our choice: 3 to 6 s are observed)."""

CHANGE_ROOM_M = 20.0
"""Nobody begins to change lanes so close to a junction, m (our choice)."""

UNSEEN = 1e3
"""An acceleration below minus this stands for none seen."""

WARY_M = 30.0
"""Neighbours are kept away from within this distance, m (our choice: 2 s in town)."""


@reordered
def _safe_speed(gap: float, leader_speed: float, headway: float, decel: float) -> float:
    if gap <= 0.0:
        return 0.0
    reach = decel * headway
    return max(
        0.0, -reach + math.sqrt(reach * reach + leader_speed * leader_speed + 2 * decel * gap)
    )


@reordered
def _idm(speed: float, wish: float, gap: float, leader_speed: float, driver: Any) -> Any:
    accel = driver[3]
    ratio = speed / max(wish, 0.1)
    free = accel * (1.0 - ratio * ratio * ratio * ratio)
    if gap >= LOOK_AHEAD_M:
        return free
    if gap <= 0.1:
        return -HARD_DECEL
    braking = speed * (speed - leader_speed) / (2.0 * math.sqrt(accel * driver[4]))
    wanted = driver[2] + max(0.0, speed * driver[1] + braking)
    return max(free - accel * (wanted / gap) * (wanted / gap), -HARD_DECEL)


@reordered
def roll(
    path: Any, s: Any, v: Any, seen_accel: Any, half_length: Any, driver: Any, changing: Any,
    wary: Any, feared: Any, offset: Any, pace: Any, moving: Any, ignores: Any, closed: Any,
    path_lane: Any, path_start: Any, path_limit: Any, path_turn: Any, gate_x: Any, gate_row: Any,
    beside: Any, apart: Any, way: Any, lane_length: Any, step_s: float, shown: float, steps: int,
    decay_s: float, given_lane: Any, given_s: Any, given_v: Any,
) -> Any:  # fmt: skip
    """Drive everyone on.

    Args:
        path: (n,) path of each driver, row of the tables below.
        s: (n,) distance along it, m.
        v: (n,) speed, m/s.
        seen_accel: (n,) acceleration seen at present, m/s2; at most -1000: as modelled.
        half_length: (n,) m.
        driver: (n, 5) speed factor, time headway s, standstill gap m, acceleration and
            deceleration m/s2.
        changing: (n, 4) politeness, threshold m/s2, braking imposed on others m/s2, least gap m; or
            (0, 4): nobody changes lanes.
        wary: (n,) how far each keeps away from those feared, 0 to 1.
        feared: (n,) how far each is kept away from, 0 to 1.
        offset: (n,) distance to the left of the lane's centre, m.
        pace: (n,) speed at which each returns to it, m/s.
        moving: (n,) whether the driver is on a path at all.
        ignores: (n, R) whether each ignores each gate.
        closed: (R, steps + 1) 0 open, 1 closing (stop if comfortable), 2 closed, 3 approach ready
            to stop until it can be seen that nobody comes.
        path_lane: (Q, P) lanes of each path in order, -1 after its end.
        path_start: (Q, P) distance along the path at which each begins, m; +inf after its end.
        path_limit: (Q, P) speed limit, m/s.
        path_turn: (Q,) way that each path turns first.
        gate_x: (Q, G) places along the path where one may have to stop, m; +inf where none.
        gate_row: (Q, G) rows of ``closed``.
        beside: (2, L) lanes to the left and to the right, -1: none.
        apart: (2, L) how far apart the two centres are, m.
        way: (L, D) path from each lane that turns each way, -1: none.
        lane_length: (L,) m.
        step_s: s.
        shown: columns of ``closed`` per step.
        steps: how many.
        decay_s: time in which what is seen beyond the model falls to 1/e, s; 0: at once.
        given_lane: (n, steps) lanes where the others are taken to be, or (0, 0): they move
            together.
        given_s: (n, steps) distance along those lanes, m.
        given_v: (n, steps) their speeds, m/s.

    Returns:
        (n, steps) each: lanes, distances along them and to the left of their centres, m, speeds,
        m/s, and ways gone since the present, m; and (n,) accelerations that the law asks for at
        present, m/s2.
    """
    n, lanes = s.size, lane_length.size
    out_lane = np.zeros((n, steps), np.int64)
    out_s, out_side = np.empty((n, steps)), np.empty((n, steps))
    out_v, out_gone, asked = np.empty((n, steps)), np.empty((n, steps)), np.zeros(n)
    on, x, now_v, side = path.copy(), s.copy(), v.copy(), offset.copy()
    back, gone, at = pace.copy(), np.zeros(n), np.zeros(n, np.int64)
    residual, ready = np.zeros(n), np.zeros(n, np.int64)
    other_lane, other_s, other_v = np.full(n, -1), s.copy(), v.copy()
    order, drivers = np.empty(n, np.int64), 0
    first, last = np.empty(lanes, np.int64), np.empty(lanes, np.int64)  # places in the order
    rank = np.zeros(n, np.int64)
    most, gates = path_lane.shape[1], gate_x.shape[1]
    alone = given_s.size > 0
    every = max(1, round(DECIDE_S / step_s))
    may_change = changing.shape[0] == n and steps > 1
    for i in range(n):
        if abs(offset[i]) > 0.5:
            ready[i] = int(CHANGE_S / step_s)
        if moving[i]:
            order[drivers] = i
            drivers += 1
    for h in range(steps):
        for i in range(n):
            if not moving[i]:
                continue
            q, k = on[i], at[i]
            while k + 1 < most and path_lane[q, k + 1] >= 0 and path_start[q, k + 1] <= x[i]:
                k += 1
            at[i] = k
            if alone and h > 0:
                other_lane[i], other_s[i] = given_lane[i, h - 1], given_s[i, h - 1]
                other_v[i] = given_v[i, h - 1]
            else:
                other_lane[i], other_s[i] = path_lane[q, k], x[i] - path_start[q, k]
                other_v[i] = now_v[i]
        for j in range(1, drivers):  # by lane, then place; nearly in order since the last step
            i = order[j]
            lane, place_s = other_lane[i], other_s[i]
            g = j - 1
            while g >= 0:
                o = order[g]
                if other_lane[o] < lane or (
                    other_lane[o] == lane
                    and (other_s[o] < place_s or (other_s[o] == place_s and o > i))
                ):
                    break
                order[g + 1] = o
                g -= 1
            order[g + 1] = i
        first[:], last[:] = 0, -1
        for j in range(drivers):
            lane = other_lane[order[j]]
            if last[lane] < 0:
                first[lane] = j
            last[lane] = j
            rank[order[j]] = j
        fade = math.exp(-h * step_s / decay_s) if decay_s > 0.0 else 0.0
        column = int(h * shown + 0.5)
        for i in range(n):
            if not moving[i]:
                out_s[i, h], out_side[i, h], out_v[i, h], out_gone[i, h] = x[i], side[i], v[i], 0.0
                continue
            q, k = on[i], at[i]
            factor, headway, standstill = driver[i, 0], driver[i, 1], driver[i, 2]
            accel, decel = driver[i, 3], driver[i, 4]
            here, speed = x[i], now_v[i]
            lane = path_lane[q, k]
            limited = factor * path_limit[q, k]
            wish = limited
            best = 1e9
            leader = -1
            for j in range(k, most):
                ahead_lane = path_lane[q, j]
                if ahead_lane < 0:
                    break
                begin = path_start[q, j]
                if begin - here > LOOK_AHEAD_M:
                    break
                if j > k:
                    slower = factor * path_limit[q, j]
                    if slower < wish:
                        room = max(begin - here, 0.0)
                        wish = min(wish, math.sqrt(slower * slower + 2 * decel * room))
                if leader < 0:
                    begin_at = first[ahead_lane]
                    if ahead_lane == other_lane[i]:  # nobody far behind oneself is ahead
                        begin_at = rank[i]
                        while begin_at > first[ahead_lane] and (
                            begin + other_s[order[begin_at - 1]] >= here
                        ):
                            begin_at -= 1
                    for g in range(begin_at, last[ahead_lane] + 1):
                        other = order[g]
                        ahead = begin + other_s[other] - here
                        if other != i and (ahead > 0.0 or (ahead == 0.0 and other < i)):
                            best, leader = ahead, other
                            break
            if may_change and h % every == 0 and h >= ready[i] and speed > 1.0:
                along = here - path_start[q, k]
                to = -1
                most_gain = changing[i, 1]
                sign = 0.0
                left = lane_length[lane] - along
                for d in range(2):
                    target = beside[d, lane]
                    if target < 0 or way[target, path_turn[q]] < 0:
                        continue
                    if left < CHANGE_ROOM_M and path_lane[q, min(k + 1, most - 1)] >= 0:
                        continue
                    front, rear, front_far, rear_far = -1, -1, 1e9, 1e9
                    for g in range(first[target], last[target] + 1):
                        other = order[g]
                        if other == i:
                            continue
                        ahead = other_s[other] - along
                        if ahead >= 0.0:
                            front_far, front = ahead, other
                            break
                        rear_far, rear = -ahead, other
                    follower, follower_far = -1, 1e9
                    for g in range(first[lane], last[lane] + 1):
                        other = order[g]
                        if other == i:
                            continue
                        behind = along - other_s[other]
                        if behind <= 0.0:
                            break
                        follower_far, follower = behind, other
                    front_gap = front_far
                    if front >= 0:
                        front_gap -= half_length[i] + half_length[front]
                    rear_gap = rear_far
                    if rear >= 0:
                        rear_gap -= half_length[i] + half_length[rear]
                    if front_gap < changing[i, 3] or rear_gap < changing[i, 3]:
                        continue
                    front_v = other_v[front] if front >= 0 else speed
                    there = _idm(speed, limited, front_gap, front_v, driver[i])
                    if there < -decel:
                        continue
                    gap, leader_v = 1e9, speed
                    if leader >= 0:
                        gap = best - half_length[i] - half_length[leader]
                        leader_v = other_v[leader]
                    gain = there - _idm(speed, limited, gap, leader_v, driver[i])
                    if rear >= 0:
                        rear_v, own_wish = other_v[rear], driver[rear, 0] * path_limit[q, k]
                        after_it = _idm(rear_v, own_wish, rear_gap, speed, driver[rear])
                        if after_it < -changing[i, 2]:
                            continue
                        whole = 1e9
                        if front >= 0:
                            whole = rear_far + front_far - half_length[rear] - half_length[front]
                        before_it = _idm(rear_v, own_wish, whole, front_v, driver[rear])
                        gain += changing[i, 0] * (after_it - before_it)
                        if rear_gap < WARY_M:
                            gain -= wary[i] * feared[rear]
                    if follower >= 0:
                        its_v, own_wish = other_v[follower], driver[follower, 0] * path_limit[q, k]
                        its_gap = follower_far - half_length[i] - half_length[follower]
                        whole = 1e9
                        if leader >= 0:
                            whole = (
                                follower_far + best - half_length[follower] - half_length[leader]
                            )
                        gain += changing[i, 0] * (
                            _idm(its_v, own_wish, whole, leader_v, driver[follower])
                            - _idm(its_v, own_wish, its_gap, speed, driver[follower])
                        )
                        if its_gap < WARY_M:
                            gain += wary[i] * feared[follower]
                    if front >= 0 and front_gap < WARY_M:
                        gain -= wary[i] * feared[front]
                    if leader >= 0 and gap < WARY_M:
                        gain += wary[i] * feared[leader]
                    if gain > most_gain:
                        most_gain, to, sign = gain, target, 1.0 - 2.0 * d
                        best_next, next_leader = front_far, front
                if to >= 0 and h == 0:
                    ready[i] = steps
                elif to >= 0:
                    wide = apart[0 if sign > 0 else 1, lane]
                    on[i], at[i], x[i] = way[to, path_turn[q]], 0, along
                    q, k, here = on[i], 0, along
                    side[i] -= sign * wide
                    back[i] = max(wide / CHANGE_S, abs(side[i]) / CHANGE_S)
                    ready[i] = h + int(CHANGE_S / step_s)
                    best, leader = best_next, next_leader
            target_v = min(speed + accel * step_s, max(wish, speed - decel * step_s))
            if leader >= 0:
                gap = best - half_length[i] - half_length[leader] - standstill
                more = 1.0 + wary[i] * feared[leader]
                target_v = min(target_v, _safe_speed(gap, other_v[leader], headway * more, decel))
            front_x = here + half_length[i]
            for g in range(gates):
                room = gate_x[q, g] - front_x
                if room > LOOK_AHEAD_M:
                    break
                row = gate_row[q, g]
                if room < -1.0 or ignores[i, row]:
                    continue
                state = closed[row, column]
                if state == 0 or (state == 3 and room < SIGHT_M):
                    continue
                need = speed * speed / (2.0 * max(room, 0.1))
                if need > (decel if state == 1 else HARD_DECEL) and speed > 1.0:
                    continue
                target_v = min(target_v, _safe_speed(room, 0.0, headway, decel))
            change = max((target_v - speed) / step_s, -HARD_DECEL)
            if h == 0:
                asked[i] = (max(0.0, speed + change * step_s) - speed) / step_s
                if decay_s > 0.0 and seen_accel[i] > -UNSEEN:
                    residual[i] = seen_accel[i] - asked[i]
            change += residual[i] * fade
            faster = max(0.0, speed + change * step_s)
            step = 0.5 * (speed + faster) * step_s
            x[i] = here + step
            gone[i] += step
            now_v[i] = faster
            side[i] = math.copysign(max(abs(side[i]) - back[i] * step_s, 0.0), side[i])
            while k + 1 < most and path_lane[q, k + 1] >= 0 and path_start[q, k + 1] <= x[i]:
                k += 1
            out_lane[i, h], out_s[i, h] = path_lane[q, k], x[i] - path_start[q, k]
            out_side[i, h], out_v[i, h], out_gone[i, h] = side[i], faster, gone[i]
    return out_lane, out_s, out_side, out_v, out_gone, asked


@reordered
def roll_each(
    path: Any, s: Any, v: Any, seen_accel: Any, half_length: Any, driver: Any, offset: Any,
    pace: Any, moving: Any, ignores: Any, closed: Any, path_lane: Any, path_start: Any,
    path_limit: Any, path_turn: Any, gate_x: Any, gate_row: Any, beside: Any, apart: Any, way: Any,
    lane_length: Any, step_s: float, shown: float, steps: int, decay_s: float, given_lane: Any,
    given_s: Any, given_v: Any,
) -> Any:  # fmt: skip
    """Drive everyone on in M ways, each alone among the others as given; nobody changes lanes.

    Args are those of `roll`, with a first axis of M in ``path``, ``driver``, ``offset``, ``pace``
    and ``ignores``.

    Returns:
        (M, n, steps) lanes, distances along them, distances to the left and ways gone, and (M, n)
        accelerations asked for; see `roll`.
    """
    m, n = path.shape
    lane, gone = np.empty((m, n, steps), np.int64), np.empty((m, n, steps))
    along, side, asked = np.empty((m, n, steps)), np.empty((m, n, steps)), np.empty((m, n))
    keep, calm = np.empty((0, 4)), np.zeros(n)
    for k in range(m):
        rolled = roll(
            path[k], s, v, seen_accel, half_length, driver[k], keep, calm, calm, offset[k],
            pace[k], moving, ignores[k], closed, path_lane, path_start, path_limit, path_turn,
            gate_x, gate_row, beside, apart, way, lane_length, step_s, shown, steps, decay_s,
            given_lane, given_s, given_v,
        )  # fmt: skip
        for i in range(n):  # a slice to assign to takes seconds to compile
            asked[k, i] = rolled[5][i]
            for h in range(steps):
                lane[k, i, h], along[k, i, h] = rolled[0][i, h], rolled[1][i, h]
                side[k, i, h], gone[k, i, h] = rolled[2][i, h], rolled[4][i, h]
    return lane, along, side, gone, asked


@compiled
def beside(
    which: int, other_ways: bool, lane: Any, path: Any, on_path: Any, offset: Any, sideways: Any,
    beside: Any, apart: Any, way: Any, path_turn: Any,
) -> tuple[Any, Any, Any, Any, Any]:  # fmt: skip
    """Everyone on its way to the lane beside, where there is one.

    Args:
        which: 0: to the left, 1: to the right.
        other_ways: whether a lane counts that leads elsewhere than the path does.
        lane: (n,) lane of each driver, -1 off the road.
        path: (n,) path of each; this and the rest as in `roll`.
        on_path: (n,) who is on a path.
        offset: (n,) m.
        sideways: (n,) m/s.
        beside: (2, L).
        apart: (2, L) m.
        way: (L, D).
        path_turn: (Q,).

    Returns:
        (n,) lanes, paths, offsets and speeds sideways then, unchanged where there is no such lane,
        and (n,) whether there is one.
    """
    new_lane, new_path = lane.copy(), path.copy()
    new_offset, new_sideways = offset.copy(), sideways.copy()
    there = np.zeros(lane.size, np.bool_)
    sign = 1.0 - 2.0 * which
    for i in range(lane.size):
        if not on_path[i]:
            continue
        to = beside[which, lane[i]]
        if to < 0:
            continue
        onward = way[to, path_turn[path[i]]]
        if onward < 0 and other_ways:
            for turn in range(way.shape[1]):
                onward = max(onward, way[to, turn])
        if onward < 0:
            continue
        there[i] = True
        wide = sign * apart[which, lane[i]]
        new_lane[i], new_path[i] = to, onward
        new_offset[i], new_sideways[i] = offset[i] - wide, wide / CHANGE_S
    return new_lane, new_path, new_offset, new_sideways, there


@reordered
def along_path(path: Any, x: Any, path_lane: Any, path_start: Any) -> tuple[Any, Any]:
    """(n, H) lanes and (n, H) distances along them, of distances x (n, H) along paths (n,)."""
    n, steps = x.shape
    lane, s = np.empty((n, steps), np.int64), np.empty((n, steps))
    for i in range(n):
        q, k = path[i], 0
        for h in range(steps):
            while (
                k + 1 < path_lane.shape[1]
                and path_lane[q, k + 1] >= 0
                and path_start[q, k + 1] <= x[i, h]
            ):
                k += 1
            lane[i, h], s[i, h] = path_lane[q, k], x[i, h] - path_start[q, k]
    return lane, s


@reordered
def place(
    lane: Any, s: Any, side: Any, segment_start: Any, segment_direction: Any, segment_at: Any,
    segment_first: Any, segment_last: Any,
) -> Any:  # fmt: skip
    """(n, H, 2) places of (n, H) distances along lanes and to the left of their centres."""
    n, steps = s.shape
    out = np.empty((n, steps, 2))
    for i in range(n):
        before, g = -1, 0
        for h in range(steps):
            here = lane[i, h]
            if here != before:
                before, g = here, segment_first[here]
            while g < segment_last[here] and segment_at[g + 1] <= s[i, h]:
                g += 1
            along = s[i, h] - segment_at[g]
            out[i, h, 0] = (
                segment_start[g, 0] + along * segment_direction[g, 0]
                - side[i, h] * segment_direction[g, 1]
            )  # fmt: skip
            out[i, h, 1] = (
                segment_start[g, 1] + along * segment_direction[g, 1]
                + side[i, h] * segment_direction[g, 0]
            )  # fmt: skip
    return out


@reordered
def from_own_seat(
    xy: Any, now: Any, heading: Any, speed: Any, on_path: Any, every: int, step_s: float
) -> Any:
    """(n, J, 2) every so many of places (n, H, 2) ahead and to the left of each driver, m.

    Who is on no path goes straight on.
    """
    n, knots = now.shape[0], xy.shape[1] // every
    out = np.empty((n, knots, 2))
    for i in range(n):
        cos, sin = math.cos(heading[i]), math.sin(heading[i])
        for j in range(knots):
            h = (j + 1) * every - 1
            if on_path[i]:
                dx, dy = xy[i, h, 0] - now[i, 0], xy[i, h, 1] - now[i, 1]
                out[i, j, 0], out[i, j, 1] = dx * cos + dy * sin, dy * cos - dx * sin
            else:
                out[i, j, 0], out[i, j, 1] = speed[i] * (h + 1) * step_s, 0.0
    return out
